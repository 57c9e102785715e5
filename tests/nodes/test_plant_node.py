# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The plant node against a hand-driven controller: lockstep, real time, refusals, index 2."""

import time
from dataclasses import replace

import numpy as np
import pytest
from deepc_msgs.msg import PlantInfo, Sample
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from rclpy.parameter import Parameter

from plant_sim import DescriptorSystem, Plant
from plant_sim.plant import StructurePrior, linear_start
from plant_sim.plant_node import PlantNode
from ros2_deepc.ros import topics
from ros2_deepc.ros.convert import nanoseconds, sample
from ros2_deepc.ros.qos import profile
from ros2_deepc.ros.run import Spinner, make_executor, ros

DEADLINE = 60.0  # [s]


class Hand(Node):
    """Publishes inputs by hand and keeps what the plant says."""

    def __init__(self, lockstep, **kwargs):
        super().__init__("hand", **kwargs)
        self.infos, self.outputs = [], []
        self.inputs = self.create_publisher(Sample, "inputs", profile(topics.INPUTS, lockstep=lockstep))
        self.create_subscription(PlantInfo, "plant_info", self.infos.append, profile(topics.PLANT_INFO))
        qos = profile(topics.OUTPUTS, lockstep=lockstep)
        self.create_subscription(Sample, "outputs", self.outputs.append, qos)

    def send(self, k, values, epoch=1, **fields):
        msg = sample("hand", epoch, k, np.asarray(values, float), 1)
        for name, value in fields.items():
            setattr(msg, name, value)
        self.inputs.publish(msg)


@pytest.fixture
def bench(domain_id):
    """A plant node and a hand in one process; ``bench(...)`` returns both and a way to wait."""
    with ros([], domain_id) as context:
        executor = make_executor("events", context)
        spinner = Spinner(executor)
        nodes = []

        def until(condition):
            end = time.monotonic() + DEADLINE
            spinner.until(lambda: condition() or time.monotonic() > end)
            assert condition()

        def make(node_class=PlantNode, lockstep=True, **parameters):
            overrides = [Parameter(name, value=value) for name, value in parameters.items()]
            node = node_class(context=context, parameter_overrides=overrides, use_global_arguments=False)
            hand = Hand(lockstep, context=context, use_global_arguments=False)
            nodes.extend((node, hand))
            for each in (node, hand):
                executor.add_node(each)
            node.start()
            until(lambda: hand.infos and hand.inputs.get_subscription_count() and node._outputs.connected)
            return node, hand, until

        yield make
        executor.shutdown()
        for node in nodes:
            if isinstance(node, PlantNode):
                node.stop()
            node.destroy_node()


def test_plant_info_says_what_the_plant_is(bench):
    _, hand, _ = bench(plant="wscc9", readers=1)
    (info,) = hand.infos
    assert (info.name, info.variant, info.lockstep, info.epoch) == ("wscc9", "transfers", True, 1)
    assert (info.n, info.q, info.r, info.s) == (12, 6, 6, 1)
    assert list(info.input_min) == [-1.0] * 3
    assert list(info.output_units) == ["rad/s", "rad"]
    assert info.d_known
    assert list(info.d) == [0.0] * 6


def test_lockstep_answers_each_input_once_and_in_order(bench):
    _, hand, until = bench(plant="wscc9", readers=1)
    reference = PlantNode.plant_of({"plant": "wscc9"}).start(0)
    expected = []
    for k in range(5):
        u = np.array([0.1 * k, -0.2, 0.3])
        expected.append(reference.push(u))
        hand.send(k, u)
        until(lambda n=k + 1: len(hand.outputs) == n)
    assert [msg.k for msg in hand.outputs] == list(range(5))
    np.testing.assert_array_equal([msg.values for msg in hand.outputs], expected)
    assert [nanoseconds(msg.header.stamp) for msg in hand.outputs] == [(k + 1) * 100_000_000 for k in range(5)]


@pytest.mark.parametrize(
    "bad",
    [
        {"k": 1, "values": [0, 0, 0]},
        {"k": 0, "values": [0, 0]},
        {"k": 0, "values": [0, np.nan, 0]},
        {"k": 0, "values": [0, np.inf, 0]},
        {"k": 0, "values": [0, 0, 0], "epoch": 2},
        {"k": 0, "values": [0, 0, 0], "quality": [0, 3, 0]},
        {"k": 0, "values": [0, 0, 0], "quality": [0]},
    ],
)
def test_bad_inputs_are_refused_counted_and_change_nothing(bench, bad):
    node, hand, until = bench(plant="wscc9", readers=1)
    hand.send(**bad)
    until(lambda: node.refused == 1)
    assert hand.outputs == []
    hand.send(0, [0, 0, 0])
    until(lambda: len(hand.outputs) == 1)
    hand.send(0, [0, 0, 0])  # a duplicate
    until(lambda: node.refused == 2)
    assert len(hand.outputs) == 1


