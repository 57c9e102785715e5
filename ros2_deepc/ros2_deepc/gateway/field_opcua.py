# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""A plant behind an OPC UA server, namespace ``urn:ros2_deepc:field``.

| node | what | who writes |
|---|---|---|
| `count` | scan counter | - |
| `echo` | echo of the heartbeat | - |
| `out/NAME` | one for each output | - |
| `beat` | heartbeat | user `controller` |
| `in/NAME` | one for each input | user `controller` |

The user `viewer` reads only.
"""

import asyncio
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime

import numpy as np

from .field import Device, FieldPlant, every
from .opcua_server import Access, OpcuaServer

URI = "urn:ros2_deepc:field"


def writable(plant: FieldPlant) -> list[str]:
    """Names of the nodes that the user `controller` may write."""
    return ["beat", *(f"in/{name}" for name in plant.input_names)]


class OpcuaField:
    """Serves a device.

    Args:
        device: the plant's program.
        url: where to listen.
        access: who may do what.
        period: of the scans [s].
    """

    def __init__(self, device: Device, url: str, access: Access, period: float) -> None:
        self.device, self._period = device, period
        self.server = OpcuaServer(device.plant.name, URI, url, access)
        self._inputs = [f"in/{name}" for name in device.plant.input_names]
        self._outputs = [f"out/{name}" for name in device.plant.output_names]

    async def run(self, ready: Callable[[], None] = lambda: None) -> None:
        """Listens, calls ``ready`` and scans until cancelled.

        Raises:
            GatewayError: if the port cannot be had.
        """
        numbers: dict[str, float | int] = {"count": 0, "echo": 0, "beat": 0}
        numbers |= dict.fromkeys(self._outputs, 0.0)
        numbers |= {name: float(safe) for name, safe in zip(self._inputs, self.device.safe, strict=True)}
        await self.server.start(numbers, writable(self.device.plant))
        ready()
        try:
            with suppress(asyncio.CancelledError):
                await every(self._period, self._scan)
        finally:
            await self.server.stop()

    async def _scan(self, now: float) -> None:
        server, device = self.server, self.device
        u = np.array([server.get(name) for name in self._inputs], dtype=np.float64)
        device.scan(u, int(server.get("beat")), now)
        time = datetime.now(tz=UTC).replace(tzinfo=None)
        for name, value in zip(self._outputs, device.y, strict=True):
            await server.put(name, float(value), time=time)
        await server.put("echo", device.echo, time=time)
        await server.put("count", device.count, time=time)


def opcua_places(plant: FieldPlant) -> Callable[[str, int], str]:
    """Places of this server, for `field_tags.tag_map`."""

    def place(role: str, i: int) -> str:
        names = {"output": plant.output_names, "input": plant.input_names}
        node = {"scan": "count", "echo": "echo", "beat": "beat"}.get(role) or f"{role[:-3]}/{names[role][i]}"
        kind = ", type: UInt32" if role == "beat" else ""
        return f"{{node: 'nsu={URI};s={node}'{kind}}}"

    return place
