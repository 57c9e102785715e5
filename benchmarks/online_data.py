# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Why the data must be this run's own: Net3 controlled with them, and with a record of another day.

Both reservoirs are constants that no input moves. One run excites one ray of their heads, and a record taken while
they stood in another ratio spans another ray: the rows (6.1b) of the present run are inconsistent with it and its
predictions are wrong. Prints the figures, draws docs/online-data.png, exits non-zero if the claim does not hold.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from plant_sim import net3
from plant_sim.stepper import LinearStepper
from ros2_deepc.behavior import Record, data_matrix
from ros2_deepc.control import DeepcController, DeepcSettings

HERE = (2.0, 4.0, 3.0, 2.5, 2.0)  # heads of river, lake and three tanks at the start [m]
OTHER_DAY = (4.0, 2.0, 3.0, 2.5, 2.0)  # the reservoirs stood in another ratio
FIGURE = Path(__file__).parents[1] / "docs" / "online-data.png"


def start(plant, heads):
    x = np.zeros(plant.system.n)
    x[:5] = heads
    return LinearStepper(plant.system.weierstrass(), plant.system.slow_state(x))


def record(plant, heads, seed, T):
    """White inputs and what came of them."""
    stepper, rng = start(plant, heads), np.random.Generator(np.random.PCG64(seed))
    u = rng.uniform(-1, 1, (T, 3))
    return Record(u, np.array([stepper.push(v) for v in u]))


def inconsistency(windows, data, rows):
    """Largest relative part of the windows that columns of the data cannot express."""
    H, X = data_matrix([data], rows, rows), data_matrix([windows], rows, rows)
    U, sv, _ = np.linalg.svd(H, full_matrices=False)
    U = U[:, sv > 1e-10 * sv[0]]
    return float(np.linalg.norm(X - U @ (U.T @ X), 2) / np.linalg.norm(X, 2))


def control(plant, data, steps):
    """The run from T on with the given data; returns tank level, its one-step predictions, references."""
    settings = {**plant.settings, "q": plant.prior.q, "u_min": -1.0, "u_max": 1.0, "solver": "daqp"}
    controller = DeepcController(3, 2, DeepcSettings(**settings))
    for u, y in zip(*data, strict=True):
        controller.observe(u, y)
    controller.cut()
    own = record(plant, HERE, 1, settings["T"])
    stepper = start(plant, HERE)
    for u in own.u:
        y = stepper.push(u)
        controller.observe(u, y)
    level, told = list(own.y[:, 1]), []
    for k in range(settings["T"] - 1, steps - 1):
        goal = [values for first, values in plant.references if first <= k + 1][-1]
        result = controller.step(goal)
        told.append(result.y_plan[0, 1])
        y = stepper.push(result.u)
        controller.observe(result.u, y)
        level.append(y[1])
    return np.array(level), np.array(told)


def draw(runs, T, path):
    figure = Figure(figsize=(8, 4.2), layout="constrained")
    axis = figure.add_subplot()
    k = np.arange(len(runs["this run's own data"][0]))
    goal = np.where(k < 160, 3.0, 5.0).astype(float)
    goal[:T] = np.nan
    axis.step(k, goal, color="0.25", lw=1, ls=":", where="post", label="reference")
    for (name, (level, _)), style in zip(runs.items(), (("#0072b2", "-"), ("#d55e00", "--")), strict=True):
        axis.plot(k[T - 1 :], level[T - 1 :], color=style[0], ls=style[1], lw=1.8, label=name)
    axis.plot(k[:T], runs["this run's own data"][0][:T], color="0.6", lw=1)
    axis.axvspan(0, T - 1, color="0.94")
    axis.text(3, axis.get_ylim()[1] - 0.15, "collecting", va="top", color="0.35")
    axis.set(xlabel="sample (2.4 h each)", ylabel="level of tank 3 [m]", xlim=(0, k[-1]))
    axis.spines[["top", "right"]].set_visible(False)
    axis.legend(frameon=False, loc="upper left", bbox_to_anchor=(0.51, 0.99))
    figure.savefig(path, dpi=150)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--figure", type=Path, default=FIGURE)
    args = parser.parse_args()
    plant = net3(hour=5)
    T, rows = plant.settings["T"], plant.settings["N"] + plant.settings["L"]
    sets = {
        "this run's own data": record(plant, HERE, 1, T),
        "data of another day": record(plant, OTHER_DAY, 2, T),
    }
    later = record(plant, HERE, 1, T + 60)
    later = Record(later.u[T:], later.y[T:])
    runs, figures = {}, {}
    for name, data in sets.items():
        runs[name] = level, told = control(plant, data, 200)
        figures[name] = (
            inconsistency(later, data, rows),
            float(np.abs(level[T:] - told).max()),
            float(np.abs(level[150:160] - 3).max()),
            float(np.abs(level[190:] - 5).max()),
        )
        print(f"{name}: (6.1b) inconsistent by {figures[name][0]:.1e}, predictions off by {figures[name][1]:.1e} m,")
        print(f"  tank 3 off by {figures[name][2]:.3f} m at 3 m and {figures[name][3]:.3f} m at 5 m")
    draw(runs, T, args.figure)
    own, foreign = figures.values()
    if not (own[0] < 1e-9 < 1e-4 < foreign[0] and own[1] < 1e-8 < 1e-3 < foreign[1]):
        sys.exit("the claim does not hold")


if __name__ == "__main__":
    main()
