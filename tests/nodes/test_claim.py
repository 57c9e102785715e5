# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Two controllers and one plant, over DDS: one commands, the other refuses or stands by until the first is gone."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from deepc_msgs.msg import Claim, MonitorReport, Sample, Verdict
from deepc_msgs.srv import SetMode
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter

from plant_sim.plant_node import PlantNode
from ros2_deepc.control.modes import Mode
from ros2_deepc.nodes.controller_node import ControllerNode
from ros2_deepc.nodes.monitor_node import MonitorNode
from ros2_deepc.ros import topics
from ros2_deepc.ros.claim import Claimants
from ros2_deepc.ros.convert import sample
from ros2_deepc.ros.qos import profile
from ros2_deepc.ros.run import EXECUTORS, Spinner, make_executor, ros

DEADLINE = 60.0  # [s]
SETTINGS = {"N": 3, "L": 8, "Q": [1.0], "R": [1.0], "terminal": "none"}


class Witness(Node):
    """Gives the reference, and sees all samples and claims."""

    def __init__(self, lockstep, wake, **kwargs):
        super().__init__("witness", **kwargs)
        self.outputs, self.inputs, self.claims, self.reports = [], [], [], []
        self.reference = self.create_publisher(Sample, "reference", profile(topics.REFERENCE))
        self.reference.publish(sample("wscc9", 1, 0, np.array([0.5, 0.0]), 1))
        self.create_subscription(Claim, "claim", self.claims.append, profile(topics.CLAIM))
        self.create_subscription(MonitorReport, "monitor/report", self.reports.append, profile(topics.REPORT))
        for topic, seen in ((topics.OUTPUTS, self.outputs), (topics.INPUTS, self.inputs)):
            self.create_subscription(Sample, topic.name, self._keeps(seen, wake), profile(topic, lockstep=lockstep))

    @staticmethod
    def _keeps(seen, wake):
        """Lockstep leaves EventsExecutor no gap in which to look at a condition, so every sample wakes it."""

        def keep(msg):
            seen.append(msg)
            wake()

        return keep


@pytest.fixture(params=EXECUTORS)
def zone(request, domain_id):
    """A plant and as many controllers as are asked for, in one process."""
    with ros([], domain_id) as context:
        executor = make_executor(request.param, context)
        spinner = Spinner(executor)
        nodes = []

        class Zone:
            def until(self, condition):
                end = time.monotonic() + DEADLINE
                spinner.until(lambda: condition() or time.monotonic() > end)
                assert condition()

            def plant(self, **parameters):
                lockstep = parameters.get("mode") != "realtime"
                wake = spinner.wake if lockstep else lambda: None
                self.witness = Witness(lockstep, wake, context=context, use_global_arguments=False)
                nodes.append(self.witness)
                executor.add_node(self.witness)
                return self._add(PlantNode, parameters)

            def controller(self, start=True, **parameters):
                return self._add(ControllerNode, SETTINGS | parameters, start)

            def states_of(self, node):
                """The modes in which a controller answers from now on."""
                seen, step = [], node._agent.step
                node._agent.step = lambda *sample: (decision := step(*sample), seen.append(decision.mode))[0]
                return seen

            def monitor(self, **parameters):
                return self._add(MonitorNode, parameters)

            def _add(self, kind, parameters, start=True):
                overrides = [Parameter(name, value=value) for name, value in parameters.items()]
                node = kind(context=context, parameter_overrides=overrides, use_global_arguments=False)
                nodes.append(node)
                executor.add_node(node)
                if start:
                    node.start()
                return node

        yield Zone()
        executor.shutdown()
        for node in nodes:
            if hasattr(node, "stop"):
                node.stop()
            node.destroy_node()


def senders(messages):
    return {int(msg.sender) for msg in messages}


# SingleThreadedExecutor begins each turn with the first node, and in lockstep the last one would never have its own.
@pytest.mark.parametrize(
    ("zone", "mode"), [("events", "lockstep"), ("events", "realtime"), ("single", "realtime")], indirect=["zone"]
)
def test_the_second_controller_refuses_and_the_first_goes_on(zone, mode):
    plant = zone.plant(plant="wscc9", mode=mode, speed=5.0)
    monitor = zone.monitor(window=120, period=40)
    first = zone.controller()
    zone.until(lambda: len(zone.witness.outputs) > 5)
    second = zone.controller()
    zone.until(lambda: second.fault)
    assert "controller, process" in second.fault
    assert "commands wscc9 already: stop it first" in second.fault
    count = len(zone.witness.outputs)
    zone.until(lambda: len(zone.witness.outputs) > count + 60 and len(zone.witness.reports) >= 1)
    strange = {Verdict.PRIOR_VIOLATED, Verdict.REFUTED}
    findings = [f for r in zone.witness.reports for f in (r.r_controllability, r.r_observability)]
    assert not {finding.verdict for finding in findings} & strange  # what the second one sent was not learned from
    assert first.fault == ""
    assert senders(zone.witness.outputs) - {0} == {first._holder.id}  # 0: a held-up machine, the plant helps itself
    assert monitor._follows == first._holder.id
    assert plant.foreign == len([msg for msg in zone.witness.inputs if msg.sender != first._holder.id])


