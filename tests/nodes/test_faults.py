# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Faults on the topics against the controller node: mode, command, counters, and nothing false in the window."""

from collections import Counter

import numpy as np
import pytest
from deepc_msgs.msg import Sample
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from ros2_deepc.control.modes import Mode
from ros2_deepc.ros.convert import sample

from .rig import T, rigged


@pytest.fixture
def rig(domain_id):
    """See `rigged`."""
    with rigged(domain_id) as made:
        yield made


def spoiled(msg, fault):
    """The message as a fault leaves it."""
    if fault == "nan":
        msg.values = [float("nan")]
    elif fault == "inf":
        msg.values = [float("inf")]
    elif fault == "size":
        msg.values = [0.0, 0.0]
    elif fault == "empty":
        msg.values = []
    elif fault == "epoch":
        msg.epoch = 7
    elif fault == "quality":
        msg.quality = [Sample.BAD]
    return msg


def test_an_undisturbed_run_collects_and_controls(rig):
    rig.start()
    rig.run(40)
    counts = Counter(Mode(state.mode).name for state in rig.plant.states)
    assert counts == {"COLLECTING": T - 1, "CONTROLLING": 40 - T + 1}
    assert abs(rig.plant.y_log[-1][0] - 0.5) < 0.2
    assert rig.node.refused == rig.node._agent.lost == rig.node._agent.failures == 0


@pytest.mark.parametrize("fault", ["nan", "inf", "size", "empty", "epoch", "quality"])
@pytest.mark.parametrize("when", [10, 25])
def test_a_spoiled_sample_is_refused_and_the_run_goes_on(rig, fault, when):
    rig.start()
    rig.run(when)
    rig.publish(spoiled(rig.plant.sample(), fault))
    assert rig.node.refused == 1
    rig.run(1)
    assert rig.mode is (Mode.COLLECTING if when < T else Mode.HOLDING)
    rig.run(30)
    assert rig.mode is Mode.CONTROLLING
    assert rig.node._agent.lost == 1
    rig.window_is_true()


def test_two_plants_at_once_end_the_control_with_one_line(rig):
    rig.start()
    rig.run(T + 5)
    for _ in range(3):
        msg = rig.plant.sample()
        rig.publish(msg)
        refused, msg.values = rig.node.refused, [msg.values[0] + 1.0]
        rig.plant.outputs.publish(msg)
        rig.until(lambda: rig.node.refused > refused or rig.node.fault)  # noqa: B023
    assert rig.node.fault == "two plants publish outputs in /: stop one of them"
    rig.until(lambda: max(rig.plant.inputs) == msg.k + 2)  # the last input, u_safe, after the one for outputs k
    assert rig.plant.inputs[msg.k + 2] == 0.0


@pytest.mark.parametrize("values", [[float("nan")], [0.5, 0.5], [], [float("inf")]])
def test_a_reference_that_cannot_be_used_is_refused_and_the_one_before_holds(rig, values):
    rig.start()
    rig.run(T + 5)
    bad = sample("p", 1, 0, np.array(values), 1)  # from sample 0 on, as the good one
    rig.plant.reference.publish(bad)
    rig.until(lambda: rig.node.refused == 1)
    rig.run(3)
    assert rig.mode is Mode.CONTROLLING
    assert list(rig.plant.states[-1].reference) == [0.5]
    rig.plant.x, rig.plant.k, rig.plant.inputs = np.array([1.0, -1.0]), 0, {}
    rig.plant.announce(epoch=2)  # nor is it what a new run begins with
    rig.until(lambda: 0 in rig.plant.inputs)
    rig.run(T + 5)
    assert rig.mode is Mode.CONTROLLING
    assert list(rig.plant.states[-1].reference) == [0.5]


def test_of_references_without_end_only_the_newest_are_kept(rig):
    rig.start()
    for k in range(1, 251):
        rig.plant.reference.publish(sample("p", 1, k, np.array([0.5]), 1))
        rig.until(lambda k=k: rig.node._agent.references.at(k) is not None and k in rig.node._early)
    assert list(rig.node._early) == list(range(151, 251))


