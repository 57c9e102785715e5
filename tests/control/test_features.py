# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Limits, masks, previews, disturbances, increments: each against what the plant itself does."""

import numpy as np
import pytest

from plant_sim.stepper import LinearStepper
from ros2_deepc.behavior import SlidingFactor
from ros2_deepc.control import DeepcController, DeepcSettings, NotReadyError, Status
from ros2_deepc.control.qp import Answer

BASE = {"N": 6, "L": 14, "q": 6, "Q": 5.0, "R": 1.0, "u_min": -1.0, "u_max": 1.0}
SOLVERS = ["osqp", "daqp"]


@pytest.mark.parametrize("solver", SOLVERS)
def test_rate_limits_hold_in_plan_and_loop(solver, plant_form, loop):
    run = loop(
        plant_form(1), DeepcSettings(**BASE, terminal="none", du_max=[0.1, 0.2, np.inf], solver=solver), 1
    ).collect()
    run.u[-1][:] = run.u[-2]
    results = [run.step([3.0, -2.0]) for _ in range(30)]
    # the excitation was white: the first samples come from outside what the limits allow from there
    moves = np.abs(np.diff(np.array(run.u[-30:]), axis=0))
    assert moves[:, 0].max() <= 0.1 + 1e-9
    assert moves[:, 1].max() <= 0.2 + 1e-9
    assert moves[:, 2].max() > 0.2
    assert np.abs(np.diff(results[-1].u_plan, axis=0))[:, :2].max() <= 0.2 + 1e-4
    assert {r.status for r in results} <= {Status.SOLVED, Status.SECOND_SOLVER}


@pytest.mark.parametrize("solver", SOLVERS)
def test_output_limits_hold_where_they_can_and_the_slack_is_told(solver, plant_form, loop):
    run = loop(plant_form(2), DeepcSettings(**BASE, terminal="none", y_max=[0.5, np.inf], solver=solver), 2).collect()
    results = [run.step([2.0, 0.0]) for _ in range(40)]
    assert max(y[0] for y in run.y[-30:]) < 0.5 + 2e-3  # the reference lies beyond the limit
    assert min(y[0] for y in run.y[-10:]) > 0.4
    assert all(r.slack[0] < 1e-2 for r in results[10:])
    run = loop(plant_form(2), DeepcSettings(**BASE, terminal="none", y_min=[50.0, 0.0], solver=solver), 2).collect()
    result = run.step([0.0, 0.0])
    assert result.slack[0] > 10
    assert result.slack[0] == pytest.approx(50 - result.y_plan[:, 0].min())
    assert not result.feasible


def test_a_masked_output_is_not_chased(plant_form, loop):
    """One input, two outputs: both references cannot be held; with a mask the other one is."""
    form = plant_form(3, m=1, q=3, radius=(0.3, 0.7))
    dc = form.C1 @ np.linalg.solve(np.eye(3) - form.A1, form.B1) + form.D
    reference = dc[:, 0] * 0.5 + [0.0, 1.0]
    base = {"N": 6, "L": 14, "q": 3, "Q": 5.0, "u_min": -1.0, "u_max": 1.0, "solver": "daqp"}
    both = loop(form, DeepcSettings(**base), 3).collect()
    masked = loop(form, DeepcSettings(**base, mask=[1.0, 0.0]), 3).collect()
    for run in (both, masked):
        for _ in range(80):
            result = run.step(reference)
    assert abs(masked.y[-1][0] - reference[0]) < 1e-5
    assert abs(both.y[-1][0] - reference[0]) > 1e-2
    assert result.distance < 1e-5  # of the outputs that count


def test_mask_weights_and_limits_change_while_running(plant_form, loop):
    run = loop(plant_form(4), DeepcSettings(**BASE, terminal="none", solver="daqp"), 4).collect()
    run.step([3.0, 3.0])
    run.controller.tune(u_max=0.2, R=0.1, mask=[1.0, 0.0])
    assert run.step([30.0, 3.0]).u_plan.max() <= 0.2 + 1e-9
    with pytest.raises(ValueError, match="N cannot change while running"):
        run.controller.tune(N=7)
    with pytest.raises(ValueError, match="no u"):
        run.controller.tune(u_min=3.0)
    assert run.step([30.0, 3.0]).u_plan.max() <= 0.2 + 1e-9  # a refused change changes nothing


def test_a_preview_is_followed_better_than_a_surprise(plant_form, loop):
    form = plant_form(5, radius=(0.5, 0.9))
    k = np.arange(200)
    path = 0.5 * np.column_stack([np.sin(k / 9), np.cos(k / 14)])
    errors = {}
    for preview in (False, True):
        run = loop(form, DeepcSettings(**{**BASE, "R": 0.01}, terminal="none", solver="daqp"), 5).collect()
        start = len(run.y)
        for i in range(120):
            run.step(path[i + 1 : i + 15] if preview else path[i + 1])
        errors[preview] = np.sqrt(np.mean((np.array(run.y[start:]) - path[1:121])[20:] ** 2))
    assert errors[True] < 0.5 * errors[False]


@pytest.mark.parametrize("terminal", ["none", "equilibrium"])
def test_measured_disturbances_are_known_inputs(terminal, plant_form, loop):
    """Third input of the plant as a measured disturbance with a forecast: predictions stay exact."""
    form = plant_form(6, q=4)
    settings = DeepcSettings(
        N=6, L=14, q=4, T=140, u_min=-1.0, u_max=1.0, disturbances=1, terminal=terminal, solver="daqp"
    )
    controller = DeepcController(2, 2, settings)
    rng = np.random.Generator(np.random.PCG64(6))
    stepper = LinearStepper(form, rng.normal(size=4))
    d = np.sin(np.arange(400) / 7) + 0.3 * np.cos(np.arange(400) / 3)  # poor excitation by itself
    u, solved = rng.uniform(-1, 1, 2), 0
    for k in range(200):
        controller.observe(u, stepper.push(np.append(u, d[k])), [d[k]])
        if not controller.ready:
            u = rng.uniform(-1, 1, 2)
            continue
        result = controller.step([0.5, 0.0], forecast=d[k + 1 : k + 15, None])
        u, solved = result.u, solved + 1
        copy = LinearStepper(form, stepper.z1)  # the plan, open loop on the plant itself
        y = np.array([copy.push(np.append(v, d[k + 1 + i])) for i, v in enumerate(result.u_plan)])
        assert np.abs(y - result.y_plan).max() < 1e-8
    assert solved == 61
    assert controller.ready
    with pytest.raises(ValueError, match=r"give \(1,\) or \(14, 1\)"):
        controller.step([0.5, 0.0], forecast=np.zeros((3, 1)))
    with pytest.raises(ValueError, match="d must have shape"):
        controller.observe(u, [0.0, 0.0])


@pytest.mark.parametrize("terminal", ["none", "equilibrium"])
@pytest.mark.parametrize("s", [1, 2])
def test_increments_leave_no_offset_under_a_constant_disturbance(s, terminal, plant_form, loop):
    """An unmeasured constant on the input: absolute predictions miss it, increments do not."""
    form = plant_form(44, m=2, q=4, s=s, radius=(0.3, 0.8))  # its static gain is well conditioned
    errors = {}
    for name in ("absolute", "incremental"):
        settings = DeepcSettings(
            N=7, L=16, q=4, s=s, Q=5.0, R=0.1, u_min=-2.0, u_max=2.0, form=name, terminal=terminal, solver="daqp"
        )
        run = loop(form, settings, 7).collect()
        reference = form.C1 @ np.linalg.solve(np.eye(4) - form.A1, form.B1) @ [0.3, -0.2]
        reference += sum(form.markov()) @ [0.3, -0.2]
        load = run.rng.uniform(-0.05, 0.05, 4)  # a constant load on the states from now on
        for _ in range(150):
            run.step(reference)
            run.stepper._z1 = run.stepper.z1 + load
        errors[name] = np.abs(run.y[-1] - reference).max()
    assert errors["incremental"] < 1e-6
    assert errors["absolute"] > 1e-3


