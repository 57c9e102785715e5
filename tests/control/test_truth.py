# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Against predictive control on the true model, solved by quadprog."""

import numpy as np
import pytest

from ros2_deepc.control import DeepcSettings, Status

EXACT = {"osqp": 1e-4, "daqp": 1e-9}
BASE = {"N": 6, "L": 14, "q": 6, "Q": 5.0, "R": 1.0, "u_min": -1.0, "u_max": 1.0}


@pytest.mark.parametrize("s", [1, 2, 3])
@pytest.mark.parametrize("seed", range(5))
def test_predictions_are_the_plants(seed, s, plant_form, truth, loop):
    form = plant_form(seed, q=5, s=s)
    run = loop(form, DeepcSettings(**{**BASE, "N": 8, "q": 5, "s": s}, terminal="none"), seed).collect()
    model = truth(form, 14)
    for k in range(15):
        z1, committed = run.stepper.z1, run.committed
        result = run.step([np.sin(k), 1.0])
        exact = model.predict(z1, np.vstack([committed, result.u_plan]))
        assert np.abs(result.y_plan - exact).max() < 1e-8 * max(1, np.abs(exact).max())


@pytest.mark.parametrize("solver", ["osqp", "daqp"])
@pytest.mark.parametrize("s", [1, 2, 3])
@pytest.mark.parametrize("seed", range(4))
def test_first_input_with_a_box(seed, s, solver, plant_form, truth, loop):
    form = plant_form(10 + seed, q=5, s=s)
    run = loop(form, DeepcSettings(**{**BASE, "N": 8, "q": 5, "s": s}, terminal="none", solver=solver), seed).collect()
    model, worst, saturated = truth(form, 14), 0.0, 0
    for k in range(40):
        goal = [[0.0, 0.0], [3.0, -2.0], [40.0, 0.5]][k % 40 // 14]
        exact = model.mpc(run.stepper.z1, run.committed, goal, 5 * np.eye(2), np.eye(3), -1.0, 1.0)[0]
        result = run.step(goal)
        assert result.status is Status.SOLVED
        worst = max(worst, np.abs(result.u - exact).max())
        saturated += np.abs(exact).max() > 0.999
    assert worst < EXACT[solver]
    assert saturated > 5


@pytest.mark.parametrize("solver", ["osqp", "daqp"])
@pytest.mark.parametrize("seed", range(4))
def test_first_input_with_the_printed_terminal_condition(seed, solver, plant_form, truth, loop):
    form = plant_form(20 + seed, radius=(0.3, 0.7))
    run = loop(form, DeepcSettings(**BASE, terminal="hard", solver=solver), seed).collect()
    model, feasible, worst = truth(form, 14), 0, 0.0
    for _ in range(30):
        z1 = run.stepper.z1
        result = run.step([0.0, 0.0])
        if result.feasible:
            exact = model.mpc(z1, [], [0.0, 0.0], 5 * np.eye(2), np.eye(3), -1.0, 1.0, zero_tail=6)
            feasible += 1
            worst = max(worst, np.abs(result.u - exact[0]).max())
            assert np.abs(result.u_plan[-6:]).max() < 1e-9
            assert np.abs(result.y_plan[-6:]).max() < 1e-4
    assert feasible > 20
    assert worst < EXACT[solver]


@pytest.mark.parametrize("terminal", ["equilibrium", "soft", "hard"])
@pytest.mark.parametrize("seed", range(3))
def test_heavy_prices_leave_the_approximate_solver_as_accurate(seed, terminal, plant_form, loop):
    """Default weights, ten million times apart: the first input of OSQP against that of the exact solver."""
    runs = {}
    for solver in EXACT:
        runs[solver] = loop(plant_form(60 + seed), DeepcSettings(**BASE, terminal=terminal, solver=solver), 1).collect()
    for k in range(45):
        goal = [[0.0, 0.0], [3.0, -2.0], [0.8, 0.5]][k // 15]
        results = {solver: run.controller.step(goal) for solver, run in runs.items()}
        assert all(result.status.solved for result in results.values())
        assert np.abs(results["osqp"].u - results["daqp"].u).max() < EXACT["osqp"]
        for run in runs.values():
            run.apply(results["daqp"].u)
            run.sense()


@pytest.mark.parametrize("seed", range(3))
def test_smallest_violation_is_the_linear_programs(seed, plant_form, truth, loop):
    from scipy.optimize import linprog

    form = plant_form(30 + seed)
    run = loop(form, DeepcSettings(**BASE, terminal="hard", solver="daqp"), seed).collect()
    model, goal = truth(form, 14), np.array([2.0, -1.0])
    for _ in range(5):
        z1 = run.stepper.z1
        result = run.step(goal)
        assert not result.feasible
        G = model.T[:, : 3 * 8]  # the last 6 inputs are zero
        for i in range(2):
            rows = np.arange(28).reshape(14, 2)[-6:, i]
            one = np.ones((6, 1))
            e = (model.O @ z1)[rows] - goal[i]
            A = np.vstack([np.hstack([G[rows], -one]), np.hstack([-G[rows], -one])])
            lp = linprog(np.append(np.zeros(24), 1), A, np.concatenate([-e, e]), bounds=[(-1, 1)] * 24 + [(0, None)])
            assert result.violation[i] == pytest.approx(lp.fun, abs=1e-6)
