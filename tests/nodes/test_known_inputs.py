# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Measured disturbances with forecasts, and the monitor's modes: used, recorded, replayed to the bit."""

import time

import numpy as np
import pytest
from deepc_msgs.msg import ControllerState, MonitorReport, PlantInfo, Sample, Verdict
from rclpy.node import Node
from rclpy.parameter import Parameter

from ros2_deepc.bags.replay import replay
from ros2_deepc.control.modes import Mode
from ros2_deepc.nodes.controller_node import ControllerNode
from ros2_deepc.nodes.recorder_node import RecorderNode
from ros2_deepc.nodes.replaying import cores
from ros2_deepc.ros import topics
from ros2_deepc.ros.convert import sample
from ros2_deepc.ros.qos import profile
from ros2_deepc.ros.run import Spinner, make_executor, ros

DEADLINE = 60.0  # [s]
L, STEPS = 6, 90
A, B, F = np.array([[0.9, 0.2], [-0.1, 0.8]]), np.array([0.0, 1.0]), np.array([0.4, 0.1])
D = 0.5 * np.random.Generator(np.random.PCG64(5)).uniform(-1, 1, STEPS + L + 1)  # the disturbance, known beforehand
SETTINGS = {"N": 2, "L": L, "T": 60, "Q": [100.0], "R": [0.001], "terminal": "none", "heed_monitor": True}


class DisturbedPlant(Node):
    """Waits for inputs k, then publishes outputs k and, before or after them, the disturbances with their forecast."""

    def __init__(self, order, wake, **kwargs):
        super().__init__("plant", **kwargs)
        self.order, self.wake, self.frozen = order, wake, None
        self.x, self.k, self.y, self.states = np.array([1.0, -1.0]), 0, [], []
        names = (topics.PLANT_INFO, topics.OUTPUTS, topics.DISTURBANCES, topics.REFERENCE, topics.REPORT)
        self.to = {topic.name: self.create_publisher(topic.type, topic.name, profile(topic)) for topic in names}
        self.create_subscription(Sample, "inputs", self._on_inputs, profile(topics.INPUTS))
        self.create_subscription(ControllerState, "controller/state", self._on_state, profile(topics.STATE))
        info = PlantInfo(name="p", epoch=1, sample_time=1.0, q=3, s=1, n=3, lockstep=True)
        info.input_names, info.output_names, info.disturbance_names = ["u"], ["y", "d0"], ["d"]
        info.input_min, info.input_max = [-5.0], [5.0]
        self.to["reference"].publish(sample("p", 1, 0, np.array([0.5, 3.0]), 1))
        self.to["plant_info"].publish(info)

    def _on_inputs(self, msg):
        self.u = msg.values[0]
        assert msg.k == self.k
        self.step()

    def step(self):
        k = self.k
        if k >= STEPS:
            return
        y = sample("p", 1, k, np.array([self.x[0], 1.0]), k + 1)
        d = sample("p", 1, k, D[k : k + L + 1], k + 1)
        self.y.append(self.x[0])
        self.x = A @ self.x + B * self.u + F * D[k]
        self.k += 1
        both = [("outputs", y), ("disturbances", d)]
        for name, msg in both if self.order == "outputs first" else both[::-1]:
            self.to[name].publish(msg)

    def _on_state(self, msg):
        self.states.append(msg)
        if msg.k == 70:  # the second output is a constant that no input moves
            report = MonitorReport(epoch=1, k=70, modes_re=[1.0], modes_im=[0.0], modes_strength=[1e-12])
            report.r_controllability = Verdict(verdict=Verdict.NOT_PROVED, noise_bound=1e-9)
            self.to["monitor/report"].publish(report)
        self.wake()


@pytest.mark.parametrize("order", ["outputs first", "disturbances first"])
def test_disturbances_and_modes_are_used_and_replay_to_the_bit(domain_id, tmp_path, order):
    with ros([], domain_id) as context:
        executor = make_executor("events", context)
        spinner = Spinner(executor)
        given = {name: Parameter(name, value=value) for name, value in SETTINGS.items()}
        readers = [Parameter(name, value=2) for name in ("readers_inputs", "readers_state")]
        node = ControllerNode(
            context=context, parameter_overrides=[*given.values(), *readers], use_global_arguments=False
        )
        folder = [Parameter("folder", value=str(tmp_path / "bag"))]
        recorder = RecorderNode(context=context, parameter_overrides=folder, use_global_arguments=False)
        plant = DisturbedPlant(order, spinner.wake, context=context, use_global_arguments=False)
        for each in (recorder, node, plant):
            executor.add_node(each)
        recorder.start()
        node.start()
        end = time.monotonic() + DEADLINE
        spinner.until(lambda: len(plant.states) == STEPS or bool(node.fault) or time.monotonic() > end)
        assert node.fault == ""
        assert len(plant.states) == STEPS
        node.quiesce()
        spinner.until(recorder.drained)
        executor.shutdown()
        recorder.stop()
        node.stop()
        for each in (recorder, node, plant):
            each.destroy_node()
    assert Mode(plant.states[-1].mode) is Mode.CONTROLLING
    assert node._agent.lost == node.refused == 0
    assert not any(state.overdue or state.deadline_misses for state in plant.states)  # lockstep knows no lateness
    assert np.abs(np.array(plant.y[-10:]) - 0.5).max() < 0.02  # though the disturbance moves it by 0.2 a sample
    assert list(plant.states[70].mask) == [1.0, 1.0]
    assert list(plant.states[-1].mask) == [1.0, 0.0]
    again = replay(tmp_path / "bag", {"controller": cores({"controller": SETTINGS})["controller"]})
    assert again.same, (again.differences, again.unmatched)
    assert again.compared["controller/state"] == STEPS
