# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""What `ros2-deepc gateway` and `ros2-deepc field` do."""

import asyncio
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from . import modbus_codec as codec
from .assemble import Assembler, Quality, Scan
from .errors import GatewayError, LinkError
from .extras import with_extra
from .field import Device, find_plant
from .link import make_link
from .load import load
from .places import words
from .tags import TagMap
from .units import check_registered

_PORTS = {"modbus": 5020, "opcua": 4840}
Row = tuple[str, ...]
HEADER: Row = ("tag", "direction", "place", "unit", "scaling", "limits", "value", "quality")


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldOptions:
    """How to serve a plant.

    Attributes:
        protocol: "modbus" or "opcua".
        host: address to listen on.
        port: TCP port; 0 = 5020 for Modbus, 4840 for OPC UA.
        options: of the plant.
        seed: of the plant's randomness.
        speed: how many times faster than its own time it runs.
        type: of the numbers in Modbus registers.
        pki: folder of certificates for OPC UA; None = no encryption, on the loopback only.
        tags: where to write a tag map that fits, or None.
    """

    protocol: str
    host: str = "127.0.0.1"
    port: int = 0
    options: Mapping[str, str] = field(default_factory=dict)
    seed: int = 0
    speed: float = 1.0
    type: str = "float64"
    pki: Path | None = None
    tags: Path | None = None

    @property
    def listen(self) -> int:
        """The TCP port."""
        return self.port or _PORTS[self.protocol]


def check(path: Path, namespace: str = "") -> list[Row]:
    """Validates a tag map, reads every tag once and writes nothing.

    Args:
        path: of the tag map.
        namespace: of the zone, for topics with relative names.

    Returns:
        One row a tag, columns as in HEADER.

    Raises:
        GatewayError: for a tag map that cannot work, or a field that does not answer.
    """
    tags = load(path)
    check_registered(tags)
    if tags.kind == "ros":
        return table(tags, _read_topics(tags, namespace))
    return table(tags, asyncio.run(_read_once(tags)))


async def _read_once(tags: TagMap) -> Scan:
    link = make_link(tags)
    try:
        await link.connect()
        return await link.read()
    except LinkError as error:
        raise GatewayError(f"{tags.file}: {error}") from None
    finally:
        await link.close()


def _read_topics(tags: TagMap, namespace: str) -> Scan:
    """One message of every topic, or what came within the time after which a tag counts as stale."""
    from .ros_check import listen

    return listen(tags, namespace)


def table(tags: TagMap, scan: Scan) -> list[Row]:
    """Every tag as resolved, with what was just read."""
    vector = Assembler(tags).take(scan, 0.0, time.time_ns())
    rows: list[Row] = []
    for i, tag in enumerate(tags.reads):
        is_output = i < len(tags.outputs)
        value = vector.values[i] if is_output else scan.raw[i]
        quality = Quality(int(vector.quality[i] if is_output else scan.quality[i])).name
        limits = "" if not np.isfinite([tag.low, tag.high]).any() else f"{tag.low:g} to {tag.high:g}"
        rows.append((tag.name, "read", words(tag.at), tag.unit, _scaling(tag), limits, f"{value:.6g}", quality))
    for out in tags.writes:
        rate = f", {out.max_rate:g}/s" if np.isfinite(out.max_rate) else ""
        limits = f"{out.low:g} to {out.high:g}{rate}"
        rows.append((out.name, "write", words(out.at), out.unit, _scaling(out), limits, "-", "-"))
    return rows


def _scaling(tag: Any) -> str:
    if (tag.scale, tag.offset) == (1.0, 0.0):
        return ""
    offset = f" {tag.offset:+g}" if tag.offset else ""
    return f"{tag.scale:g} {tag.unit}/{tag.raw_unit or '1'}{offset}"


def run_gateway(path: Path, namespace: str = "", arguments: list[str] | None = None) -> int:
    """Runs the gateway node until a signal; returns the exit code.

    Raises:
        GatewayError: for a tag map that cannot work (before any node exists).
    """
    from ..ros.run import run_node
    from .gateway_node import GatewayNode

    check_registered(load(path))
    args = [*(arguments or []), "--ros-args", "-p", f"tags:={path}"]
    if namespace:
        args += ["-r", f"__ns:={namespace}"]
    return run_node(GatewayNode, args)


def run_field(name: str, options: FieldOptions, say: Callable[[str], None] = print) -> None:
    """Serves a registered plant as a field device until interrupted.

    Args:
        name: of the plant.
        options: how.
        say: where to say what is served.

    Raises:
        GatewayError: if it cannot be served.
    """
    plant = find_plant(name, options.options)
    period = plant.sample_time / options.speed
    watchdog = max(1.0, 10 * period)
    server, text = _server(name, options, Device(plant, options.seed, watchdog), period)
    if options.tags is not None:
        options.tags.write_text(text, encoding="utf-8")
        say(f"a tag map that fits: {options.tags}")

    def ready() -> None:
        say(f"{plant.name} behind {options.protocol} on {options.host}:{options.listen}, a scan every {period:g} s")
        say("in local control until a heartbeat comes; Ctrl-C ends it")

    try:
        asyncio.run(server.run(ready))
    except KeyboardInterrupt:
        say("stopped")


def _server(name: str, options: FieldOptions, device: Device, period: float) -> tuple[Any, str]:
    """The server and a tag map for it."""
    from . import field_tags

    plant, port = device.plant, options.listen
    common: dict[str, Any] = {"registered": name, "options": dict(options.options), "speed": options.speed}
    if options.protocol == "modbus":
        link = f"{{kind: modbus, host: {options.host}, port: {port}}}"
        if options.type not in codec.TYPES:
            raise GatewayError(f"--type {options.type}: there are {', '.join(codec.TYPES)}")
        server = with_extra("modbus", "field_modbus").ModbusField(device, options.host, port, options.type, period)
        return server, field_tags.tag_map(plant, link, field_tags.modbus_places(options.type), **common)
    module = with_extra("opcua", "field_opcua")
    url = f"opc.tcp://{options.host}:{port}"
    security = "allow_insecure_loopback: true"
    if options.pki is not None:
        security = "user: controller, password_env: FIELD_CONTROLLER_PASSWORD"
    link = f"{{kind: opcua, url: '{url}', {security}}}"
    server = module.OpcuaField(device, url, _access(module, plant, options), period)
    return server, field_tags.tag_map(plant, link, module.opcua_places(plant), **common)


def _access(module: Any, plant: Any, options: FieldOptions) -> Any:
    """Users from the environment; nobody without encryption."""
    if options.pki is None:
        return module.Access()
    users = {}
    for user in ("controller", "viewer"):
        variable = f"FIELD_{user.upper()}_PASSWORD"
        if password := os.environ.get(variable, ""):
            users[user] = password
    if "controller" not in users:
        raise GatewayError("set the environment variable FIELD_CONTROLLER_PASSWORD (and FIELD_VIEWER_PASSWORD)")
    return module.Access(users=users, writes={"controller": module.writable(plant)}, pki=options.pki)