@pytest.mark.parametrize("when", [10, 25])
def test_a_duplicate_changes_nothing(rig, when):
    rig.start()
    rig.run(when)
    again = rig.plant.sample()
    rig.publish(again)
    rig.publish(again)
    assert rig.node.refused == 1
    rig.run(20)
    assert rig.mode is Mode.CONTROLLING
    assert rig.node._agent.lost == 0
    rig.window_is_true()


def test_swapped_samples_count_as_one_lost_and_one_refused(rig):
    rig.start()
    rig.run(25)
    first, second = rig.plant.sample(), rig.plant.sample()
    rig.publish(second)
    rig.publish(first)
    assert (rig.node.refused, rig.node._agent.lost) == (1, 1)
    assert rig.mode is Mode.HOLDING
    rig.run(3)
    assert rig.mode is Mode.CONTROLLING
    rig.window_is_true()


@pytest.mark.parametrize("gap", [1, 2, 3])
def test_a_short_gap_is_bridged_by_holding(rig, gap):
    rig.start()
    rig.run(25)
    before = rig.plant.inputs[25]
    rig.lose(gap)
    rig.run(1)
    assert rig.mode is Mode.HOLDING
    np.testing.assert_array_equal(rig.plant.u_log[-1], before)  # the plant held what it had
    rig.run(3)
    assert rig.mode is Mode.CONTROLLING
    assert rig.node._agent.lost == gap
    rig.window_is_true()


def test_a_long_gap_falls_back_until_an_operator_acknowledges(rig):
    rig.start()
    rig.run(25)
    rig.lose(4)
    rig.run(5)
    assert rig.mode is Mode.FALLBACK
    assert "4 samples were lost at once" in rig.plant.states[-1].reason
    assert len({float(rig.plant.inputs[k][0]) for k in range(31, 35)}) == 1  # holds
    answer = rig.ask("CONTROLLING")
    assert answer.success, answer.message
    rig.run(1)
    assert rig.mode is Mode.CONTROLLING
    rig.window_is_true()


def test_the_ramp_ends_at_the_safe_input(rig):
    rig.start(fallback_policy="ramp", u_safe=[0.25])
    rig.run(25)
    assert rig.ask("FALLBACK").success
    rig.run(6)
    steps = np.array([rig.plant.inputs[k][0] for k in range(25, 32)])
    np.testing.assert_allclose(np.diff(steps)[:4], (0.25 - steps[0]) / 4, atol=1e-12)
    np.testing.assert_allclose(steps[4:], 0.25)


def test_release_publishes_no_more_inputs(rig):
    rig.start(fallback_policy="release")
    rig.run(25)
    assert rig.ask("FALLBACK").success
    last = max(rig.plant.inputs)
    rig.run(5)
    assert rig.mode is Mode.FALLBACK
    assert max(rig.plant.inputs) == last


def test_losses_that_never_end_are_not_held_for_ever(rig):
    rig.start()
    rig.run(25)
    for _ in range(10):
        rig.lose(1)
        rig.run(1)
    assert rig.mode is Mode.FALLBACK
    assert "held for 9 samples" in rig.plant.states[-1].reason


def test_lost_inputs_are_seen_in_the_outputs(rig):
    rig.start()
    rig.run(25)
    lost = rig.plant.inputs.pop(25)
    rig.run(1)  # the plant holds u(24) at k = 25 and says so
    assert rig.plant.u_log[25][0] == rig.plant.u_log[24][0] != lost[0]
    rig.run(10)
    assert rig.mode is Mode.CONTROLLING
    assert rig.node._agent.lost == 0
    rig.window_is_true()


def test_lost_inputs_while_collecting_leave_true_data(rig):
    rig.start()
    rig.run(8)
    rig.plant.inputs.pop(8)
    rig.run(30)
    assert rig.mode is Mode.CONTROLLING
    rig.window_is_true()


def test_a_plant_that_restarts_is_learned_anew(rig):
    rig.start()
    rig.run(25)
    rig.plant.k, rig.plant.x = 0, np.array([-2.0, 1.0])
    rig.plant.inputs.clear()
    rig.plant.announce(epoch=2)
    rig.until(lambda: 0 in rig.plant.inputs)
    rig.run(5)
    assert rig.mode is Mode.COLLECTING
    rig.run(25)
    assert rig.mode is Mode.CONTROLLING
    rig.window_is_true()


