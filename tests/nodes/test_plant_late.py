# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The plant in real time when messages or the process itself come too late: everything is counted."""

import time
from dataclasses import replace

import numpy as np
import pytest
from deepc_msgs.msg import PlantInfo, Sample
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.parameter import Parameter

from plant_sim.plant_node import PlantNode
from ros2_deepc.ros import topics
from ros2_deepc.ros.convert import nanoseconds, period_ns, sample
from ros2_deepc.ros.qos import profile
from ros2_deepc.ros.run import Spinner, make_executor, ros

DEADLINE = 60.0  # [s]
PERIOD = 0.05  # [s] of the wall clock
SAFE = 0.25


class Hand(Node):
    """Publishes inputs by hand and keeps the outputs."""

    def __init__(self, **kwargs):
        super().__init__("hand", **kwargs)
        self.infos, self.outputs, self.told = [], [], []
        self._inputs = self.create_publisher(Sample, "inputs", profile(topics.INPUTS, lockstep=False))
        self.create_subscription(DiagnosticArray, "/diagnostics", lambda msg: self.told.extend(msg.status), 10)
        self.create_subscription(PlantInfo, "plant_info", self.infos.append, profile(topics.PLANT_INFO))
        self.create_subscription(Sample, "outputs", self.outputs.append, profile(topics.OUTPUTS, lockstep=False))

    @property
    def connected(self):
        return self.infos and self._inputs.get_subscription_count()

    def send(self, k, values):
        self._inputs.publish(sample("hand", self.infos[0].epoch, k, np.asarray(values, float), 1))


class Stalling(PlantNode):
    """A plant whose process is held up for a little more than three periods at its third sample."""

    STALL = 3.2  # periods

    @classmethod
    def plant_of(cls, parameters):
        plant = PlantNode.plant_of(parameters)

        class Stepper:
            k = 0

            def push(self, u):
                Stepper.k += 1
                end = time.monotonic() + (cls.STALL * PERIOD if Stepper.k == 3 else 0.0)
                while time.monotonic() < end:
                    pass
                return u[:2]

        return replace(plant, begin=lambda rng: Stepper())


@pytest.fixture
def rig(domain_id):
    """A plant in real time and a hand in one process; returns both and a way to wait."""
    with ros([], domain_id) as context:
        executor = make_executor("events", context)
        spinner, nodes = Spinner(executor), []

        def until(condition):
            end = time.monotonic() + DEADLINE
            spinner.until(lambda: condition() or time.monotonic() > end)
            assert condition()

        def make(kind):
            values = {"plant": "wscc9", "mode": "realtime", "speed": 0.1 / PERIOD, "hold": 2, "safe": [SAFE]}
            overrides = [Parameter(name, value=value) for name, value in values.items()]
            plant = kind(context=context, parameter_overrides=overrides, use_global_arguments=False)
            hand = Hand(context=context, use_global_arguments=False)
            nodes.extend((plant, hand))
            for node in nodes:
                executor.add_node(node)
            plant.start()
            until(lambda: hand.connected)
            return plant, hand, until

        yield make
        executor.shutdown()
        nodes[0].stop()
        for node in nodes:
            node.destroy_node()


def test_ticks_that_a_stalled_process_misses_are_counted(rig):
    plant, hand, until = rig(Stalling)
    hand.send(0, [0.0, 0.0, 0.0])
    until(lambda: len(hand.outputs) >= 6)
    assert plant.skipped >= 2
    assert [msg.k for msg in hand.outputs[:6]] == list(range(6))


class LongStall(Stalling):
    """A plant whose process is held up for longer than a second."""

    STALL = 1.5 / PERIOD


def test_a_plant_that_was_held_up_goes_on_where_it_stood_says_so_and_is_on_the_clock_when_activated_again(rig):
    plant, hand, until = rig(LongStall)
    hand.send(0, [0.0, 0.0, 0.0])
    until(lambda: len(hand.outputs) >= 6)
    assert plant.behind == pytest.approx(plant.skipped * PERIOD)
    assert plant.behind > 1.0
    stamps = np.array([nanoseconds(msg.header.stamp) for msg in hand.outputs[:6]])
    np.testing.assert_array_equal(np.diff(stamps), period_ns(plant.plant.sample_time))  # nothing was left out of it
    until(lambda: any("behind real time" in status.message for status in hand.told))

    plant.trigger_deactivate()
    plant.trigger_activate()
    until(lambda: len(hand.infos) == 2)
    assert plant.behind == 0.0
    assert nanoseconds(hand.infos[1].header.stamp) > stamps[-1]


def test_a_first_message_that_is_not_inputs_0_starts_with_the_plants_own(rig):
    _, hand, until = rig(PlantNode)
    hand.send(1, [0.5, 0.0, 0.0])
    until(lambda: len(hand.outputs) >= 2)
    assert [msg.held for msg in hand.outputs[:2]] == [Sample.OWN_INPUT, 0]


def test_inputs_that_come_twice_before_their_tick_are_counted_and_the_newest_acts(rig):
    plant, hand, until = rig(PlantNode)
    hand.send(0, [0.0, 0.0, 0.0])
    for value in (0.9, 0.5):
        hand.send(900, [value, 0.0, 0.0])
    hand.send(2000, [0.0, 0.0, 0.0])
    until(lambda: plant.refused == 2 and 900 in plant._pending)
    assert plant._pending[900][0] == 0.5
