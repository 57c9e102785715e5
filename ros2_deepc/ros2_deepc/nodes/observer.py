# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""A node that only looks: the newest of everything, for people and for the end of a run."""

from collections.abc import Callable
from typing import Any

from deepc_msgs.msg import ControllerState, MonitorReport, PlantInfo
from rclpy.node import Node

from ..ros import topics
from ..ros.qos import profile
from ..ros.wire import Reading, reading


class Observer(Node):
    """Keeps the newest plant_info, outputs, state and report.

    Attributes:
        on_change: called after each message.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("observer", **kwargs)
        self.info: PlantInfo | None = None
        self.outputs: Reading | None = None
        self.state: ControllerState | None = None
        self.report: MonitorReport | None = None
        self.messages = 0
        self.on_change: Callable[[], None] = lambda: None
        for topic, field in (
            (topics.PLANT_INFO, "info"),
            (topics.STATE, "state"),
            (topics.REPORT, "report"),
        ):
            self.create_subscription(topic.type, topic.name, self._keeps(field), profile(topic))
        topic, keep = topics.OUTPUTS, reading(self._keeps("outputs"))
        self.create_subscription(topic.type, topic.name, keep, profile(topic), raw=True)

    def _keeps(self, field: str) -> Callable[[Any], None]:
        def keep(msg: Any) -> None:
            setattr(self, field, msg)
            self.messages += 1
            self.on_change()

        return keep
