# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""What the controller promises beside speed, on larger samples than the tests take. Exits non-zero on a broken promise.

- 10 000 closed-loop steps at T = 100, 400, 1600 against predictive control on the true model: no failed, no wrong step.
- Closed-loop cost with output noise over the cost with the true state; beside it (6.1) as printed (noise block free).
- Predictor after 100 000 shifts of the window with 10 % excitation against the true one.
- 4000 steps towards random references, within reach of the inputs and out of it: always an answer, and in the end the
  best steady state.
- Limits on rates and outputs together with equilibrium: always an answer, and how often it is the second solver's.
- Import and first step in a fresh process: time and memory.
"""

import argparse
import subprocess
import sys
import time
from itertools import product

import numpy as np
from deepc import L, N, Plant, Q, R
from scipy.optimize import lsq_linear
from threadpoolctl import threadpool_limits

from ros2_deepc.control import DeepcController, DeepcSettings, Status

BASE = {"N": N, "L": L, "q": 6, "Q": Q, "R": R, "u_min": -1.0, "u_max": 1.0}
SIZES = (100, 400, 1600)
GOALS = (np.zeros(2), np.full(2, 0.8), np.array([-3.0, 3.0]))


def begin(settings, seed, noise=0.0):
    """A plant, a controller that has just become ready, and the source of noise."""
    plant, rng = Plant(3, 2, 6, seed), np.random.Generator(np.random.PCG64([seed, 5]))
    controller = DeepcController(3, 2, settings)
    while not controller.ready:
        u = rng.uniform(-1, 1, 3)
        controller.observe(u, plant.move(u) + noise * rng.standard_normal(2))
    return plant, controller, rng


def closed_loop(steps):
    print("closed loop               solver   steps  not solved  largest error of the first input")
    for T in SIZES:
        for solver, limit in (("osqp", 1e-4), ("daqp", 1e-9)):
            plant, controller, _ = begin(DeepcSettings(**BASE, T=T, terminal="none", solver=solver), 3)
            worst, bad = 0.0, 0
            for k in range(steps):
                goal = GOALS[k // 25 % 3]
                result = controller.step(goal)
                worst = max(worst, np.abs(result.u - plant.best(goal)).max())
                bad += result.status is not Status.SOLVED
                controller.observe(result.u, plant.move(result.u))
            print(f"  T = {T:5d}               {solver:6s} {steps:6d} {bad:11d}  {worst:.1e}", flush=True)
            if bad or worst > limit:
                yield f"closed loop T = {T} {solver}: {bad} steps not solved, error {worst:.1e}"


def cost(plant, decide, observe, steps):
    """Cost of a closed loop: true outputs against the goal, inputs."""
    total = 0.0
    for k in range(steps):
        goal = GOALS[k // 25 % 2]
        u = decide(goal)
        y = plant.move(u)
        observe(u, y)
        total += Q * np.sum((y - goal) ** 2) + R * np.sum(u**2)
    return total


def noisy_cost(settings, seed, sigma, steps):
    """Cost of a loop in which all measurements, those of the window too, carry white noise."""
    plant, controller, rng = begin(settings, seed, sigma)
    noise = sigma * rng.standard_normal((steps, 2))
    rows = iter(noise)
    return cost(plant, lambda goal: controller.step(goal).u, lambda u, y: controller.observe(u, y + next(rows)), steps)


def noise(seeds, steps=160):
    print("output noise              closed-loop cost / cost with the true state (median over plants)")
    forms = {"this controller": {}, "(6.1) as printed": {"noise_block": "free", "cut": "none"}}
    for T in SIZES:
        for sigma in (1e-3, 1e-2, 5e-2):
            ratios = {name: [] for name in forms}
            for seed in range(seeds):
                plant = begin(DeepcSettings(**BASE, T=T), seed)[0]
                best = cost(plant, plant.best, lambda *_: None, steps)
                for name, form in forms.items():
                    settings = DeepcSettings(**BASE, T=T, terminal="none", solver="daqp", **form)
                    ratios[name].append(noisy_cost(settings, seed, sigma, steps) / best)
            text = "  ".join(f"{name}: {np.median(values):.3f}" for name, values in ratios.items())
            print(f"  T = {T:5d} sigma = {sigma:5.0e}  {text}", flush=True)
            ours = float(np.median(ratios["this controller"]))
            if sigma == 1e-2 and ours > 1.02:
                yield f"noise 1e-2 at T = {T}: cost ratio {ours:.3f}"


def drift(shifts):
    print("window shifted            largest error of the prediction matrices, 10 % excitation")
    rng = np.random.Generator(np.random.PCG64(8))
    settings = DeepcSettings(**BASE, T=100, terminal="none", solver="daqp", data_policy="sliding")
    plant, controller, _ = begin(settings, 3)
    controller.step(np.zeros(2))
    checks = {100, shifts // 10, shifts}
    errors = {}
    for k in range(1, shifts + 1):
        u = np.clip(0.9 * np.sin(k / 300.0) + 0.1 * rng.uniform(-1, 1, 3), -1, 1)
        controller.observe(u, plant.move(u))
        if k in checks:
            errors[k] = float(np.abs(controller._data.predictor().G - plant.G).max())
            print(f"  {k:7d} times           {errors[k]:.1e}", flush=True)
    if max(errors.values()) > 1e-9:
        yield f"drift: error {max(errors.values()):.1e} after {shifts} shifts"


def static_gain(plant):
    """Steady outputs per steady input."""
    return plant.C @ np.linalg.solve(np.eye(len(plant.A)) - plant.A, plant.B)


def references(solves):
    print("references: steps, not solved, largest relative distance from the best steady state in the end")
    each = 200
    for solver, (kind, share, limit) in product(
        ("osqp", "daqp"), (("within reach", 0.6, 1e-5), ("out of reach", 3.0, 1e-5))
    ):
        bad, worst = 0, 0.0
        for seed in range(max(1, solves // each)):
            plant, controller, rng = begin(DeepcSettings(**BASE, solver=solver), 100 + seed)
            gain = static_gain(plant)
            goal = gain @ rng.uniform(-share, share, 3)
            best = gain @ lsq_linear(gain, goal, (-1.0, 1.0), tol=1e-14).x
            for _ in range(each):
                result = controller.step(goal)
                bad += not result.status.solved
                y = plant.move(result.u)
                controller.observe(result.u, y)
            worst = max(worst, np.abs(y - best).max() / max(1.0, np.abs(goal).max()))
        print(f"  {kind}, {solver}: {solves}, {bad}, {worst:.1e}", flush=True)
        if bad or worst > limit:
            yield f"references {kind} with {solver}: {bad} not solved, error {worst:.1e}"


def limits(steps):
    print(
        "limits and equilibrium: steps, not solved, left to the second solver, median and 99 % of the CPU ms of a step"
    )
    each = 100
    kinds = {"rates": {"du_max": 0.3}, "outputs": {"y": 0.6}, "both": {"du_max": 0.3, "y": 0.6}}
    for (kind, how), (reach, share), solver in product(
        kinds.items(), (("within reach", 0.7), ("out of reach", 2.0)), ("osqp", "daqp")
    ):
        names, times = [], []
        for seed in range(max(1, steps // each)):
            gain = static_gain(Plant(3, 2, 6, 200 + seed))
            bound = how.get("y", np.inf) * np.abs(gain).sum(axis=1)
            settings = {**BASE, "solver": solver, "du_max": how.get("du_max", np.inf), "y_min": -bound, "y_max": bound}
            plant, controller, rng = begin(DeepcSettings(**settings), 200 + seed)
            for k in range(each):
                if k % 25 == 0:
                    goal = gain @ rng.uniform(-share, share, 3)
                start = time.process_time()
                result = controller.step(goal)
                times.append(1e3 * (time.process_time() - start))
                names.append(result.status)
                controller.observe(result.u, plant.move(result.u))
        bad, second = sum(not s.solved for s in names), sum(s is Status.SECOND_SOLVER for s in names) / len(names)
        figures = f"{np.median(times):.3f} {np.quantile(times, 0.99):.2f}"
        print(f"  {kind}, {reach}, {solver}: {len(names)}, {bad}, {100 * second:.1f} %, {figures}", flush=True)
        if bad or (reach == "within reach" and second > 0.02):
            yield f"limits on {kind}, references {reach}, {solver}: {bad} not solved, {100 * second:.1f} % handed over"


FIRST_STEP = """
import time

