# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""ROS topics of any message type: the gateway as a subscriber and publisher."""

import threading
import time
from importlib import import_module
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from ..ros.convert import nanoseconds
from .assemble import Quality, Scan
from .errors import GatewayError, LinkError
from .field_path import look_up, put, put_array, steps
from .tags import Array, RosAt, TagMap

COUNT = "message_count"  # a path of its own: how many messages came on the topic
_MODULUS = 2**32


class RosLink:
    """Keeps the newest message of every topic; publishes one message a topic for all its tags.

    A source time is the stamp of the message (its header's unless the tag map names another field), or its arrival.

    Args:
        tags: with places of kind RosAt.
        node: on which to subscribe and publish.

    Raises:
        GatewayError: for a message type or field that does not exist.
    """

    atomic = True

    def __init__(self, tags: TagMap, node: Node) -> None:
        self._node = node
        self._lock = threading.Lock()
        self._tags = [at for tag in tags.reads if isinstance(at := tag.at, RosAt)]
        n = len(self._tags)
        self._raw, self._source = np.full(n, np.nan), np.zeros(n, dtype=np.int64)
        self._heard = np.zeros(n, dtype=bool)
        self._subscriptions = self._subscribe()
        self._publishers = self._advertise([at for tag in tags.writes if isinstance(at := tag.at, RosAt)], tags.file)

    async def connect(self) -> None:
        """There is nothing to connect to: topics come and go."""

    async def read(self) -> Scan:
        """The newest number of every tag; BAD while nothing has come."""
        with self._lock:
            quality = np.where(self._heard, Quality.GOOD, Quality.BAD).astype(np.uint8)
            return Scan(raw=self._raw.copy(), quality=quality, source_ns=self._source.copy())

    async def write(self, raw: Array) -> None:
        """Publishes every topic of which all numbers are given."""
        for publisher, message_type, fields in self._publishers:
            places = [i for _, indices in fields for i in indices]
            if np.isnan(raw[places]).any():
                continue
            message = message_type()
            if hasattr(message, "header"):
                message.header.stamp = self._node.get_clock().now().to_msg()
            self._fill(message, fields, raw)
            try:
                publisher.publish(message)
            except RuntimeError as error:
                raise LinkError(f"cannot publish on {publisher.topic_name}: {error}") from None

    async def close(self) -> None:
        """Nothing to do: the subscriptions live as long as the node's configuration."""

    def destroy(self) -> None:
        """Takes everything off the graph."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        for publisher, _, _ in self._publishers:
            self._node.destroy_publisher(publisher)
        self._subscriptions, self._publishers = [], []

    def _subscribe(self) -> list[Any]:
        by_topic: dict[tuple[str, str], list[int]] = {}
        for i, at in enumerate(self._tags):
            by_topic.setdefault((at.topic, at.type), []).append(i)
        made = []
        for (topic, kind), indices in by_topic.items():
            message_type = message_class(kind)
            for i in indices:
                self._check(message_type(), self._tags[i])
            qos = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)  # hears reliable publishers, too
            made.append(self._node.create_subscription(message_type, topic, self._keeper(indices), qos))
        return made

    def _keeper(self, indices: list[int]) -> Any:
        paths = [(i, steps(self._tags[i].field), steps(self._tags[i].stamp)) for i in indices]
        count = 0

        def keep(message: Any) -> None:
            nonlocal count
            count = (count + 1) % _MODULUS
            arrival = time.time_ns()
            with self._lock:
                for i, field, stamp in paths:
                    self._raw[i] = count if field == [COUNT] else look_up(message, field)
                    self._source[i] = _stamp_ns(message, stamp) or arrival
                    self._heard[i] = True

        return keep

    @staticmethod
    def _check(message: Any, at: RosAt) -> None:
        """Whether the field exists, as far as a message without content can tell."""
        first = steps(at.field)[0]
        if at.field != COUNT and not hasattr(message, str(first)):
            there = ", ".join(message.get_fields_and_field_types())
            raise GatewayError(f"{at.type} has no field {at.field}; it has {there}, and {COUNT} counts the messages")

    def _advertise(self, places: list[RosAt], file: str) -> list[tuple[Any, Any, list[Any]]]:
        topics: dict[tuple[str, str], dict[str, list[tuple[int, int]]]] = {}
        for i, at in enumerate(places):
            last = steps(at.field)[-1]
            base, index = (at.field.rpartition("[")[0], last) if isinstance(last, int) else (at.field, -1)
            topics.setdefault((at.topic, at.type), {}).setdefault(base, []).append((index, i))
        made = []
        for (topic, kind), fields in topics.items():
            message_type = message_class(kind)
            plan = [
                (_whole(base, elements, file), [i for _, i in sorted(elements)]) for base, elements in fields.items()
            ]
            self._fill(message_type(), plan, np.zeros(len(places)))  # fails here rather than in control
            made.append((self._node.create_publisher(message_type, topic, QoSProfile(depth=10)), message_type, plan))
        return made

    @staticmethod
    def _fill(message: Any, fields: list[Any], raw: Array) -> None:
        for (path, is_array), indices in fields:
            if is_array:
                put_array(message, path, raw[indices].tolist())
            else:
                put(message, path, float(raw[indices[0]]))


def message_class(kind: str) -> Any:
    """The class of a message type such as ``std_msgs/msg/Float64``.

    Raises:
        GatewayError: if it is not installed.
    """
    package, _, name = kind.split("/")
    try:
        return getattr(import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError):
        raise GatewayError(f"the message type {kind} is not installed here") from None


def _whole(base: str, elements: list[tuple[int, int]], file: str) -> tuple[list[str | int], bool]:
    """Path of a field, and whether it is an array, which is written whole."""
    indices = sorted(index for index, _ in elements)
    if indices == [-1]:
        return steps(base), False
    if indices != list(range(len(indices))):
        raise GatewayError(f"{file}: an array is written whole: {base} needs all elements from 0 on")
    return steps(base), True


def _stamp_ns(message: Any, path: list[str | int]) -> int:
    """Source time in a message [ns since 1970]; 0 if it has none."""
    here = message
    for step in path or ["header", "stamp"]:
        here = getattr(here, str(step), None)
    return nanoseconds(here) if hasattr(here, "nanosec") else 0
