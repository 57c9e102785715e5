# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Settings of a link and places of tags, protocol by protocol, read from their sections of the YAML."""

import ipaddress
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any
from urllib.parse import urlsplit

from . import modbus_codec as codec
from .located import Section
from .tags import At, ModbusAt, OpcuaAt, RosAt, Serve

KINDS = ("modbus", "opcua", "ros")
OPCUA_TYPES = ("Double", "Float", "Int16", "Int32", "Int64", "UInt16", "UInt32", "UInt64")
_NODE_ID = re.compile(r"^(ns=\d+;|nsu=[^;]+;)?[isgb]=.+$")
_FIELD = re.compile(r"^[a-zA-Z_]\w*(\[\d+\])?(\.[a-zA-Z_]\w*(\[\d+\])?)*$")
_TOPIC_TYPE = re.compile(r"^[a-z]\w*/msg/[A-Z]\w*$")


@dataclass(frozen=True, slots=True, kw_only=True)
class ModbusLink:
    """How to reach a Modbus/TCP device.

    Attributes:
        host: name or address.
        port: TCP port.
        timeout: [s] for one request.
    """

    host: str
    port: int
    timeout: float


@dataclass(frozen=True, slots=True, kw_only=True)
class OpcuaLink:
    """How to reach an OPC UA server.

    Attributes:
        url: ``opc.tcp://host:port/path``.
        timeout: [s] for one request.
        insecure: no encryption, which is allowed on this machine's loopback only.
        pki: folder with own/, trusted/ and rejected/ certificates.
        user: name, or empty for none.
        password_env: environment variable with the password.
    """

    url: str
    timeout: float
    insecure: bool
    pki: str
    user: str
    password_env: str


@dataclass(frozen=True, slots=True, kw_only=True)
class RosLink:
    """ROS topics need no settings."""


