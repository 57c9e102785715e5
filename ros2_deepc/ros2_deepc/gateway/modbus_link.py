# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Modbus/TCP: the gateway as a client."""

import asyncio
import logging
from collections import defaultdict
from collections.abc import Coroutine, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pymodbus.client import AsyncModbusTcpClient
from pymodbus.exceptions import ModbusException
from pymodbus.pdu import ModbusPDU

from . import modbus_codec as codec
from .assemble import Quality, Scan
from .errors import LinkError
from .modbus_codec import Block
from .tags import Array, ModbusAt, TagMap

_Decoder = tuple[str, str, NDArray[np.int_], NDArray[np.int_]]  # type, order, tags (i,), words of each (i, size)
_BRIDGE = 16  # unused registers between two tags that cost less than a request of their own

logging.getLogger("pymodbus").setLevel(logging.CRITICAL)  # every failure is reported by the gateway itself


class ModbusLink:
    """Reads all tags in as few requests as their addresses allow; writes neighbours together.

    Args:
        tags: with places of kind ModbusAt.
    """

    def __init__(self, tags: TagMap) -> None:
        self._link = tags.link
        self._where = f"{self._link.host}:{self._link.port}"
        reads = [at for tag in tags.reads if isinstance(at := tag.at, ModbusAt)]
        self._writes = [at for tag in tags.writes if isinstance(at := tag.at, ModbusAt)]
        requests = codec.blocks([_span(at) for at in reads], codec.LARGEST_READ, bridge=_BRIDGE)
        self._plan = [(block, _decoders(block, reads)) for block in requests]
        self._count = len(reads)
        self._counter = len(tags.outputs) if tags.by == "scan" else None
        if self._counter is not None:
            counter = _span(reads[self._counter])
            self._plan.sort(key=lambda request: not request[0].covers(counter))
        self._last = np.full(self._count, np.nan)
        self._client: AsyncModbusTcpClient | None = None
        self._lost: asyncio.Future[None] | None = None
        self.atomic = len(self._plan) == 1

    async def connect(self) -> None:
        """Connects."""
        await self.close()
        lost: asyncio.Future[None] = asyncio.get_running_loop().create_future()

        def trace(connected: bool) -> None:
            if not connected and not lost.done():
                lost.set_result(None)

        client = AsyncModbusTcpClient(
            self._link.host, port=self._link.port, timeout=self._link.timeout, retries=0, reconnect_delay=0.0,
            trace_connect=trace,
        )  # fmt: skip
        try:
            connected = await client.connect()
        except (ModbusException, OSError) as error:
            client.close()
            raise LinkError(f"{self._where}: {error}") from None
        if not connected:
            client.close()
            raise LinkError(f"{self._where}: no connection")
        self._client, self._lost = client, lost
        self._last = np.full(self._count, np.nan)

    async def read(self) -> Scan:
        """Reads every block once; while the scan counter stands still, only the block that holds it."""
        raw = self._last.copy()
        for i, (block, decoders) in enumerate(self._plan):
            registers = await self._read(block)
            for kind, order, places, words in decoders:
                raw[places] = codec.decode(registers[words].ravel(), kind, order)
            if i == 0 and self._counter is not None and raw[self._counter] == self._last[self._counter]:
                break
        self._last = raw
        good = np.where(np.isfinite(raw), Quality.GOOD, Quality.BAD).astype(np.uint8)
        return Scan(raw=raw.copy(), quality=good, source_ns=np.zeros(self._count, dtype=np.int64))

    async def write(self, raw: Array) -> None:
        """Writes neighbouring registers in one request."""
        spans: dict[Block, list[int]] = {}
        for value, at in zip(raw, self._writes, strict=True):
            if not np.isnan(value):
                spans[_span(at)] = codec.encode([float(value)], at.type, at.words)
        for block in codec.blocks(spans, codec.LARGEST_WRITE):
            mine = sorted((span.address, words) for span, words in spans.items() if block.covers(span))
            await self._write(block, [word for _, words in mine for word in words])

    async def close(self) -> None:
        """Disconnects."""
        if self._client is not None:
            self._client.close()
            self._client = None
            await asyncio.sleep(0)  # the loop closes the socket

    async def _read(self, block: Block) -> NDArray[np.int_]:
        client = self._connected()
        ask = client.read_input_registers if block.table == "input" else client.read_holding_registers
        answer = await self._answer(ask(block.address, count=block.count, device_id=block.unit_id))
        self._check(answer, block)
        if len(answer.registers) < block.count:
            raise LinkError(f"{self._where}: {len(answer.registers)} registers instead of {block.count}")
        return np.asarray(answer.registers[: block.count])

    async def _write(self, block: Block, registers: list[int]) -> None:
        client = self._connected()
        answer = await self._answer(client.write_registers(block.address, registers, device_id=block.unit_id))
        self._check(answer, block)

    async def _answer(self, request: Coroutine[Any, Any, ModbusPDU]) -> ModbusPDU:
        """The answer to a request; a lost connection ends the wait for it at once, not after the time-out."""
        assert self._lost is not None
        asked = asyncio.ensure_future(request)
        try:
            await asyncio.wait((asked, self._lost), return_when=asyncio.FIRST_COMPLETED)
            if not asked.done():
                raise LinkError(f"{self._where}: connection lost")
            return asked.result()
        except (ModbusException, OSError) as error:
            raise LinkError(f"{self._where}: {error}") from None
        finally:
            asked.cancel()

    def _connected(self) -> AsyncModbusTcpClient:
        if self._client is None or not self._client.connected:
            raise LinkError(f"{self._where}: connection lost")
        return self._client

    def _check(self, answer: ModbusPDU, block: Block) -> None:
        if answer.isError():
            code = getattr(answer, "exception_code", 0)
            where = f"{block.table} {block.address} to {block.address + block.count - 1}, unit {block.unit_id}"
            raise LinkError(f"{self._where}: refused with exception {code} ({where})")


def _span(at: ModbusAt) -> Block:
    return Block(at.table, at.unit_id, at.address, codec.size(at.type))


def _decoders(block: Block, places: Sequence[ModbusAt]) -> list[_Decoder]:
    """How to take a block apart, for each type and word order in it."""
    groups: dict[tuple[str, str], list[tuple[int, int]]] = defaultdict(list)
    for i, at in enumerate(places):
        if block.covers(_span(at)):
            groups[at.type, at.words].append((i, at.address - block.address))
    found = []
    for (kind, order), group in groups.items():
        tags, starts = np.array(group).T
        found.append((kind, order, tags, starts[:, None] + np.arange(codec.size(kind))))
    return found