def test_a_bag_that_loops_is_a_new_run_each_time(rig):
    rig.start()
    rig.run(25)
    rig.plant.k, rig.plant.x = 0, np.array([1.0, -1.0])
    rig.publish(rig.plant.sample())  # the numbers start again and nothing says why
    assert rig.node.refused == 1
    rig.plant.k, rig.plant.x = 0, np.array([1.0, -1.0])
    rig.plant.inputs.clear()
    rig.plant.announce(epoch=1)
    rig.until(lambda: 0 in rig.plant.inputs)
    rig.run(30)
    assert rig.mode is Mode.CONTROLLING
    assert rig.plant.states[-1].k == 29
    rig.window_is_true()


@pytest.mark.parametrize("jump", [-3_600_000_000_000, -10, 3_600_000_000_000])
@pytest.mark.parametrize("when", [10, 25])
def test_no_data_span_a_jump_of_the_clock(rig, when, jump):
    rig.start()
    rig.run(when)
    rig.plant.jump = jump - 1_000_000_000 if jump < 0 else jump
    rig.run(1)
    assert rig.node.jumps == 1
    assert rig.mode is (Mode.COLLECTING if when < T else Mode.HOLDING)
    rig.run(30)
    assert rig.mode is Mode.CONTROLLING
    assert (rig.node.jumps, rig.node._agent.lost, rig.node.refused) == (1, 0, 0)
    rig.window_is_true()


def test_a_controller_that_starts_late_joins_a_running_plant(rig):
    rig.start()
    rig.plant.k = 57  # the plant has been running on inputs of its own
    rig.plant.inputs.clear()
    rig.run(1)
    assert rig.node._agent.lost == 1  # nobody knows what moved the plant at k = 57
    rig.run(40)
    assert rig.mode is Mode.CONTROLLING
    rig.window_is_true()


def test_reset_collects_again(rig):
    rig.start()
    rig.run(25)
    answer = rig.call(Trigger, "controller/reset", Trigger.Request())
    assert answer.success
    rig.run(3)
    assert rig.mode is Mode.COLLECTING
    assert rig.plant.states[-1].window == 3
    rig.run(25)
    assert rig.mode is Mode.CONTROLLING


@pytest.mark.parametrize(
    ("run", "asked", "success", "hint"),
    [
        (5, "CONTROLLING", False, "cannot be entered from COLLECTING"),
        (25, "IDLE", False, "entered by the controller itself"),
        (25, "HOLDING", False, "entered by the controller itself"),
        (25, "SHADOW", True, "now SHADOW"),
        (25, "FALLBACK", True, "now FALLBACK"),
        (25, "COLLECTING", True, "now COLLECTING"),
    ],
)
def test_requests_follow_the_table(rig, run, asked, success, hint):
    rig.start()
    rig.run(run)
    answer = rig.ask(asked)
    assert answer.success is success
    assert hint in answer.message


def test_shadow_computes_and_moves_nothing(rig):
    rig.start()
    rig.run(25)
    assert rig.ask("SHADOW").success
    last = max(rig.plant.inputs)
    rig.run(5)
    assert max(rig.plant.inputs) == last
    assert rig.mode is Mode.SHADOW
    assert list(rig.plant.states[-1].input) == []


@pytest.mark.parametrize(
    ("name", "value", "hint"),
    [("R", [0.5], ""), ("N", 5, "read-only"), ("Q", [-1.0], "out of range"), ("u_max", [-2.0], "exceeds u_max")],
)
def test_live_parameters_are_checked_together_and_applied_at_the_next_sample(rig, name, value, hint):
    rig.start()
    rig.run(25)
    (result,) = rig.node.set_parameters([Parameter(name, value=value)])
    assert result.successful is (hint == "")
    assert hint in result.reason
    rig.run(2)
    assert rig.mode is Mode.CONTROLLING
    if not hint:
        assert rig.node._agent.settings.R in (0.5, (0.5,))
