# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Modbus/TCP: registers behind a server, for a field device made of software."""

import logging
from collections.abc import Callable, Sequence

import numpy as np
from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from .errors import GatewayError

_READ = {3: "holding", 4: "input"}
_WRITE = (6, 16)

logging.getLogger("pymodbus").setLevel(logging.CRITICAL)


class Registers:
    """Holding and input registers with an allow-list: reading by functions 3 and 4, writing by 6 and 16.

    Args:
        holding: number of holding registers.
        inputs: number of input registers.
        on_write: called after every write with first address and number of registers.
        read_only: refuse every write.
    """

    def __init__(
        self, holding: int, inputs: int, on_write: Callable[[int, int], None] = lambda *_: None, *,
        read_only: bool = False,
    ) -> None:  # fmt: skip
        self.tables = {"holding": np.zeros(holding, dtype=np.uint16), "input": np.zeros(inputs, dtype=np.uint16)}
        self.refused = 0
        self._on_write, self._write = on_write, () if read_only else _WRITE

    async def async_getValues(self, device_id: int, func_code: int, address: int, count: int = 1) -> object:  # noqa: ARG002 - the server's names
        """Registers, or an exception code."""
        if func_code not in _READ and func_code not in self._write:
            return self._no(ExcCodes.ILLEGAL_FUNCTION)
        table = self.tables[_READ.get(func_code, "holding")]
        if address + count > len(table):
            return self._no(ExcCodes.ILLEGAL_ADDRESS)
        return [int(word) for word in table[address : address + count]]

    async def async_setValues(self, device_id: int, func_code: int, address: int, values: Sequence[int]) -> object:  # noqa: ARG002
        """None, or an exception code."""
        if func_code not in self._write:
            return self._no(ExcCodes.ILLEGAL_FUNCTION)
        table = self.tables["holding"]
        if address + len(values) > len(table):
            return self._no(ExcCodes.ILLEGAL_ADDRESS)
        table[address : address + len(values)] = values
        self._on_write(address, len(values))
        return None

    def device_ids(self) -> list[int]:
        """All devices behind this server; every one is the same."""
        return [1]

    def _no(self, code: ExcCodes) -> ExcCodes:
        self.refused += 1
        return code


class ModbusServer:
    """A Modbus/TCP server of registers.

    Args:
        registers: what it serves.
        host: address to listen on; Modbus has no security, so keep it on loopback or a network of its own.
        port: TCP port.
    """

    def __init__(self, registers: Registers, host: str, port: int) -> None:
        self._registers, self._host, self._port = registers, host, port
        self._server: ModbusTcpServer | None = None

    async def start(self) -> None:
        """Listens.

        Raises:
            GatewayError: if the port cannot be had.
        """
        placeholder = SimDevice(1, simdata=[SimData(0, count=1, values=0, datatype=DataType.REGISTERS)])
        server = ModbusTcpServer(placeholder, address=(self._host, self._port))
        server.context = self._registers
        try:
            await server.serve_forever(background=True)
        except (RuntimeError, OSError):
            raise GatewayError(f"cannot listen on {self._host}:{self._port}: taken, or not allowed") from None
        self._server = server

    async def stop(self) -> None:
        """Closes every connection and stops listening."""
        if self._server is not None:
            await self._server.shutdown()
            self._server = None
