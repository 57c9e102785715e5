# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Draws docs/figure-nonlinear.png: a load step with and without control, and two days of tank 3.

python benchmarks/nonlinear_figure.py
"""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from nonlinear import STEP, run

from plant_sim.swing_plant import wscc9_swing

FIGURE = Path(__file__).parents[1] / "docs" / "figure-nonlinear.png"
INERTIA = np.array([0.125, 0.034, 0.016])


def frequency(axis: Axes) -> None:
    """Centre of inertia after the load step, three ways."""
    stepper = wscc9_swing().start(0)
    free = np.array([stepper.push(np.zeros(3)) for _ in range(400)])
    runs = {
        "no control": (free, "#9aa0a6"),
        "absolute form": (run("wscc9_swing", 0, form="absolute", trip_error=np.inf)[0].y, "#d55e00"),
        "incremental form": (run("wscc9_swing", 0)[0].y, "#0072b2"),
    }
    t = 0.1 * (np.arange(400) - STEP)
    for name, (y, colour) in runs.items():
        axis.plot(t, 1e3 * y @ INERTIA / INERTIA.sum(), color=colour, label=name, lw=1.8)
    axis.set(xlim=(-2, 10), xlabel="time after a load step of 0.3 pu at bus 9 [s]", ylabel="centre of inertia [mHz]")
    axis.legend(frameon=False, loc="center right")


def tank(level: Axes, speed: Axes) -> None:
    """Two days of tank 3 under diurnal demand, once without control."""
    loop, _, plant = run("net3_epanet", 0)
    stepper = plant.start(0)
    free = np.array([stepper.push([0.6, 1.0]) for _ in range(400)])
    k = np.arange(150, 342)
    t = 0.25 * (k - 150)
    level.plot(t, free[k, 0], color="#9aa0a6", lw=1.8, label="constant speeds")
    level.plot(t, loop.y[k, 0], color="#0072b2", lw=1.8, label="controlled")
    level.plot(t, [plant.reference(int(i))[0] for i in k], color="black", lw=1, ls="--", label="reference")
    level.set(ylabel="level of tank 3 [m]", xlim=(0, 48))
    level.legend(frameon=False, loc="lower right")
    speed.step(t, loop.u[k, 0], where="post", color="#009e73", label="pump 335")
    speed.step(t, loop.u[k, 1], where="post", color="#cc79a7", label="pump 10")
    speed.set(ylabel="speed", xlabel="time under control [h]", xlim=(0, 48))
    speed.legend(frameon=False, loc="upper right", ncols=2)


def main() -> None:
    """Draws both."""
    figure = Figure(figsize=(12, 4.6), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, 2, height_ratios=(2, 1))
    frequency(figure.add_subplot(grid[:, 0]))
    tank(figure.add_subplot(grid[0, 1]), figure.add_subplot(grid[1, 1]))
    figure.savefig(FIGURE)


if __name__ == "__main__":
    main()