def is_loopback(host: str) -> bool:
    """Whether a host is this machine itself."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def link_of(section: Section) -> tuple[str, ModbusLink | OpcuaLink | RosLink]:
    """Kind and settings of the section ``link``."""
    kind = section.need("kind", f"one of {', '.join(KINDS)}").text(KINDS)
    link: ModbusLink | OpcuaLink | RosLink
    if kind == "modbus":
        link = ModbusLink(
            host=section.text("host", "127.0.0.1"),
            port=section.whole("port", 502, 1, 65535),
            timeout=section.number("timeout", 0.5, above=0.0),
        )
    elif kind == "opcua":
        link = _opcua(section)
    else:
        link = RosLink()
    section.done()
    return kind, link


def serve_of(section: Section) -> Serve:
    """Settings of the section ``serve``."""
    kind = section.text("kind", "opcua", ("opcua", "modbus"))
    if kind == "modbus":
        port = section.need("port", "TCP port to listen on").whole(1, 65535)
        serve = Serve(kind=kind, host=section.text("host", "127.0.0.1"), port=port)
        section.done()
        return serve
    common = _opcua_common(section)
    if not common["insecure"] and not common["user"]:
        section.value.fail("give user and password_env, or allow_insecure_loopback: true")
    section.done()
    return Serve(kind=kind, **common)


def _opcua(section: Section) -> OpcuaLink:
    common = _opcua_common(section)
    return OpcuaLink(timeout=section.number("timeout", 1.0, above=0.0), **common)


def _opcua_common(section: Section) -> dict[str, Any]:
    """What clients and servers have in common."""
    url = section.need("url", "e.g. opc.tcp://127.0.0.1:4840").text()
    try:
        parts = urlsplit(url)
        host, _ = parts.hostname, parts.port
    except ValueError:
        host, parts = None, urlsplit("")
    if parts.scheme != "opc.tcp" or not host:
        section.place("url").fail(f"{url!r} should be like opc.tcp://127.0.0.1:4840")
    insecure = section.flag("allow_insecure_loopback", False)
    if insecure and not is_loopback(host):
        section.place("allow_insecure_loopback").fail(f"{host} is not this machine: only encrypted links leave it")
    user = section.text("user", "")
    password_env = section.text("password_env", "")
    if bool(user) != bool(password_env):
        section.value.fail("user and password_env (the name of an environment variable) belong together")
    pki = section.text("pki", "pki")
    return {"url": url, "insecure": insecure, "pki": pki, "user": user, "password_env": password_env}


def _modbus_at(section: Section, base: ModbusAt | None) -> ModbusAt:
    kind = section.text("type", base.type if base else "float32", tuple(codec.TYPES))
    address = section.need("address", "first register, from 0").whole(0, 0xFFFF)
    if address + codec.size(kind) > 0x10000:
        section.place("address").fail(f"a {kind} at {address} ends behind register 65535")
    return ModbusAt(
        table=section.text("table", base.table if base else "holding", ("holding", "input")),
        address=address,
        type=kind,
        words=section.text("words", base.words if base else "ABCD", codec.WORD_ORDERS),
        unit_id=section.whole("unit_id", base.unit_id if base else 1, 0, 247),
    )


def _opcua_at(section: Section, base: OpcuaAt | None) -> OpcuaAt:
    node = section.need("node", "e.g. ns=2;s=y1").text()
    if not _NODE_ID.match(node):
        section.place("node").fail(f"{node!r} is not a node id; it should be like ns=2;s=y1 or nsu=urn:plant;s=y1")
    return OpcuaAt(
        node=node,
        index=section.whole("index", -1, 0, 1_000_000),
        type=section.text("type", base.type if base else "Double", OPCUA_TYPES),
    )


def _ros_at(section: Section, base: RosAt | None) -> RosAt:
    kind = section.text("type", base.type if base else "std_msgs/msg/Float64")
    if not _TOPIC_TYPE.match(kind):
        section.place("type").fail(f"{kind!r} is not a message type; it should be like std_msgs/msg/Float64")
    field = section.text("field", "data")
    stamp = section.text("stamp", base.stamp if base else "")
    for key, path in (("field", field), ("stamp", stamp)):
        if path and not _FIELD.match(path):
            section.place(key).fail(f"{path!r} is not a field path; it should be like data[0] or twist.linear.x")
    topic = section.need("topic", "name of the topic").text()
    if not re.match(r"^[/~]?[a-zA-Z_][\w/]*$", topic):
        section.place("topic").fail(f"{topic!r} is not the name of a topic")
    return RosAt(topic=topic, type=kind, field=field, stamp=stamp)


_READERS: dict[str, Callable[..., At]] = {"modbus": _modbus_at, "opcua": _opcua_at, "ros": _ros_at}


def at_of(kind: str, section: Section, base: At | None = None) -> At:
    """The place of a tag; what the section does not say comes from ``base``."""
    at = _READERS[kind](section, base)
    section.done()
    return at


def base_of(kind: str, section: Section) -> At:
    """Defaults for places: the keys of a place but those that tell one tag from another."""
    at: At
    if kind == "modbus":
        at = ModbusAt(
            table=section.text("table", "holding", ("holding", "input")),
            address=0,
            type=section.text("type", "float32", tuple(codec.TYPES)),
            words=section.text("words", "ABCD", codec.WORD_ORDERS),
            unit_id=section.whole("unit_id", 1, 0, 247),
        )
    elif kind == "opcua":
        at = OpcuaAt(node="", index=-1, type=section.text("type", "Double", OPCUA_TYPES))
    else:
        at = RosAt(topic="", type=section.text("type", "std_msgs/msg/Float64"), field="data", stamp="")
    section.done()
    return at


def nth(at: At, i: int) -> At:
    """The place of the i-th of several tags written as one entry: next registers, or next element of an array."""
    if isinstance(at, ModbusAt):
        return replace(at, address=at.address + i * codec.size(at.type))
    if isinstance(at, OpcuaAt):
        return replace(at, index=max(at.index, 0) + i)
    head, _, tail = at.field.rpartition("[")
    if not head:
        return replace(at, field=f"{at.field}[{i}]")
    index, _, rest = tail.partition("]")
    return replace(at, field=f"{head}[{int(index) + i}]{rest}")


def words(at: At) -> str:
    """A place as people write it."""
    if isinstance(at, ModbusAt):
        return f"{at.table} {at.address} {at.type} {at.words} unit {at.unit_id}"
    if isinstance(at, OpcuaAt):
        return at.node + (f"[{at.index}]" if at.index >= 0 else "")
    return f"{at.topic} {at.field}"


def clash(a: At, b: At) -> bool:
    """Whether writing one place changes the other."""
    if isinstance(a, ModbusAt) and isinstance(b, ModbusAt):
        apart = a.address + codec.size(a.type) <= b.address or b.address + codec.size(b.type) <= a.address
        return (a.table, a.unit_id) == (b.table, b.unit_id) and not apart
    if isinstance(a, OpcuaAt) and isinstance(b, OpcuaAt):
        return a.node == b.node and (a.index == b.index or -1 in (a.index, b.index))
    if isinstance(a, RosAt) and isinstance(b, RosAt):
        return (a.topic, a.field) == (b.topic, b.field)
    return False
