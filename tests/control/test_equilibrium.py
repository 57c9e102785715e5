# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Terminal "equilibrium" against quadprog on the true model, with rest at the end as equality rows."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from ros2_deepc.control import DeepcSettings, Status

BASE = {"N": 8, "L": 16, "q": 5, "Q": 5.0, "R": 1.0, "u_min": -1.0, "u_max": 1.0}
EXACT = {"osqp": 1e-4, "daqp": 1e-8}
LIMITS = {
    "box": {},
    "rates": {"du_max": 0.3},
    "outputs": {"y_max": 1.5, "y_min": -2.0},
    "all": {"du_max": 0.3, "y_max": [1.5, np.inf]},
}


def static_gain(form):
    """Steady outputs per steady input; uncontrollable modes take no part in it."""
    return form.C1 @ np.linalg.solve(np.eye(len(form.A1)) - form.A1, form.B1) + form.markov().sum(axis=0)


def compare(run, model, goal):
    """One step beside the hard version: (plan's error or None where it is infeasible, result)."""
    last = run.committed[-1] if run.settings.s > 1 else run.u[-1]
    y_scale = np.exp2(np.round(np.log2(run.controller._data.scale[1])))
    exact = model.equilibrium(run.stepper.z1, run.committed, last, goal, run.settings, y_scale)
    result = run.step(goal)
    assert result.status.solved
    return None if exact is None else np.abs(result.u_plan - exact).max(), result


@pytest.mark.parametrize("solver", ["osqp", "daqp"])
@pytest.mark.parametrize("limits", LIMITS)
@pytest.mark.parametrize("s", [1, 2, 3])
@pytest.mark.parametrize("uncontrollable", [(), (0.6,)])
def test_the_plan_is_that_of_the_hard_version(uncontrollable, s, limits, solver, plant_form, truth, loop):
    """References within reach and far out of it: wherever rest can be had at all, the plan has it, and is optimal."""
    form = plant_form(50 + s, q=5, s=s, uncontrollable=uncontrollable)
    run = loop(form, DeepcSettings(**BASE, **LIMITS[limits], s=s, solver=solver), s).collect()
    model, gain, feasible = truth(form, 16), static_gain(form), 0
    for k in range(36):
        if k % 12 == 0:
            goal = gain @ run.rng.uniform(-1, 1, 3) * [0.8, 2.0, 1.5][k // 12]
        error, result = compare(run, model, goal)
        assert ("ends at rest" in result.reason) == (error is None)
        if error is not None:
            feasible += 1
            assert error < EXACT[solver]
            assert result.violation.max() < 0.1 * EXACT[solver]
    assert feasible > 20


@pytest.mark.parametrize("s", [1, 2])
@pytest.mark.parametrize("seed", range(3))
def test_a_light_price_is_a_price(seed, s, plant_form, truth, loop):
    form = plant_form(50 + seed, q=5, s=s)
    settings = DeepcSettings(**BASE, s=s, terminal_weight=5.0, offset_weight=8.0, solver="daqp")
    run, model = loop(form, settings, seed).collect(), truth(form, 16)
    for k in range(30):
        error, result = compare(run, model, [[0.0, 0.0], [3.0, -2.0], [40.0, 0.5]][k // 10])
        assert error < 1e-8
    assert result.violation.max() > 1e-4


@pytest.mark.parametrize("solver", ["osqp", "daqp"])
def test_while_a_mode_that_inputs_do_not_reach_decays_there_is_an_answer(solver, plant_form, truth, loop):
    """It was struck from outside and does not die out within the plan: rest cannot be had, then more and more of it."""
    form = plant_form(51, q=5, uncontrollable=(0.7,))
    run = loop(form, DeepcSettings(**BASE, solver=solver), 3).collect()
    model, goal = truth(form, 16), static_gain(form) @ [0.4, -0.2, 0.3]
    values, vectors = np.linalg.eig(form.A1.T)
    mode = np.real(vectors[:, np.argmin(np.abs(values - 0.7))])  # no input moves mode @ z1
    assert np.abs(mode @ form.B1).max() < 1e-9
    kick = np.real(np.linalg.eig(form.A1)[1][:, np.argmin(np.abs(np.linalg.eig(form.A1)[0] - 0.7))])
    run.stepper._z1 = run.stepper.z1 + 20 * kick / np.abs(form.C1 @ kick).max()
    for _ in range(BASE["N"]):  # until the past shows it
        run.step(goal)
    errors, results = zip(*(compare(run, model, goal) for _ in range(90)), strict=True)
    slacks = [result.violation.max() for result in results]
    assert errors[0] is None
    assert slacks[0] > 1e-3
    assert slacks[-1] < 1e-7
    assert max(later / before for before, later in zip(slacks[:20], slacks[10:30], strict=True)) < 0.1
    assert max(error for error in errors[-20:]) < EXACT[solver]
    assert np.abs(run.y[-1] - goal).max() < 1e-5


@pytest.mark.parametrize("solver", ["osqp", "daqp"])
@pytest.mark.parametrize("seed", range(4))
def test_out_of_reach_ends_at_the_nearest_steady_state_within_the_box(seed, solver, plant_form, loop):
    form = plant_form(70 + seed, m=2, q=5, radius=(0.3, 0.8))
    gain = static_gain(form)
    goal = gain @ [1.7, -0.4] + [0.0, 0.3]
    nearest = gain @ lsq_linear(gain, goal, (-1.0, 1.0), tol=1e-14).x
    run = loop(form, DeepcSettings(**BASE, solver=solver), seed).collect()
    for _ in range(150):
        result = run.step(goal)
    size = np.abs(goal).max()
    assert np.abs(run.y[-1] - nearest).max() < (1e-8 if solver == "daqp" else 1e-5) * size
    assert result.distance == pytest.approx(np.abs(goal - nearest).max(), abs=1e-5 * size)


@pytest.mark.parametrize("solver", ["osqp", "daqp"])
@pytest.mark.parametrize("limits", ["rates", "outputs", "all"])
@pytest.mark.parametrize("seed", range(3))
def test_never_without_an_answer(seed, limits, solver, plant_form, loop):
    """References thrown about beyond reach, rests that limits forbid."""
    run = loop(plant_form(80 + seed, q=5), DeepcSettings(**BASE, **LIMITS[limits], solver=solver), seed).collect()
    restless, goals = 0, run.rng.uniform(-20, 20, (18, 2))
    for k in range(120):
        goal = goals[k // 7]
        if k % 30 == 20:
            run.stepper._z1 = run.stepper.z1 + 5 * run.rng.standard_normal(5)  # struck from outside
        result = run.step(goal)
        assert result.status.solved
        assert (result.status is Status.SECOND_SOLVER) == (f"{solver}: " in result.reason)
        restless += "ends at rest" in result.reason
        assert np.abs(result.u).max() <= 1.0
    assert restless < 100


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