def test_activation_fails_while_another_one_commands_and_works_once_it_is_gone(zone):
    zone.plant(plant="wscc9", mode="realtime", speed=5.0)
    first = zone.controller()
    second = zone.controller(start=False)
    second.trigger_configure()
    zone.until(lambda: len(zone.witness.outputs) > 5)
    zone.until(lambda: second._claimants.commander() is not None)
    assert second.trigger_activate() == TransitionCallbackReturn.FAILURE
    assert "commands wscc9 already" in second.fault
    first.quiesce()
    zone.until(lambda: second._claimants.commander() is None)
    assert second.trigger_activate() == TransitionCallbackReturn.SUCCESS
    zone.until(lambda: zone.witness.outputs[-1].sender == second._holder.id)
    zone.until(lambda: second._agent.mode is Mode.CONTROLLING)


def test_a_controller_on_standby_takes_over_when_the_first_is_stopped(zone):
    zone.plant(plant="wscc9", mode="realtime", speed=5.0)
    first = zone.controller()
    zone.until(lambda: len(zone.witness.outputs) > 5)
    second = zone.controller(standby=True)
    zone.until(lambda: second._waits)
    count = len(zone.witness.inputs)
    zone.until(lambda: len(zone.witness.inputs) > count + 10)
    assert senders(zone.witness.inputs[count:]) == {first._holder.id}
    first.quiesce()
    zone.until(lambda: zone.witness.outputs[-1].sender == second._holder.id)
    zone.until(lambda: second._agent.mode is Mode.CONTROLLING)
    assert second.fault == ""


def test_a_standby_in_shadow_takes_over_with_what_it_has_learned(zone):
    zone.plant(plant="wscc9", mode="realtime", speed=5.0)
    first = zone.controller()
    second = zone.controller(standby=True, shadow=True)
    zone.until(lambda: second._agent is not None and not second._agent.controller.missing())
    assert second._agent.mode is Mode.SHADOW
    assert zone.witness.outputs[-1].sender == first._holder.id
    states = zone.states_of(second)
    first.quiesce()
    zone.until(lambda: zone.witness.outputs[-1].sender == second._holder.id)
    zone.until(lambda: second._agent.mode is Mode.CONTROLLING)
    assert Mode.COLLECTING not in states
    controller = second._agent.controller
    assert controller.rank == controller.rank_need
    assert controller.gap > 1e8  # a false sample would raise the rank
    answer = second._on_set_mode(SetMode.Request(mode=int(Mode.SHADOW)), SetMode.Response())
    assert answer.success, answer.message
    count = len(zone.witness.outputs)
    zone.until(lambda: len(zone.witness.outputs) > count + 30)
    assert second._agent.mode is Mode.SHADOW  # what an operator asks for stays


def test_a_shadow_claims_nothing_and_may_not_take_over_a_plant_that_is_commanded(zone):
    zone.plant(plant="wscc9", mode="realtime", speed=5.0)
    first = zone.controller()
    zone.until(lambda: len(zone.witness.outputs) > 5)
    shadow = zone.controller(shadow=True)
    zone.until(lambda: shadow._agent is not None and shadow._claimants.commander() is not None)
    zone.until(lambda: shadow._agent.controller.window_length > 5)
    answer = shadow._on_set_mode(SetMode.Request(mode=int(Mode.COLLECTING)), SetMode.Response())
    assert not answer.success
    assert "commands wscc9: stop it first" in answer.message
    first.quiesce()
    zone.until(lambda: shadow._claimants.commander() is None)
    answer = shadow._on_set_mode(SetMode.Request(mode=int(Mode.COLLECTING)), SetMode.Response())
    assert answer.success, answer.message
    zone.until(lambda: zone.witness.outputs[-1].sender == shadow._holder.id)


def test_inputs_of_somebody_who_claims_nothing_are_refused_and_counted(zone):
    plant = zone.plant(plant="wscc9", mode="realtime", speed=5.0)
    zone.controller()
    zone.until(lambda: len(zone.witness.outputs) > 5)
    rogue = zone.witness.create_publisher(Sample, "inputs", profile(topics.INPUTS, lockstep=False))
    zone.until(lambda: rogue.get_subscription_count() > 0)
    k = zone.witness.outputs[-1].k + 100
    rogue.publish(sample("wscc9", zone.witness.outputs[-1].epoch, k, np.ones(3), 1))
    zone.until(lambda: plant.foreign == 1)
    assert plant.refused >= 1


def test_a_controller_that_was_killed_loses_its_claim(domain_id, tmp_path):
    script = (
        "from ros2_deepc.nodes.controller_node import ControllerNode\n"
        "from ros2_deepc.ros.run import run_node\n"
        "raise SystemExit(run_node(ControllerNode, []))\n"
    )
    env = dict(os.environ, ROS_DOMAIN_ID=str(domain_id))
    with ros([], domain_id) as context, (tmp_path / "log").open("w") as log:
        executor = make_executor("events", context)
        spinner = Spinner(executor)
        node = Node("ear", context=context, use_global_arguments=False)
        executor.add_node(node)
        claimants = Claimants(node)
        process = subprocess.Popen([sys.executable, "-c", script], env=env, stdout=log, stderr=log)

        def until(condition):
            end = time.monotonic() + DEADLINE
            spinner.until(lambda: condition() or time.monotonic() > end)
            assert condition(), (tmp_path / "log").read_text()

        until(lambda: claimants.commander() is not None)
        assert str(process.pid) in claimants.commander().who
        process.send_signal(signal.SIGKILL)
        process.wait(DEADLINE)
        until(lambda: claimants.commander() is None)
        executor.shutdown()
        node.destroy_node()
