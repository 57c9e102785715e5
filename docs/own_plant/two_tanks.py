# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""A plant of your own over topics, with nothing but rclpy and the messages: two tanks in series, one pump.

python docs/own_plant/two_tanks.py                                  in one shell,
ros2-deepc run docs/own_plant/tanks.yaml --record today             in another.

Put your simulator, or the driver of your hardware, in place of `step`.
"""

from contextlib import suppress

import numpy as np
import rclpy
from deepc_msgs.msg import PlantInfo, Sample
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
A, B = np.array([[0.9, 0.0], [0.1, 0.8]]), np.array([[0.2], [0.0]])  # per sample


class TwoTanks(Node):
    """Publishes `plant_info` once and `outputs` every sample, takes `inputs`."""

    def __init__(self):
        super().__init__("plant")
        self.period = self.declare_parameter("sample_time", 0.1).value
        self.levels, self.pump = np.array([2.0, 1.0]), np.zeros(1)  # before the first command: pump off
        self.epoch = self.get_clock().now().nanoseconds // 10**9 % 2**32  # a restart is a new record
        self.k, self.commanded, self.commands = 0, -1, {}
        self.about = self.create_publisher(PlantInfo, "plant_info", LATCHED)
        self.outputs = self.create_publisher(Sample, "outputs", 10)
        self.create_subscription(Sample, "inputs", self.take, 10)
        self.about.publish(self.info())
        self.create_timer(self.period, self.tick)

    def info(self):
        """What the controller and the monitor need to know, and all they get to know."""
        info = PlantInfo(name="two_tanks", epoch=self.epoch, sample_time=self.period)
        info.q, info.s = 2, 1  # upper bounds: order of the dynamics, nilpotency index
        info.input_names, info.input_units, info.input_min, info.input_max = ["pump"], ["l/s"], [-1.0], [1.0]
        info.output_names, info.output_units = ["level"], ["m"]
        return info

    def take(self, msg):
        """The inputs for sample msg.k."""
        if msg.epoch == self.epoch and msg.k >= self.k and np.all(np.isfinite(msg.values)):
            self.commands[msg.k] = np.clip(msg.values, -1, 1)

    def tick(self):
        """One sample: say what is measured, then move. Without inputs for this k the last ones are held."""
        if self.k in self.commands:
            self.pump, self.commanded = self.commands.pop(self.k), self.k
        y = Sample(epoch=self.epoch, k=self.k, values=self.levels[1:])
        y.header.stamp = self.get_clock().now().to_msg()
        y.held = self.k - self.commanded if self.commanded >= 0 else Sample.OWN_INPUT
        self.outputs.publish(y)
        self.step()
        self.k += 1

    def step(self):
        """The plant itself."""
        self.levels = A @ self.levels + B @ self.pump


def main():
    rclpy.init()
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(TwoTanks())


if __name__ == "__main__":
    main()
