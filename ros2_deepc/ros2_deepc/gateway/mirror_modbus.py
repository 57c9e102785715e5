# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The mirror behind Modbus/TCP: the same registers by functions 3 and 4; every write is refused with exception 1.

| registers | what |
|---|---|
| 0 | state of the gateway: 0 SHADOW, 1 RUN, 2 DEGRADED, 3 FALLBACK |
| 1 | mode of the controller, numbered as in ControllerState; 65535 = not heard of |
| 2 to 5 | verdicts on R- and C-controllability, R- and C-observability, as in Verdict; 65535 = not heard of |
| 6 | worst quality of the outputs: 0 GOOD, 1 UNCERTAIN or STALE, 3 BAD |
| 8, 10, 12 | epoch, k modulo 2^32, commands refused since the start; uint32 |
| 14 | round trip [s], float32 |
| 16.. | outputs, then references, then inputs, in the order of the tag map; float32 |
"""

from collections.abc import Mapping
from datetime import datetime
from typing import Any

import numpy as np

from . import modbus_codec as codec
from .mirror import MODES, PROPERTIES, VERDICTS
from .modbus_server import ModbusServer, Registers
from .supervisor import State
from .tags import TagMap

_WORDS = {"state": tuple(State), "mode": MODES} | dict.fromkeys(PROPERTIES, VERDICTS)
_AT = {name: i for i, name in enumerate(_WORDS)}
_QUALITY, _FIRST = 6, 16
_COUNTS = {"epoch": 8, "k": 10, "refused": 12}
_ROUND_TRIP = 14
_UNKNOWN = 0xFFFF
_LARGEST = float(np.finfo(np.float32).max)


class ModbusMirror:
    """Registers that show a zone.

    Args:
        m: number of inputs.
        p: number of outputs.
        host: address to listen on.
        port: TCP port.
    """

    def __init__(self, m: int, p: int, host: str, port: int) -> None:
        size = _FIRST + 2 * (2 * p + m)
        self.registers = Registers(holding=0, inputs=size, read_only=True)
        self.registers.tables["holding"] = self.registers.tables["input"]
        self._floats = {"round_trip": _ROUND_TRIP}
        self._floats |= {"outputs": _FIRST, "reference": _FIRST + 2 * p, "inputs": _FIRST + 4 * p}
        self._lengths = {"round_trip": 1, "outputs": p, "reference": p, "inputs": m}
        self._server = ModbusServer(self.registers, host, port)

    async def start(self, values: Mapping[str, Any]) -> None:
        """Listens.

        Raises:
            GatewayError: if the port cannot be had.
        """
        for name, value in values.items():
            self._show(name, value)
        await self._server.start()

    async def put(self, name: str, value: Any, *, status: int = 0, time: datetime | None = None) -> None:  # noqa: ARG002
        """Shows a value; registers know no time, and no reasons."""
        self._show(name, value)
        if name == "outputs":
            self.registers.tables["input"][_QUALITY] = status >> 30 | status >> 31  # of OPC UA: 0, 1 or 3

    async def stop(self) -> None:
        """Stops listening."""
        await self._server.stop()

    def _show(self, name: str, value: Any) -> None:
        table = self.registers.tables["input"]
        if name in _WORDS:
            known = _WORDS[name]
            table[_AT[name]] = known.index(value) if value in known else _UNKNOWN
        elif name in _COUNTS:
            at = _COUNTS[name]
            table[at : at + 2] = codec.encode([value % 2**32], "uint32")
        elif name in self._floats:
            numbers = np.atleast_1d(np.asarray(value, dtype=np.float64))[: self._lengths[name]]
            fits = np.isnan(numbers) | np.isinf(numbers) | (np.abs(numbers) <= _LARGEST)
            at = self._floats[name]
            table[at : at + 2 * len(numbers)] = codec.encode(np.where(fits, numbers, np.nan), "float32")


def window(tags: TagMap) -> ModbusMirror:
    """The server of a tag map's section ``serve``."""
    serve = tags.serve
    assert serve is not None
    return ModbusMirror(len(tags.inputs), len(tags.outputs), serve.host, serve.port)
