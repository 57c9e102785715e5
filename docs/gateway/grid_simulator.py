# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""A grid simulator that knows nothing of ros2_deepc: three machines on a ring, on plain topics, ten times a second.

It stands for the simulator that you have. Speeds [rad/s] on /grid/measurements, the flow on the first line [pu] on
/grid/power; it takes mechanical power [pu] from /grid/setpoints.
"""

from contextlib import suppress

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from scipy.linalg import expm
from std_msgs.msg import Float64, Float64MultiArray

PERIOD = 0.1  # [s]
INERTIA, DAMPING, LINE = np.array([4.0, 3.0, 2.5]), 1.5, 2.0
RING = LINE * np.array([[2.0, -1.0, -1.0], [-1.0, 2.0, -1.0], [-1.0, -1.0, 2.0]])


def discrete() -> tuple[np.ndarray, np.ndarray]:
    """Swing equations over one period, input held: x = (angles, speeds), u = power."""
    eye, zero = np.eye(3), np.zeros((3, 3))
    A = np.block([[zero, eye], [-RING / INERTIA[:, None], -DAMPING * eye / INERTIA[:, None]]])
    B = np.vstack([zero, np.diag(1 / INERTIA)])
    held = expm(PERIOD * np.block([[A, B], [np.zeros((3, 9))]]))
    return held[:6, :6], held[:6, 6:]


class Grid(Node):
    """Steps and publishes on a timer; whatever setpoint came last is in force."""

    def __init__(self) -> None:
        super().__init__("grid")
        self.A, self.B = discrete()
        self.x, self.u = np.array([0.1, 0.0, -0.1, 0.2, 0.0, -0.2]), np.zeros(3)
        self.measurements = self.create_publisher(Float64MultiArray, "/grid/measurements", 10)
        self.power = self.create_publisher(Float64, "/grid/power", 10)
        self.create_subscription(Float64MultiArray, "/grid/setpoints", self.take, 10)
        self.create_timer(PERIOD, self.step)

    def take(self, msg: Float64MultiArray) -> None:
        """Setpoints for all three machines."""
        self.u = np.array(msg.data)

    def step(self) -> None:
        """One period; the measurements come last, since they are what is counted."""
        self.x = self.A @ self.x + self.B @ self.u
        self.power.publish(Float64(data=float(LINE * (self.x[0] - self.x[1]))))
        self.measurements.publish(Float64MultiArray(data=self.x[3:].tolist()))


if __name__ == "__main__":
    rclpy.init()
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(Grid())