@pytest.mark.parametrize("predictor", ["joint", "causal"])
@pytest.mark.parametrize("policy", ["sliding", "guarded"])
def test_a_moving_window_stays_exact(policy, predictor, plant_form, truth, loop):
    form = plant_form(8)
    settings = DeepcSettings(
        **BASE, T=130, terminal="none", data_policy=policy, dither=0.1, predictor=predictor, solver="daqp"
    )
    run = loop(form, settings, 8).collect()
    model = truth(form, 14)
    for k in range(400):
        z1 = run.stepper.z1
        result = run.step([[1.0, 0.5], [-1.0, 2.0]][k // 50 % 2])
        assert result.status is Status.SOLVED
        if k % 20 == 0:
            assert np.abs(result.y_plan - model.predict(z1, result.u_plan)).max() < 1e-8
    assert run.controller.window_length == 130


def test_a_whisper_of_excitation_is_enough_for_exact_data(plant_form, truth, loop):
    """At rest with a dither of 1e-5: the squared data matrix cannot see the inputs any more, the factor takes over."""
    form = plant_form(9)
    settings = DeepcSettings(**BASE, T=110, terminal="none", data_policy="sliding", dither=1e-5, solver="daqp")
    run = loop(form, settings, 9).collect()
    for _ in range(300):
        run.step([0.0, 0.0])
    assert type(run.controller._data._stream._matrix) is SlidingFactor
    z1 = run.stepper.z1
    result = run.step([1.0, -1.0])
    exact = truth(form, 14).predict(z1, result.u_plan)
    assert np.abs(result.y_plan - exact).max() < 1e-5
    assert "guard" in run.controller.weak


def test_guarded_keeps_the_last_rich_window_and_says_so(plant_form, truth, loop):
    form = plant_form(9)
    model = truth(form, 14)
    run = loop(form, DeepcSettings(**BASE, T=110, data_policy="guarded", solver="daqp"), 9).collect()
    reference = (form.C1 @ np.linalg.solve(np.eye(6) - form.A1, form.B1) + form.D) @ [0.2, 0.1, -0.3]
    for _ in range(250):  # at rest, without dither: the newest window says nothing
        run.step(reference)
    assert "newest window" in run.controller.weak
    assert run.controller.rank < run.controller.rank_need
    z1 = run.stepper.z1
    result = run.step([1.0, -1.0])
    assert np.abs(result.y_plan - model.predict(z1, result.u_plan)).max() < 1e-8
    # the plant is stirred again: the window recovers
    for _ in range(130):
        run.controller.step(reference)
        run.apply(run.excitation())
        run.sense()
        run.controller.prepare()
    assert run.controller.weak == ""


def test_guarded_dithers_only_while_the_window_is_weak(plant_form, loop):
    run = loop(
        plant_form(10), DeepcSettings(**BASE, T=110, data_policy="guarded", dither=0.05, solver="daqp"), 10
    ).collect()
    dithered = []
    for _ in range(400):
        result = run.step([0.0, 0.0])
        dithered.append(np.abs(result.wanted - result.u_plan[0]).max() > 0)
        assert np.abs(result.wanted - result.u_plan[0]).max() <= 0.05
    assert 0 < sum(dithered) < 400
    assert not dithered[0]


@pytest.mark.parametrize("policy", ["fixed", "sliding"])
def test_a_gap_costs_columns_not_the_run(policy, plant_form, truth, loop):
    """Samples are lost while collecting and while controlling: predictions stay exact, no column spans the gap."""
    form = plant_form(11)
    model = truth(form, 14)
    settings = DeepcSettings(**BASE, T=150, terminal="none", data_policy=policy, dither=0.2, solver="daqp")
    run = loop(form, settings, 11)

    def lose(n):
        run.controller.cut()
        for _ in range(n):
            run.apply(run.excitation())
            run.y.append(run.stepper.push(run.u[-1]))
        run.controller.cut()

    for _ in range(60):
        run.sense()
        run.apply(run.excitation())
    run.y.append(run.stepper.push(run.u[-1]))
    lose(5)
    run.apply(run.excitation())
    run.collect()
    for k in range(200):
        if k == 50:
            lose(3)
            with pytest.raises(NotReadyError, match="0 of the 6 unbroken samples"):
                run.controller.step([0.0, 0.0])
            for _ in range(6):
                run.apply(run.excitation())
                run.sense()
        z1 = run.stepper.z1
        result = run.step([1.0, 0.0])
        assert np.abs(result.y_plan - model.predict(z1, result.u_plan)).max() < 1e-7


class Broken:
    """A solver that has gone wrong in one of the ways in which solvers do."""

    name = "broken"

    def __init__(self, how):
        self.how = how

    def load(self, H, A, lower, upper):
        pass

    def solve(self, f, lower, upper):
        if self.how == "throws":
            raise RuntimeError("out of memory")
        x = {"nan": np.nan, "garbage": 2.1e9, "lazy": 0.0}[self.how]
        return Answer(np.full(f.size, x), np.zeros(lower.size), self.how != "gives up", 1, "fine")


@pytest.mark.parametrize("fallback", ["safe", "hold"])
@pytest.mark.parametrize("how", ["throws", "nan", "garbage", "lazy"])
def test_garbage_from_solvers_never_gets_out(how, fallback, plant_form, loop):
    """Both solvers break: the plan goes on to its end, then the fallback; when one is back, so is control."""
    settings = DeepcSettings(**{**BASE, "L": 8}, du_max=0.4, fallback=fallback, u_safe=[0.5, 0.0, 0.0])
    run = loop(plant_form(12), settings, 12).collect()
    good = run.step([0.1, 0.1])
    assert good.status.solved
    healthy = run.controller._planner._main.solver.solvers
    run.controller._planner._main.solver.solvers = (Broken(how), Broken(how))
    results = [run.step([0.1, 0.1]) for _ in range(14)]
    assert [r.status for r in results] == [Status.SHIFTED_PLAN] * 7 + [Status.FALLBACK] * 7
    for i, result in enumerate(results[:7]):
        assert np.abs(result.u - good.u_plan[i + 1]).max() < 1e-4
    expected = [0.5, 0.0, 0.0] if fallback == "safe" else results[6].u
    assert np.allclose(results[-1].u, expected)
    moves = np.abs(np.diff(np.array([r.u for r in results]), axis=0))
    assert moves.max() <= 0.4 + 1e-12  # rate limits hold on the way to the fallback
    assert all("broken: " in r.reason for r in results)
    assert np.isnan(results[-1].y_plan).all()
    assert np.isnan(results[-1].distance)
    run.controller._planner._main.solver.solvers = (Broken(how), healthy[1])
    run.controller._planner._main.solver._loaded[1] = False
    assert run.step([0.1, 0.1]).status is Status.SECOND_SOLVER


@pytest.mark.parametrize("solver", SOLVERS)
def test_from_outside_the_box_there_is_still_a_plan(solver, plant_form, loop):
    """Someone else drove an input far outside its box: the box wins over the rate, and the plan starts there."""
    run = loop(plant_form(12), DeepcSettings(**BASE, du_max=0.1, solver=solver), 12).collect()
    run.apply([4.0, 0.0, 0.0])
    run.sense()
    result = run.step([0.1, 0.1])
    assert result.status.solved
    assert result.u[0] == 1.0 or 0.9 - 1e-3 <= result.u[0] <= 1.0
    assert np.abs(np.diff(result.u_plan, axis=0)).max() < 0.1 + 1e-4


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_hard_end_out_of_reach_of_the_rate_limit_is_reported_and_planned_softly(solver, plant_form, loop):
    """(6.1c) wants the inputs at zero after eight moves; 0.05 a sample does not get there from one."""
    run = loop(plant_form(12), DeepcSettings(**BASE, terminal="hard", du_max=0.05, solver=solver), 12).collect()
    run.apply([1.0, -1.0, 1.0])
    run.sense()
    result = run.step([0.0, 0.0])
    assert result.status.solved
    assert not result.feasible
    assert np.isinf(result.violation).all()
    assert "(6.1c) cannot hold" in result.reason
    assert np.abs(np.diff(result.u_plan, axis=0)).max() < 0.05 + 1e-4


def test_the_second_solver_answers_where_the_first_gives_up(plant_form, loop):
    """Output limits at a price of 1e5 wear OSQP out on this plant; the answers are the exact ones all the same."""
    how = {**BASE, "R": 1e-3, "terminal": "none", "y_max": [0.5, 0.2], "y_min": [-0.5, 0.0], "slack_weight": 1e5}
    results = {}
    for solver in SOLVERS:
        run = loop(plant_form(3), DeepcSettings(**how, solver=solver), 2).collect()
        results[solver] = [run.step([2.0, 1.0]) for _ in range(20)]
    assert sum(r.status is Status.SECOND_SOLVER for r in results["osqp"]) > 10
    assert {r.status for r in results["daqp"]} == {Status.SOLVED}
    assert {r.solver for r in results["osqp"] if r.status is Status.SECOND_SOLVER} == {"daqp"}
    assert all("osqp: " in r.reason for r in results["osqp"] if r.status is Status.SECOND_SOLVER)
    assert max(np.abs(a.u - b.u).max() for a, b in zip(*results.values(), strict=True)) < 1e-3


@pytest.mark.parametrize(
    "how",
    [
        {"mask": 0.0},
        {"mask": 0.0, "terminal": "soft"},
        {"Q": [5.0, 0.0]},
        {"Q": 0.0},
        {"R": [1.0, 0.0, 1.0]},
        {"R": 0.0},
        {"Q": 0.0, "R": 0.0, "terminal": "none"},
        {"offset_weight": 0.0},
        {"terminal_weight": 0.0},
        {"terminal_weight": 1e12},
        {"Q": 1e6, "R": 1e-3},
        {"Q": 1e-6, "R": 1e3},
    ],
)
def test_weights_at_their_limits_leave_a_program_that_both_solvers_solve(how, plant_form, loop):
    runs = [loop(plant_form(1), DeepcSettings(**{**BASE, **how}, solver=solver), 1).collect() for solver in SOLVERS]
    for _ in range(5):
        results = [run.controller.step([0.5, 0.2]) for run in runs]
        assert all(result.status.solved for result in results)
        assert abs(results[0].cost - results[1].cost) <= 1e-5 * max(1.0, results[1].cost)
        for run in runs:
            run.apply(results[1].u)
            run.sense()


def test_bad_samples_are_refused_and_change_nothing(plant_form, loop):
    run = loop(plant_form(13), DeepcSettings(**BASE, solver="daqp"), 13).collect()
    before = run.step([1.0, 0.0])
    for u, y, text in (
        ([0.0, np.nan, 0.0], [0.0, 0.0], r"u\[1\] is nan"),
        ([0.0, 0.0, 0.0], [np.inf, 0.0], r"y\[0\] is inf"),
        ([0.0, 0.0], [0.0, 0.0], "u must have shape"),
        ([0.0, 0.0, 0.0], [0.0], "y must have shape"),
    ):
        with pytest.raises(ValueError, match=text):
            run.controller.observe(u, y)
    for reference, text in (([1.0], "y_ref has shape"), (np.zeros((3, 2)), "y_ref has shape"), ([np.nan, 0], "finite")):
        with pytest.raises(ValueError, match=text):
            run.controller.step(reference)
    assert run.controller.ready
    after = run.step([1.0, 0.0])
    assert after.status is before.status is Status.SOLVED


def test_not_ready_says_what_is_missing():
    controller = DeepcController(1, 1, DeepcSettings(N=2, L=4, q=2, s=2, T=30))
    with pytest.raises(NotReadyError, match="30 more samples: 0 of T = 30"):
        controller.step([0.0])
    for _ in range(40):
        controller.observe([1.0], [1.0])
    assert "excite of order 1, needs 9 and rank 1 is below 9" in controller.missing()
    assert not controller.ready
    controller.reset()
    assert controller.window_length == 0


def test_with_an_index_of_two_the_inputs_between_must_be_known(plant_form, loop):
    run = loop(plant_form(14, q=4, s=2), DeepcSettings(N=7, L=10, q=4, s=2, u_min=-1.0, u_max=1.0), 14).collect()
    run.controller._ahead = []
    with pytest.raises(NotReadyError, match=r"commit\(\) the 1 input"):
        run.controller.step([0.0, 0.0])


def test_own_answers_are_committed_unless_told_otherwise(plant_form, loop):
    form = plant_form(15, q=4, s=3)
    settings = DeepcSettings(N=8, L=10, q=4, s=3, u_min=-1.0, u_max=1.0, solver="daqp")
    told, silent = loop(form, settings, 15).collect(), loop(form, settings, 15).collect()
    for _ in range(5):
        a = told.step([0.3, 0.1])
        b = silent.controller.step([0.3, 0.1])
        silent.u.append(b.u)
        silent.y.append(silent.stepper.push(b.u))
        silent.controller.observe(silent.u[len(silent.y) - 1], silent.y[-1])
        assert np.array_equal(a.u, b.u)
