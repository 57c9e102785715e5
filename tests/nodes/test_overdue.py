# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Outputs that stop coming in real time, and a controller that is stopped: the field always gets a defined command."""

import time

import numpy as np
import pytest
from deepc_msgs.msg import Sample
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.parameter import Parameter

from ros2_deepc.bags.replay import replay
from ros2_deepc.control.modes import Mode
from ros2_deepc.nodes.recorder_node import RecorderNode
from ros2_deepc.nodes.replaying import cores
from ros2_deepc.ros.run import EXECUTORS

from .rig import SETTINGS, rigged

TS = 0.1  # [s]


@pytest.fixture(params=EXECUTORS)
def rig(request, domain_id):
    """See `rigged`."""
    with rigged(domain_id, request.param) as made:
        yield made


def silent(rig, mode):
    """The plant says nothing until the clock has led to a mode."""
    rig.until(lambda: rig.plant.states[-1].overdue and rig.mode is mode)


@pytest.mark.parametrize("policy", ["hold", "ramp", "release"])
def test_outputs_that_stop_coming_end_in_the_fallback_which_goes_on_commanding(rig, policy):
    told = []
    rig.start(TS, fallback_policy=policy, u_safe=[0.25], patience=3, max_hold=40)
    rig.plant.create_subscription(DiagnosticArray, "/diagnostics", lambda msg: told.extend(msg.status), 10)
    rig.until(lambda: rig.plant.count_publishers("/diagnostics") == 1)
    rig.run(25)
    last = rig.plant.inputs[25]
    silent(rig, Mode.HOLDING)
    held = [state.k for state in rig.plant.states if state.overdue]
    silent(rig, Mode.FALLBACK)
    given = len(rig.plant.given)
    if policy == "release":
        rig.until(lambda: sum(state.overdue for state in rig.plant.states) > len(held) + 5)
        assert len(rig.plant.given) == given
    else:
        rig.until(lambda: len(rig.plant.given) > given + 5)
        newest = rig.plant.inputs[max(rig.plant.given)]
        np.testing.assert_allclose(newest, last if policy == "hold" else [0.25], atol=1e-12)
    for k in held:
        np.testing.assert_array_equal(rig.plant.inputs[k + 1], last)
    assert rig.plant.states[-1].deadline_misses == sum(state.overdue for state in rig.plant.states)
    assert "samples, more than 3 are not bridged" in rig.plant.states[-1].reason
    assert told[-1].level == DiagnosticStatus.ERROR
    assert told[-1].message.startswith("FALLBACK; outputs are overdue")


def test_outputs_that_were_only_late_are_taken_and_no_input_is_given_twice(rig):
    rig.start(TS, patience=3, max_hold=20)
    rig.run(25)
    silent(rig, Mode.FALLBACK)
    rig.until(lambda: len(rig.plant.given) > 28)
    decided = max(rig.plant.given)
    rig.plant.states.clear()
    while rig.plant.k <= decided:  # the plant had stood still: it goes on with k = 25
        rig.run(1)
    rig.until(lambda: rig.ask("CONTROLLING").success)
    rig.run(6)
    assert rig.mode is Mode.CONTROLLING
    assert len(set(rig.plant.given)) == len(rig.plant.given)
    rig.window_is_true()


def test_commands_by_the_clock_end_after_max_hold_samples(rig):
    rig.start(0.02, patience=2, max_hold=6)
    rig.run(25)
    rig.until(lambda: rig.node._overdue - rig.node._k >= 6)
    count = len(rig.plant.given)
    end = time.monotonic() + 10 * 0.02
    rig.until(lambda: time.monotonic() > end)
    assert len(rig.plant.given) == count
    assert rig.mode is Mode.FALLBACK


def test_no_patience_means_never(rig):
    rig.start(0.02, patience=0)
    rig.run(25)
    end = time.monotonic() + 20 * 0.02
    rig.until(lambda: time.monotonic() > end)
    assert not any(state.overdue for state in rig.plant.states)


@pytest.mark.parametrize("stop", ["safe", "hold"])
@pytest.mark.parametrize("mode", ["COLLECTING", "CONTROLLING", "HOLDING", "FALLBACK", "release", "SHADOW"])
def test_a_controller_that_is_stopped_leaves_the_configured_input_behind(rig, mode, stop):
    rig.start(stop=stop, u_safe=[0.25], fallback_policy="release" if mode == "release" else "hold")
    rig.run(10 if mode == "COLLECTING" else 25)
    if mode == "HOLDING":
        rig.lose(1)
        rig.run(1)
    elif mode in ("FALLBACK", "release", "SHADOW"):
        assert rig.ask("SHADOW" if mode == "SHADOW" else "FALLBACK").success
        rig.run(1)
    assert rig.mode.name == ("FALLBACK" if mode == "release" else mode)
    before, given = max(rig.plant.inputs), len(rig.plant.given)
    rig.node.quiesce()
    if stop == "hold" or mode in ("release", "SHADOW"):
        rig.plant.outputs.publish(Sample())  # time for a message to come, if there were one
        rig.until(lambda: rig.node.count_publishers("outputs") == 1)
        assert len(rig.plant.given) == given
    else:
        rig.until(lambda: len(rig.plant.given) > given)
        assert rig.plant.given[-1] == before + 1
        np.testing.assert_array_equal(rig.plant.inputs[before + 1], [0.25])


def test_what_operators_and_the_clock_did_is_in_the_bag_and_replays_to_the_bit(rig, tmp_path):
    rig.start(TS, patience=3, fallback_policy="ramp")
    folder = [Parameter("folder", value=str(tmp_path / "bag"))]
    recorder = RecorderNode(context=rig.context, parameter_overrides=folder, use_global_arguments=False)
    rig.executor.add_node(recorder)
    recorder.start()
    readers = {"outputs": 2, "inputs": 2, "controller/state": 2, "controller/changes": 1}
    rig.until(lambda: all(rig.node.count_subscribers(name) == count for name, count in readers.items()))
    rig.plant.announce(epoch=2)  # from here on, all of it is recorded
    rig.plant.k, rig.plant.x = 0, np.array([1.0, -1.0])
    rig.plant.inputs.clear()
    rig.until(lambda: 0 in rig.plant.inputs)
    rig.run(25)
    (result,) = rig.node.set_parameters([Parameter("R", value=[0.5])])
    assert result.successful
    rig.run(5)
    silent(rig, Mode.FALLBACK)
    rig.lose(max(rig.plant.given) - rig.plant.k + 2)
    rig.run(3)
    assert rig.ask("CONTROLLING").success
    rig.run(5)
    assert rig.ask("COLLECTING").success
    rig.run(25)
    assert rig.mode is Mode.CONTROLLING
    rig.node.quiesce()
    rig.until(recorder.drained)
    parameters = {"controller": SETTINGS | {"patience": 3, "fallback_policy": "ramp"}}
    recorder.stop()
    again = replay(tmp_path / "bag", {"controller": cores(parameters)["controller"]})
    assert again.same, (again.differences, again.unmatched)
    assert again.compared["controller/state"] >= 63
