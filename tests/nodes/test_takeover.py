# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Lockstep: another controller goes on where the first one stopped, in a new epoch of the same plant."""

import time

import numpy as np
import pytest
from deepc_msgs.msg import MonitorReport, PlantInfo, Sample, Verdict
from rclpy.node import Node
from rclpy.parameter import Parameter

from plant_sim.plant_node import PlantNode
from ros2_deepc.control.modes import Mode
from ros2_deepc.nodes.controller_node import ControllerNode
from ros2_deepc.nodes.monitor_node import MonitorNode
from ros2_deepc.ros import topics
from ros2_deepc.ros.convert import nanoseconds, sample
from ros2_deepc.ros.qos import profile
from ros2_deepc.ros.run import Spinner, make_executor, ros

DEADLINE = 60.0  # [s]
SETTINGS = {"N": 3, "L": 8, "Q": [1.0], "R": [1.0], "terminal": "none"}
INDEX_2 = """
name: late
sample_time: 0.1
E: [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1], [0, 0, 0, 0]]
A: [[0.9, 0.2, 0, 0], [-0.1, 0.8, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
B: [[0.0, 0.3], [1.0, 0.0], [0.5, 0.0], [0.4, 1.0]]
C: [[1, 0, 1, 0], [0, 1, 0, 1]]
input_min: -1.0
input_max: 1.0
"""


class Witness(Node):
    """Gives the reference and keeps what goes over the topics."""

    def __init__(self, wake, p, **kwargs):
        super().__init__("witness", **kwargs)
        self.wake = wake
        self.infos, self.inputs, self.outputs, self.reports = [], [], [], []
        self.reference = self.create_publisher(Sample, "reference", profile(topics.REFERENCE))
        self.reference.publish(sample("p", 1, 0, np.linspace(0.5, 0.0, p), 1))
        for topic, kept in (
            (topics.PLANT_INFO, self.infos),
            (topics.INPUTS, self.inputs),
            (topics.OUTPUTS, self.outputs),
            (topics.REPORT, self.reports),
        ):
            self.create_subscription(topic.type, topic.name, self._keeps(kept), profile(topic))

    def _keeps(self, kept):
        return lambda msg: (kept.append(msg), self.wake())


@pytest.fixture
def zone(domain_id):
    """A plant in lockstep and as many other nodes as are asked for, in one process."""
    with ros([], domain_id) as context:
        executor = make_executor("events", context)
        spinner, nodes = Spinner(executor), []

        class Zone:
            def add(self, kind, **parameters):
                overrides = [Parameter(name, value=value) for name, value in parameters.items()]
                node = kind(context=context, parameter_overrides=overrides, use_global_arguments=False)
                nodes.append(node)
                executor.add_node(node)
                node.start()
                return node

            def plant(self, **parameters):
                plant = PlantNode.plant_of(parameters)
                self.seen = Witness(spinner.wake, len(plant.output_names), context=context, use_global_arguments=False)
                nodes.append(self.seen)
                executor.add_node(self.seen)
                return self.add(PlantNode, **parameters)

            def until(self, condition):
                end = time.monotonic() + DEADLINE
                spinner.until(lambda: condition() or time.monotonic() > end)
                assert condition()

        yield Zone()
        executor.shutdown()
        for node in nodes:
            if hasattr(node, "stop"):
                node.stop()
            node.destroy_node()


def acted(seen, epoch, sender):
    """Inputs of an epoch in the order in which the plant took them."""
    given = {int(msg.k): np.array(msg.values) for msg in seen.inputs if msg.epoch == epoch and msg.sender == sender}
    return [given[k] for k in range(len(given))]


@pytest.fixture
def late(tmp_path):
    """A plant of index 2."""
    file = tmp_path / "late.yaml"
    file.write_text(INDEX_2)
    return str(file)


