# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Promises on small samples; benchmarks/deepc_claims.py takes the large ones."""

import subprocess
import sys

import numpy as np
import pytest

from ros2_deepc.behavior import Record, data_matrix
from ros2_deepc.control import DeepcSettings, Status
from ros2_deepc.control.layout import lay_out
from ros2_deepc.control.predictor import Truncation, fit
from ros2_deepc.control.settings import size

BASE = {"N": 6, "L": 14, "q": 6, "Q": 5.0, "R": 1.0, "u_min": -1.0, "u_max": 1.0}


def closed_loop_cost(run, model, goal, steps, oracle=False):
    total = 0.0
    for _ in range(steps):
        if oracle:
            run.apply(model.mpc(run.stepper.z1, [], goal, 5 * np.eye(2), np.eye(3), -1.0, 1.0)[0])
            y = run.stepper.push(run.u[-1])
        else:
            result = run.controller.step(goal)
            assert result.status is Status.SOLVED
            run.apply(result.u)
            y = run.stepper.push(run.u[-1])
            run.y.append(y)
            run.controller.observe(run.u[-1], y + run.noise * run.rng.standard_normal(2))
        total += 5 * np.sum((y - goal) ** 2) + np.sum(run.u[-1] ** 2)
    return total


@pytest.mark.parametrize("T", [100, 400])
def test_noise_costs_two_percent_where_the_printed_problem_costs_much_more(T, plant_form, truth, loop):
    ratios, printed = [], []
    for seed in range(3):
        form, goal = plant_form(100 + seed, feedthrough=False), np.array([1.0, -0.5])
        model = truth(form, 14)
        best = closed_loop_cost(loop(form, DeepcSettings(**BASE, T=T), seed).collect(), model, goal, 80, oracle=True)
        for results, how in ((ratios, {}), (printed, {"noise_block": "free", "cut": "none"})):
            settings = DeepcSettings(**BASE, T=T, terminal="none", solver="daqp", **how)
            run = loop(form, settings, seed, noise=1e-2).collect()
            results.append(closed_loop_cost(run, model, goal, 80) / best)
    assert np.median(ratios) < 1.02
    assert np.median(printed) > 1.1


@pytest.mark.parametrize("noise_block", ["ridge", "free"])
def test_on_exact_data_the_noise_block_changes_nothing(noise_block, plant_form, loop):
    form = plant_form(110)
    plain = loop(form, DeepcSettings(**BASE, terminal="none", solver="daqp"), 1).collect()
    other = loop(form, DeepcSettings(**BASE, terminal="none", solver="daqp", noise_block=noise_block), 1).collect()
    limit = 1e-6 if noise_block == "ridge" else 1e-2  # free: rounding counts as noise without a price
    assert np.abs(plain.step([1.0, 2.0]).u - other.step([1.0, 2.0]).u).max() < limit


def test_doubt_in_the_data_makes_the_plan_gentler(plant_form, loop):
    """With slack on the initial condition a deviation that the slack can explain is not fought with inputs."""
    form = plant_form(111)
    sizes = []
    for slack in (np.inf, 1e-3):
        settings = DeepcSettings(**BASE, T=150, terminal="none", solver="daqp", initial_slack=slack)
        sizes.append(np.linalg.norm(loop(form, settings, 2, noise=1e-2).collect().step([0.0, 0.0]).u_plan))
    assert sizes[1] < 0.9 * sizes[0]


@pytest.mark.parametrize("predictor", ["joint", "causal"])
def test_no_drift(predictor, plant_form, truth, loop):
    """3000 shifts with 10 % excitation on top of a slow swing: as exact as on the first day."""
    form = plant_form(112)
    settings = DeepcSettings(**BASE, T=130, terminal="none", solver="daqp", data_policy="sliding", predictor=predictor)
    run = loop(form, settings, 3).collect()
    model = truth(form, 14)
    run.controller.step([0.0, 0.0])
    for k in range(3000):
        u = 0.9 * np.sin(k / 300.0) + 0.1 * run.rng.uniform(-1, 1, 3)
        run.apply(u)
        run.sense()
    run.controller.step([0.0, 0.0])
    run.controller.prepare()
    z1 = run.stepper.z1
    result = run.controller.step([1.0, 2.0])
    assert np.abs(result.y_plan - model.predict(z1, result.u_plan)).max() < 1e-8


def test_foreign_data_cannot_describe_an_uncontrollable_plant(plant_form, loop):
    """The paper's point: data of another run span the wrong offsets; the data of this run are exact.

    The plant has an uncontrollable constant, seen by the output. The other run began at rest.
    """
    form = plant_form(113, m=3, p=2, q=6, uncontrollable=(1.0,))
    sized = size(DeepcSettings(**BASE), 3, 2)
    rows = lay_out(sized)

    def trajectory(z10, T, seed):
        run = loop(form, DeepcSettings(**BASE), seed, z10=z10)
        for _ in range(T):
            run.sense()
            run.apply(run.excitation())
        return Record(np.array(run.u[:T]), np.array(run.y))

    def inconsistency(own, foreign):
        """Largest part of this run's windows that the other data cannot express, (6.1b)."""
        W = data_matrix([foreign], 20, 20)[rows.stacked]
        X = data_matrix([own], 20, 20)[rows.stacked]
        U, sv, _ = np.linalg.svd(W, full_matrices=False)
        U = U[:, sv > 1e-10 * sv[0]]
        return np.linalg.norm(X - U @ (U.T @ X), 2) / np.linalg.norm(X, 2)

    rng = np.random.Generator(np.random.PCG64(0))
    here = trajectory(rng.normal(size=6), 160, 1)
    own = Record(here.u[:110], here.y[:110])
    later = Record(here.u[110:], here.y[110:])
    at_rest = trajectory(np.zeros(6), 110, 2)
    assert inconsistency(later, own) < 1e-10
    assert inconsistency(later, at_rest) > 1e-3
    # and the predictor from foreign data errs where the one from own data does not
    X = data_matrix([later], 20, 20)[rows.stacked]
    known = np.vstack([X[: rows.known_u], X[rows.inputs : rows.inputs + rows.context]])
    free, future = X[rows.known_u : rows.inputs], X[rows.inputs + rows.context :]
    errors = []
    for data in (own, at_rest):
        W = data_matrix([data], 20, 20)[rows.stacked]
        fitted = fit(W, rows, W.shape[1], Truncation("order", 6))
        errors.append(np.abs(fitted.G @ free + fitted.F @ known - future).max())
    assert errors[0] < 1e-8
    assert errors[1] > 1e-3


FIRST_STEP = """
import numpy as np
from ros2_deepc.control import DeepcController, DeepcSettings
c = DeepcController(3, 2, DeepcSettings(N=6, L=14, T=1600, q=6, u_min=-1.0, u_max=1.0, data_policy="sliding"))
rng, x = np.random.default_rng(0), np.zeros(2)
for k in range(1600):
    u = rng.uniform(-1, 1, 3)
    c.observe(u, x)
    x = 0.8 * x + u[:2]
assert c.step([1.0, 0.0]).status.solved
print(*(line.split()[1] for line in open("/proc/self/status") if line.startswith("VmHWM")))
"""


def test_import_and_first_step_take_little_memory():
    done = subprocess.run([sys.executable, "-c", FIRST_STEP], capture_output=True, text=True, check=True)
    assert float(done.stdout) < 80 * 1024  # kB; the peak that getrusage tells would include the parent's


def test_the_core_needs_no_ros():
    code = "import sys, ros2_deepc.control; print({'rclpy', 'cvxpy', 'matplotlib', 'deepc_msgs'} & set(sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "set()\n"