import numpy as np
from ros2_deepc.control import DeepcController, DeepcSettings
c = DeepcController(3, 2, DeepcSettings(N=6, L=14, T=104, q=6, u_min=-1.0, u_max=1.0))
rng, x = np.random.default_rng(0), np.zeros(2)
for k in range(104):
    u = rng.uniform(-1, 1, 3)
    c.observe(u, x)
    x = 0.8 * x + u[:2]
c.step([1.0, 0.0])
print(time.process_time(), *(int(line.split()[1]) / 1024 for line in open("/proc/self/status") if "VmHWM" in line))
"""


def first_step():
    runs = [
        subprocess.run([sys.executable, "-c", FIRST_STEP], capture_output=True, text=True, check=True) for _ in range(5)
    ]
    figures = np.array([[float(v) for v in run.stdout.split()] for run in runs])
    seconds, memory = figures[:, 0].min(), figures[:, 1].max()
    print(f"import, collect and first step in a fresh process: {seconds:.2f} s CPU, {memory:.0f} MB")
    if memory > 80:
        yield f"memory: {memory:.0f} MB"
    if seconds > 1.0:  # half of it on a machine that does nothing else
        yield f"first step: {seconds:.2f} s"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--share", type=float, default=1.0, help="share of the samples to take")
    share = parser.parse_args().share
    started = time.perf_counter()
    with threadpool_limits(1):
        broken = [
            *closed_loop(int(10_000 * share)),
            *noise(max(3, int(10 * share))),
            *drift(int(100_000 * share)),
            *references(int(4000 * share)),
            *limits(int(1000 * share)),
            *first_step(),
        ]
    print(f"{time.perf_counter() - started:.0f} s")
    if broken:
        sys.exit("broken promises:\n  " + "\n  ".join(broken))


if __name__ == "__main__":
    main()
