# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""A controller node and a plant that is driven by hand, in one process: any message may be lost, doubled or spoiled."""

import time
from contextlib import contextmanager

import numpy as np
from deepc_msgs.msg import ControllerState, PlantInfo, Sample
from deepc_msgs.srv import SetMode
from rclpy.node import Node
from rclpy.parameter import Parameter

from ros2_deepc.control.modes import Mode
from ros2_deepc.nodes.controller_node import ControllerNode
from ros2_deepc.ros import topics
from ros2_deepc.ros.convert import period_ns, sample
from ros2_deepc.ros.qos import profile
from ros2_deepc.ros.run import Spinner, make_executor, ros

DEADLINE = 60.0  # [s]
A, B, C = np.array([[0.9, 0.2], [-0.1, 0.8]]), np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]])
SETTINGS = {"N": 2, "L": 6, "Q": [1.0], "R": [0.1], "terminal": "none", "max_gap": 3, "max_hold": 8, "ramp": 4}
T = 19  # what Corollary 1 asks for: 2 (N+L+q) - 1
MODES = {name: int(value) for name, value in Mode.__members__.items()}


class FaultyPlant(Node):
    """A plant of order 2 whose messages can be lost, doubled, swapped or spoiled, one sample at a time."""

    def __init__(self, sample_time=1.0, **kwargs):
        super().__init__("plant", **kwargs)
        self.sample_time = sample_time
        self.x, self.k, self.u, self.age = np.array([1.0, -1.0]), 0, np.zeros(1), 0
        self.y_log, self.u_log = [], []
        self.inputs, self.states, self.given = {}, [], []
        self.info_topic = self.create_publisher(PlantInfo, "plant_info", profile(topics.PLANT_INFO))
        self.outputs = self.create_publisher(Sample, "outputs", profile(topics.OUTPUTS, lockstep=False))
        self.reference = self.create_publisher(Sample, "reference", profile(topics.REFERENCE))
        self.create_subscription(Sample, "inputs", self._on_inputs, profile(topics.INPUTS, lockstep=False))
        self.create_subscription(ControllerState, "controller/state", self._on_state, profile(topics.STATE))
        self.wake = lambda: None
        self.jump = 0  # [ns], of its clock
        self.refer()

    def refer(self):
        self.reference.publish(sample("p", 1, 0, np.array([0.5]), 1))

    def announce(self, epoch=1):
        self.epoch = epoch
        info = PlantInfo(name="p", epoch=epoch, sample_time=self.sample_time, q=2, s=1, n=2)
        info.input_names, info.output_names = ["u"], ["y"]
        info.input_min, info.input_max = [-1.0], [1.0]
        self.info_topic.publish(info)

    def _on_inputs(self, msg):
        self.given.append(int(msg.k))
        self.inputs[int(msg.k)] = np.array(msg.values)
        self.wake()

    def _on_state(self, msg):
        self.states.append(msg)
        self.wake()

    def sample(self):
        """One sampling instant: y(k) with the input that is there, held if none came."""
        fresh = self.inputs.get(self.k)
        self.u, self.age = (fresh, 0) if fresh is not None else (self.u, self.age + 1)
        y = C @ self.x
        self.x = A @ self.x + B @ self.u
        self.y_log.append(y)
        self.u_log.append(self.u)
        time_ns = (self.k + 1) * period_ns(self.sample_time) + self.jump
        msg = sample("p", self.epoch, self.k, y, time_ns, self.age)
        self.k += 1
        return msg


@contextmanager
def rigged(domain_id, kind="events"):
    """A controller node and the faulty plant in one process, with helpers to drive them."""
    with ros([], domain_id) as context:
        executor = make_executor(kind, context)

        class Rig:
            def start(self, sample_time=1.0, **parameters):
                values = SETTINGS | parameters
                overrides = [Parameter(name, value=value) for name, value in values.items()]
                self.node = ControllerNode(context=context, parameter_overrides=overrides, use_global_arguments=False)
                self.plant = FaultyPlant(sample_time, context=context, use_global_arguments=False)
                self.context, self.executor = context, executor
                self.spinner = Spinner(executor)
                self.plant.wake = self.spinner.wake
                executor.add_node(self.node)
                executor.add_node(self.plant)
                self.node.start()
                self.plant.announce()
                self.until(lambda: 0 in self.plant.inputs and self.plant.outputs.get_subscription_count() == 1)
                self.until(lambda: self.node._state._publisher.get_subscription_count() == 1)

            def until(self, condition):
                end = time.monotonic() + DEADLINE
                self.spinner.until(lambda: condition() or time.monotonic() > end)
                assert condition()

            def publish(self, msg):
                """Publishes outputs and waits until the controller has answered or refused them."""
                plant = self.plant
                answered, refused = len(plant.states), self.node.refused
                plant.outputs.publish(msg)
                self.until(lambda: len(plant.states) > answered or self.node.refused > refused)
                if len(plant.states) > answered and plant.states[-1].input:
                    self.until(lambda: int(msg.k) + 1 in plant.inputs)

            def run(self, samples):
                for _ in range(samples):
                    self.publish(self.plant.sample())

            def lose(self, samples):
                for _ in range(samples):
                    self.plant.sample()

            @property
            def mode(self):
                return Mode(self.plant.states[-1].mode)

            def call(self, kind, name, request):
                client = self.plant.create_client(kind, name)
                self.until(client.service_is_ready)
                future = client.call_async(request)
                self.until(future.done)
                return future.result()

            def ask(self, mode):
                return self.call(SetMode, "controller/set_mode", SetMode.Request(mode=MODES[mode]))

            def window_is_true(self):
                """One false sample would raise the rank of the data above that of the plant."""
                controller = self.node._agent.controller
                assert controller.rank == controller.rank_need
                assert controller.gap > 1e8

        made = Rig()
        yield made
        executor.shutdown()
        made.node.stop()
        made.node.destroy_node()
        made.plant.destroy_node()
