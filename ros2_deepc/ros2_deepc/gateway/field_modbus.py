# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""A plant behind a Modbus/TCP server.

| registers | what |
|---|---|
| input 0 | scan counter, uint16 |
| input 1 | echo of the heartbeat, uint16 |
| input 2.. | outputs, in order |
| holding 0 | heartbeat, uint16 |
| holding 1.. | inputs, in order |
"""

import asyncio
from collections.abc import Callable
from contextlib import suppress

from . import modbus_codec as codec
from .field import Device, every
from .modbus_server import ModbusServer, Registers

FIRST_OUTPUT, FIRST_INPUT = 2, 1


class ModbusField:
    """Serves a device.

    Args:
        device: the plant's program.
        host: address to listen on.
        port: TCP port.
        kind: type of the numbers, see `modbus_codec.TYPES`.
        period: of the scans [s].
    """

    def __init__(self, device: Device, host: str, port: int, kind: str, period: float) -> None:
        self.device, self._kind, self._period = device, kind, period
        m, p, size = len(device.safe), len(device.y), codec.size(kind)
        self.registers = Registers(holding=FIRST_INPUT + m * size, inputs=FIRST_OUTPUT + p * size)
        self._server = ModbusServer(self.registers, host, port)
        self.registers.tables["holding"][FIRST_INPUT:] = codec.encode(device.safe, kind)

    async def run(self, ready: Callable[[], None] = lambda: None) -> None:
        """Listens, calls ``ready`` and scans until cancelled.

        Raises:
            GatewayError: if the port cannot be had.
        """
        await self._server.start()
        ready()
        try:
            with suppress(asyncio.CancelledError):
                await every(self._period, self._scan)
        finally:
            await self._server.stop()

    async def _scan(self, now: float) -> None:
        holding, inputs = self.registers.tables["holding"], self.registers.tables["input"]
        u = codec.decode(holding[FIRST_INPUT:], self._kind)
        self.device.scan(u, int(holding[0]), now)
        inputs[FIRST_OUTPUT:] = codec.encode(self.device.y, self._kind)
        inputs[:FIRST_OUTPUT] = self.device.count, self.device.echo