@pytest.mark.parametrize("index", [1, 2])
def test_a_new_controller_gets_a_new_epoch_of_the_plant_as_it_is(zone, index, late):
    plant = zone.plant(plant="wscc9" if index == 1 else late)
    assert plant.plant.prior.s == index
    zone.add(MonitorNode)
    seen, s = zone.seen, int(plant.plant.prior.s)
    first = zone.add(ControllerNode, **SETTINGS)
    zone.until(lambda: first._agent is not None and first._agent.mode is Mode.CONTROLLING)
    first.quiesce()
    second = zone.add(ControllerNode, **SETTINGS)
    zone.until(lambda: second._agent is not None and second._agent.mode is Mode.CONTROLLING)
    zone.until(lambda: seen.reports and seen.reports[-1].epoch == 2 and proved(seen.reports[-1]))
    second.quiesce()

    one, two = (acted(seen, epoch, node._holder.id) for epoch, node in ((1, first), (2, second)))
    start, instant = nanoseconds(seen.infos[1].header.stamp), round(plant.plant.sample_time * 1e9)
    assert 30 * instant < start <= (len(one) + 1) * instant  # time goes on, too; k = 0 was at one instant
    one = one[: start // instant - 1]
    stepper = plant.plant.start(plant.p["seed"])
    truth = [stepper.push(u) for u in (*one, *two)]
    outputs = {(int(msg.epoch), int(msg.k)): np.array(msg.values) for msg in seen.outputs}
    for epoch, inputs, before in ((1, one, 0), (2, two, len(one))):
        for k in range(len(inputs) - s + 1):  # the first outputs of an epoch see inputs of that epoch only
            if (epoch, k) in outputs:
                np.testing.assert_array_equal(outputs[epoch, k], truth[before + k + s - 1])
    ks = [k for epoch, k in outputs if epoch == 2]
    assert ks == list(range(len(ks)))
    assert len(ks) > 30
    assert {int(msg.sender) for msg in seen.outputs if msg.epoch == 2} == {second._holder.id}
    controller = second._agent.controller
    assert controller.rank == controller.rank_need
    assert controller.gap > 1e8


def proved(report: MonitorReport):
    return report.r_observability.verdict == Verdict.PROVED


@pytest.mark.parametrize("shadow", [False, True])
def test_a_controller_on_standby_goes_on_when_the_first_one_stops(zone, shadow):
    plant = zone.plant(plant="wscc9")
    first = zone.add(ControllerNode, **SETTINGS)
    zone.until(lambda: first._agent is not None and first._agent.mode is Mode.CONTROLLING)
    second = zone.add(ControllerNode, standby=True, shadow=shadow, **SETTINGS)
    zone.until(lambda: second._waits or (second._agent is not None and second._agent.mode is Mode.SHADOW))
    assert plant._epoch == 1
    first.quiesce()
    zone.until(lambda: second._agent.mode is Mode.CONTROLLING and plant._epoch == 2)
    assert zone.seen.outputs[-1].sender == second._holder.id


def test_the_same_controller_may_be_stopped_and_started_again(zone):
    plant = zone.plant(plant="wscc9")
    node = zone.add(ControllerNode, **SETTINGS)
    for epoch in (1, 2, 3):
        zone.until(lambda epoch=epoch: plant._epoch == epoch and node._agent is not None)
        zone.until(lambda: node._agent.mode is Mode.CONTROLLING)
        node.quiesce()
        node.trigger_activate()


def test_inputs_of_a_new_controller_never_join_an_epoch_that_another_one_began(zone, late):
    """With s = 2 the inputs 0 and 1 decide outputs 0: from two controllers they would be a false sample for both."""
    plant = zone.plant(plant=late)
    seen = zone.seen
    info: PlantInfo = plant_info(zone)
    hands = [seen.create_publisher(Sample, "inputs", profile(topics.INPUTS)) for _ in range(2)]
    zone.until(lambda: all(hand.get_subscription_count() for hand in hands))
    m = len(info.input_names)
    hands[0].publish(sample("p", info.epoch, 0, np.zeros(m), 1, sender=5))
    zone.until(lambda: plant._k == 1)
    hands[1].publish(sample("p", info.epoch, 1, np.ones(m), 1, sender=7))
    zone.until(lambda: plant.foreign == 1)
    assert plant._k == 1
    assert not seen.outputs


def plant_info(zone):
    zone.until(lambda: bool(zone.seen.infos))
    return zone.seen.infos[-1]