def test_a_run_ends_after_its_last_sample(bench):
    node, hand, until = bench(plant="wscc9", readers=1, steps=3)
    for k in range(3):
        hand.send(k, [0, 0, 0])
        until(lambda n=k + 1: len(hand.outputs) == n)
    assert node.finished
    hand.send(3, [0, 0, 0])
    until(lambda: node.refused == 0 and len(hand.outputs) == 3)


@pytest.mark.parametrize(("name", "speed"), [("wscc9", 50.0), ("wscc9_swing", 5.0), ("net3_epanet", 40_000.0)])
def test_real_time_holds_the_last_input_and_says_so(bench, name, speed):
    node, hand, until = bench(plant=name, mode="realtime", speed=speed, lockstep=False)
    u = 0.5 * (node.plant.input_min + node.plant.input_max) + 0.05
    hand.send(0, u, epoch=hand.infos[0].epoch)
    until(lambda: len(hand.outputs) >= 4)
    assert [msg.held for msg in hand.outputs[:4]] == [0, 1, 2, 3]
    stamps = np.diff([nanoseconds(msg.header.stamp) for msg in hand.outputs[:4]])
    assert (stamps == round(1e9 * node.plant.sample_time)).all()
    reference = PlantNode.plant_of({"plant": name}).start(0)
    expected = [reference.push(u) for _ in range(4)]
    np.testing.assert_array_equal([msg.values for msg in hand.outputs[:4]], expected)
    assert node.held_samples >= 3


def test_real_time_goes_to_its_safe_input_when_nobody_answers(bench):
    _, hand, until = bench(plant="wscc9", mode="realtime", speed=50.0, hold=2, safe=[0.25], lockstep=False)
    hand.send(0, [0.5, 0.0, 0.0], epoch=hand.infos[0].epoch)
    until(lambda: len(hand.outputs) >= 5)
    assert [msg.held for msg in hand.outputs[:5]] == [0, 1, 2, Sample.OWN_INPUT, Sample.OWN_INPUT]
    reference = PlantNode.plant_of({"plant": "wscc9"}).start(0)
    inputs = [[0.5, 0.0, 0.0]] * 3 + [[0.25] * 3] * 2
    expected = [reference.push(np.array(u)) for u in inputs]
    np.testing.assert_array_equal([msg.values for msg in hand.outputs[:5]], expected)
    hand.send(hand.outputs[-1].k + 20, [0.5, 0.0, 0.0], epoch=hand.infos[0].epoch)
    until(lambda: any(msg.held == 0 for msg in hand.outputs[1:]))


class IndexTwoNode(PlantNode):
    """A node for a plant whose outputs depend on the next input: y(k) = u(k+1), as N = [[0, 1], [0, 0]] gives."""

    @staticmethod
    def plant_of(parameters):
        E = np.array([[1.0, 0, 0], [0, 0, 1], [0, 0, 0]])
        system = DescriptorSystem(E, np.diag([0.5, 1, 1]), [[1.0], [0], [-1]], [[1.0, 0, 0], [0, 1, 0]])
        return Plant(
            name="two", variant="", description="index 2", sample_time=1.0, system=system, input_names=("u",),
            input_units=("",), output_names=("slow", "fast"), output_units=("", ""), input_min=[-1], input_max=[1],
            prior=StructurePrior(3, 1, 2, 2), D=None, references=(), settings={}, steps=10,
            begin=linear_start(system, lambda rng: np.zeros(3)),
        )  # fmt: skip


def test_with_index_two_outputs_wait_for_the_next_input(bench):
    _, hand, until = bench(IndexTwoNode, readers=1)
    u = [0.25, -0.5, 0.75, 1.0]
    hand.send(0, [u[0]])
    hand.send(1, [u[1]])
    until(lambda: len(hand.outputs) == 1)
    assert hand.outputs[0].k == 0
    for k in (2, 3):
        hand.send(k, [u[k]])
        until(lambda n=k: len(hand.outputs) == n)
    assert [msg.k for msg in hand.outputs] == [0, 1, 2]
    np.testing.assert_allclose([abs(msg.values[1]) for msg in hand.outputs], np.abs(u[1:]), atol=1e-14)


class Moody:
    """A running plant that says how it is."""

    def __init__(self):
        self.k, self.status = 0, ""

    def push(self, u):
        self.k += 1
        self.status = "tank 3 is empty" if self.k == 2 else ""
        return u[:2]


class MoodyNode(PlantNode):
    """A node for it."""

    @classmethod
    def plant_of(cls, parameters):
        plant = PlantNode.plant_of({"plant": "wscc9"})
        return replace(plant, begin=lambda rng: Moody())


def test_what_a_plant_says_of_itself_reaches_diagnostics(bench):
    _, hand, until = bench(MoodyNode, readers=1)
    told = []
    hand.create_subscription(DiagnosticArray, "/diagnostics", lambda msg: told.extend(msg.status), 10)
    until(lambda: hand.count_publishers("/diagnostics") == 1)
    for k in range(3):
        hand.send(k, [0.0, 0.0, 0.0])
        until(lambda n=k + 1: len(hand.outputs) == n)
    until(lambda: [status.message for status in told][-2:] == ["tank 3 is empty", "running"])
    assert told[-2].level == DiagnosticStatus.WARN
