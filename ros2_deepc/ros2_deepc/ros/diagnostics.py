# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Diagnostics messages, small."""

import time
from collections.abc import Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from . import topics
from .qos import profile

OK, WARN, ERROR, STALE = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR, DiagnosticStatus.STALE


_EVERY = 1.0  # [s]


class Diagnostics:
    """Publishes the state of one node on /diagnostics: at every change of level or message, else once a second."""

    def __init__(self, node: Node, hardware_id: str) -> None:
        self._node = node
        self._id = hardware_id
        self._last: tuple[bytes, str] | None = None
        self._told = 0.0
        self._publisher = node.create_publisher(
            topics.DIAGNOSTICS.type, topics.DIAGNOSTICS.name, profile(topics.DIAGNOSTICS)
        )

    def report(self, level: bytes, message: str, values: Mapping[str, Any] | None = None) -> None:
        """Reports a level (OK, WARN, ERROR, STALE), one line, and values to go with it."""
        if not self.due(level, message):
            return
        self._last, self._told = (level, message), time.monotonic()
        status = DiagnosticStatus(level=level, message=message, hardware_id=self._id)
        status.name = self._node.get_fully_qualified_name().lstrip("/")
        status.values = [KeyValue(key=key, value=str(value)) for key, value in (values or {}).items()]
        array = DiagnosticArray(status=[status])
        array.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(array)

    def due(self, level: bytes, message: str) -> bool:
        """Whether such a report would be published now; worth asking before dear values are computed."""
        return (level, message) != self._last or time.monotonic() - self._told >= _EVERY

    def destroy(self) -> None:
        """Takes the publisher off the graph."""
        self._node.destroy_publisher(self._publisher)
