# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Publishes a bag's messages again, on their original topics, with /clock."""

import math
import time
from collections.abc import Callable
from typing import Any

import yaml
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock

from ..bags.convert import message_class
from ..bags.progress import Progress, no_progress
from ..bags.reader import BagReader
from ..bags.topic import RawMessage, TopicInfo
from ..ros import topics
from ..ros.convert import stamp
from ..ros.qos import profile

_ITS_OWN = (topics.CLOCK.name, topics.ROSOUT.name, topics.PARAMETER_EVENTS.name)  # of nodes that do not run again
_PATIENCE = 60.0  # [s] for a reader that is slower than the player
_SETTLED = 0.3  # [s] without a new reader


class Player(Node):
    """Publishes the raw bytes of a bag in the order of the bag; /clock follows the bag's own time.

    Reliable topics lose nothing: a reader that is too slow holds the player up.

    Args:
        reader: the bag.
        rate: times real time; 0 = as fast as the readers take it.
        pause: longest silence of the bag that is kept [s of the bag].
        gate: called before every message on `outputs`; for stepping.
    """

    def __init__(
        self,
        reader: BagReader,
        rate: float,
        *,
        pause: float = math.inf,
        gate: Callable[[], None] | None = None,
        **kwargs: Any,
    ) -> None:
        super().__init__("player", **kwargs)
        self._reader, self._rate, self._pause, self._gate = reader, rate, pause, gate
        self._clock_topic = self.create_publisher(Clock, topics.CLOCK.name, profile(topics.CLOCK))
        self._topics = {
            info.name: self.create_publisher(message_class(info.type), info.name, offered(info))
            for info in reader.topics.values()
            if info.name not in _ITS_OWN
        }

    def wait_for_readers(self, seconds: float) -> None:
        """Waits until somebody reads any of the topics and nobody joins any more, at most ``seconds``."""
        end = time.monotonic() + seconds
        readers, since = 0, time.monotonic()
        while (now := time.monotonic()) < end and not (readers and now - since > _SETTLED):
            count = sum(publisher.get_subscription_count() for publisher in self._topics.values())
            if count != readers:
                readers, since = count, now
            time.sleep(0.01)

    def play(self, progress: Progress = no_progress) -> int:
        """Publishes everything; returns the number of messages.

        Raises:
            RuntimeError: if a reader takes nothing for a minute.
        """
        before, due = None, time.monotonic()
        done = 0
        for message in self._reader.messages(list(self._topics)):
            if self._gate is not None and message.topic.endswith("/outputs"):
                self._gate()
            if self._rate > 0.0 and before is not None:
                due += min(max(message.log_time - before, 0) / 1e9, self._pause) / self._rate
                time.sleep(max(0.0, due - time.monotonic()))
            before = message.log_time
            self._send(message)
            done += 1
            progress(done, self._reader.message_count)
        for publisher in self._topics.values():
            publisher.wait_for_all_acked(Duration(seconds=_PATIENCE))
        progress(self._reader.message_count, self._reader.message_count)
        return done

    def _send(self, message: RawMessage) -> None:
        self._clock_topic.publish(Clock(clock=stamp(message.log_time)))
        end = time.monotonic() + _PATIENCE
        while True:
            try:
                self._topics[message.topic].publish(message.data)
                return
            except RuntimeError as error:  # RCLError: the history is full of messages that a reader has not taken yet
                if time.monotonic() > end:
                    raise RuntimeError(f"a reader of {message.topic} takes nothing: {error}") from error


def offered(info: TopicInfo) -> QoSProfile:
    """A profile that serves every reader which the recorded publishers served: the strongest of theirs."""
    recorded = (yaml.safe_load(info.qos) if info.qos else None) or []
    reliable = not recorded or any(entry["reliability"] != "best_effort" for entry in recorded)
    latched = any(entry["durability"] == "transient_local" for entry in recorded)
    everything = reliable and not latched
    return QoSProfile(
        history=HistoryPolicy.KEEP_ALL if everything else HistoryPolicy.KEEP_LAST,
        depth=0 if everything else min(max(info.count, 1), 1000),
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )
