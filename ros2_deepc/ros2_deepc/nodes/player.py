# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Publishes a bag's messages again, on their original topics, with /clock."""

import time
from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock

from ..bags.convert import message_class
from ..bags.reader import BagReader
from ..bags.topic import RawMessage
from ..ros import topics
from ..ros.convert import stamp
from ..ros.qos import profile

_KNOWN = {topic.name: topic for topic in topics.ALL}


class Player(Node):
    """Publishes the raw bytes of a bag in the order of the bag; /clock follows the bag's own time.

    Args:
        reader: the bag.
        rate: times real time; 0 = as fast as possible.
        gate: called before every message on `outputs`; for stepping.
    """

    def __init__(self, reader: BagReader, rate: float, gate: Callable[[], None] | None = None, **kwargs: Any) -> None:
        super().__init__("player", **kwargs)
        self._reader, self._rate, self._gate = reader, rate, gate
        self._clock_topic = self.create_publisher(Clock, topics.CLOCK.name, profile(topics.CLOCK))
        self._topics = {
            info.name: self.create_publisher(message_class(info.type), info.name, self._qos(info.name))
            for info in reader.topics.values()
            if info.name != topics.CLOCK.name
        }

    def wait_for_readers(self, seconds: float) -> None:
        """Waits until somebody reads any of the topics, at most ``seconds``."""
        end = time.monotonic() + seconds
        while time.monotonic() < end and not any(p.get_subscription_count() for p in self._topics.values()):
            time.sleep(0.01)

    def play(self, progress: Callable[[int, int], None]) -> int:
        """Publishes everything; returns the number of messages."""
        first, started = None, time.monotonic()
        done = 0
        for message in self._reader.messages():
            if message.topic not in self._topics:
                continue
            first = message.log_time if first is None else first
            if self._gate is not None and message.topic.endswith("/outputs"):
                self._gate()
            if self._rate > 0.0:
                due = started + (message.log_time - first) / 1e9 / self._rate
                time.sleep(max(0.0, due - time.monotonic()))
            self._send(message)
            done += 1
            progress(done, self._reader.message_count)
        return done

    def _send(self, message: RawMessage) -> None:
        self._clock_topic.publish(Clock(clock=stamp(message.log_time)))
        self._topics[message.topic].publish(message.data)

    @staticmethod
    def _qos(name: str) -> QoSProfile:
        known = (topic for key, topic in _KNOWN.items() if name == key or name.endswith(f"/{key}"))
        return profile(next(known, topics.DIAGNOSTICS))
