# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""A publisher that waits for its readers."""

import math
import time
from collections import deque
from typing import Any

from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node

from .qos import profile
from .topics import Topic

_HEARD = 0.5  # [s] at most, in which readers of other processes find out what they have missed; at once in this one
_RETRIES = 600  # each try blocks for up to 0.1 s while the slowest reader catches up


class PatientPublisher:
    """Publishes on one topic; holds messages back until the expected number of readers is there.

    A reader that joins late would miss the first samples of a run, and with them the right answer to every rank
    question. In lockstep the first message is therefore held until all expected readers are connected, which stops the
    loop by itself.
    """

    def __init__(self, node: Node, topic: Topic, *, lockstep: bool, sample_time: float = 0.0, readers: int = 0) -> None:
        self._node = node
        self._expected = readers
        self._held: deque[Any] = deque()
        self.deadlines_missed = 0
        """Periods of the promised deadline that passed without a message; only where there is a promise."""
        qos = profile(topic, lockstep=lockstep, sample_time=sample_time)
        self._deadline, self._sent = qos.deadline.nanoseconds / 1e9, math.nan
        # EventsExecutor crashes on an event of a publisher that was destroyed meanwhile. So only the one event without
        # which a run would not start, and no deadline events: those who read may ask DDS for them, here we count.
        events = PublisherEventCallbacks(matched=self._on_matched) if readers else None
        self._publisher = node.create_publisher(topic.type, topic.name, qos, event_callbacks=events)

    @property
    def connected(self) -> bool:
        """Whether all expected readers are there."""
        return bool(self._publisher.get_subscription_count() >= self._expected)

    def publish(self, msg: Any) -> None:
        """Publishes, or holds the message until the readers are there (in order)."""
        if self._expected == 0:
            self._send(msg)
            return
        self._held.append(msg)
        self._flush()

    def delivered(self, seconds: float = 1.0) -> bool:
        """Waits until every reader has what was published, at most so long; for a last message before the end."""
        return bool(self._publisher.wait_for_all_acked(Duration(seconds=seconds)))

    def destroy(self) -> None:
        """Takes the publisher off the graph."""
        self._node.destroy_publisher(self._publisher)

    def _flush(self) -> None:
        if not self.connected:
            return
        self._expected = 0  # whoever leaves later must not stop the loop
        while self._held:
            self._send(self._held.popleft())
        # A reader known here may not know this side yet: it asks for the beginning, and hears it after the rest.
        self.delivered(_HEARD)

    def _on_matched(self, _info: object) -> None:
        if self._held:
            self._flush()

    def _send(self, msg: Any) -> None:
        now = time.monotonic()
        if self._deadline > 0.0 and now - self._sent > self._deadline:
            self.deadlines_missed += int((now - self._sent) / self._deadline)
        self._sent = now
        for _ in range(_RETRIES):
            try:
                self._publisher.publish(msg)
                return
            except (
                RuntimeError
            ) as error:  # RCLError: the history is full of messages that a slow reader has not taken yet
                reason = str(error)
        self._node.get_logger().error(f"cannot publish on {self._publisher.topic_name}: {reason}; message dropped")
