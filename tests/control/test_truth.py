# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Against predictive control on the true model, solved by quadprog."""

import numpy as np
import pytest

from ros2_deepc.control import DeepcSettings, Status
from ros2_deepc.control.problem import CALM

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


@pytest.mark.parametrize("solver", ["osqp", "daqp"])
@pytest.mark.parametrize("s", [1, 2])
@pytest.mark.parametrize("seed", range(3))
def test_first_input_with_an_equilibrium_of_its_own(seed, s, solver, plant_form, truth, loop):
    """Weights small enough for a solver that takes all of them into one matrix."""
    form = plant_form(50 + seed, q=5, s=s)
    how = {**BASE, "N": 8, "q": 5, "s": s, "terminal_weight": 1e3, "offset_weight": 100.0}
    run = loop(form, DeepcSettings(**how, solver=solver), seed).collect()
    model, worst, saturated = truth(form, 14), 0.0, 0
    for k in range(40):
        goal = [[0.0, 0.0], [3.0, -2.0], [40.0, 0.5]][k % 40 // 14]
        last = run.committed[-1] if s > 1 else run.u[-1]
        exact = model.equilibrium(run.stepper.z1, run.committed, last, goal, run.settings, CALM)[0]
        result = run.step(goal)
        assert result.status.solved
        worst = max(worst, np.abs(result.u - exact).max())
        saturated += np.abs(exact).max() > 0.999
    assert worst < EXACT[solver]
    assert saturated > 0


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


@pytest.mark.parametrize("solver", ["osqp", "daqp"])
@pytest.mark.parametrize("seed", range(6))
def test_equilibrium_holds_a_reachable_reference(seed, solver, plant_form, loop):
    form = plant_form(40 + seed, m=2, p=2, q=4, radius=(0.3, 0.8))
    dc = form.C1 @ np.linalg.solve(np.eye(4) - form.A1, form.B1) + form.D
    reference = dc @ np.array([0.5, -0.3])
    run = loop(form, DeepcSettings(N=6, L=14, q=4, Q=5.0, R=1.0, u_min=-1.0, u_max=1.0, solver=solver), seed).collect()
    results = [run.step(reference) for _ in range(120)]
    assert all(r.status is Status.SOLVED for r in results)
    assert np.abs(run.y[-1] - reference).max() < 1e-5 * max(1.0, np.abs(reference).max())
    assert results[-1].distance < 1e-5 * max(1.0, np.abs(reference).max())
    assert results[-1].feasible


@pytest.mark.parametrize("seed", range(8))
def test_what_cannot_be_held_ends_at_the_nearest_steady_state(seed, plant_form, loop):
    """One input, two outputs: the nearest point of the line of steady outputs is known."""
    form = plant_form(300 + seed, m=1, q=3, radius=(0.3, 0.8))
    gain = (form.C1 @ np.linalg.solve(np.eye(3) - form.A1, form.B1) + form.D)[:, 0]
    reference = 0.4 * gain + np.array([-gain[1], gain[0]]) / np.linalg.norm(gain)  # off the line by one
    nearest = gain * (gain @ reference) / (gain @ gain)
    run = loop(form, DeepcSettings(N=6, L=14, q=3, Q=5.0, u_min=-1.0, u_max=1.0, solver="daqp"), seed).collect()
    for _ in range(150):
        result = run.step(reference)
    assert np.abs(run.y[-1] - nearest).max() < 1e-4
    assert result.distance == pytest.approx(np.abs(reference - nearest).max(), abs=1e-5)
