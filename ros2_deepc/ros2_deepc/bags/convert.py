# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Between bags and live ROS messages: the only module of this package that needs rclpy."""

from importlib import import_module
from typing import Any

from rclpy.duration import Duration
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message, serialize_message

from .decode import decoder
from .errors import BagError
from .layout import qos_entry
from .schema import message_definition

_FOREVER = 2**63 - 1


def message_class(name: str) -> type[Any]:
    """The Python class of a type such as ``deepc_msgs/msg/Sample``.

    Raises:
        BagError: if its package is not installed.
    """
    package, *_, kind = name.split("/")
    try:
        found: type[Any] = getattr(import_module(f"{package}.msg"), kind)
        return found
    except (ImportError, AttributeError) as error:
        raise BagError(f"message type {name} is not installed: {error}") from error


def type_name(message_type: type[Any]) -> str:
    """Full name of a message class, e.g. ``deepc_msgs/msg/Sample``."""
    return f"{message_type.__module__.partition('.')[0]}/msg/{message_type.__name__}"


def to_cdr(message: Any) -> bytes:
    """Serializes a ROS message to the bytes that go over the wire."""
    data = bytes(serialize_message(message))  # its length is an estimate: the tail may hold bytes of no meaning
    name = type_name(type(message))
    return data[: decoder(name, message_definition(name)).size(data)]


def from_cdr(data: bytes, name: str) -> Any:
    """Deserializes wire bytes into a ROS message of the given type name."""
    return deserialize_message(data, message_class(name))


def offered_qos(profile: QoSProfile) -> dict[str, Any]:
    """A publisher's profile in rosbag2's words."""
    return qos_entry(
        history=profile.history.name.lower(),
        depth=profile.depth,
        reliability=profile.reliability.name.lower(),
        durability=profile.durability.name.lower(),
        deadline_ns=_nanoseconds(profile.deadline),
        lifespan_ns=_nanoseconds(profile.lifespan),
        liveliness=profile.liveliness.name.lower(),
        lease_ns=_nanoseconds(profile.liveliness_lease_duration),
    )


def _nanoseconds(duration: Duration) -> int | None:
    """None for infinite; an unset duration (0) means infinite, too."""
    value = duration.nanoseconds
    return None if value in (0, _FOREVER) else value
