# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Moves a gateway: looks at the field, publishes, writes, reconnects."""

import asyncio
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from .assemble import Quality, Scan
from .core import Gateway, Outputs
from .errors import LinkError
from .guard import Command, Refusal
from .link import Link
from .tags import SCAN, Array

_RETRY = 0.2  # [s] between two tries to connect
_SAME = 3  # reads until the field's counter has stood still during one


class Engine:
    """One gateway and its link, in one event loop; nothing here may be called from another thread.

    Args:
        gateway: the core.
        link: to the field.
        on_outputs: called with every sample, at once.
        on_look: called after every look at the field and every command, for whoever watches the state.
    """

    def __init__(
        self,
        gateway: Gateway,
        link: Link,
        *,
        on_outputs: Callable[[Outputs], None],
        on_look: Callable[[], None] = lambda: None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.gateway = gateway
        self._link, self._clock = link, clock
        self._on_outputs, self._on_look = on_outputs, on_look
        self._wake, self._ended = asyncio.Event(), asyncio.Event()
        self._connected = False
        self._count = np.nan
        self._stop = False
        tags = gateway.tags
        self._scan_at = len(tags.outputs) if tags.by == "scan" else None
        assert self._scan_at is None or tags.counters[0].name == SCAN

    async def run(self) -> None:
        """Runs until ``stop``."""
        watch = asyncio.create_task(self._watch())
        try:
            while not self._stop:
                await self._look()
                await self._until(self._clock() + self.gateway.wait(self._clock()))
        finally:
            watch.cancel()
            await self._link.close()
            self._ended.set()

    async def leave(self) -> None:
        """Leaves the fallback behind in the field, ends ``run`` and waits for that."""
        gateway = self.gateway
        gateway.leave(self._clock())
        end = self._clock() + gateway.tags.supervision.ramp + 2 * _RETRY
        while not (gateway.settled() or self._clock() > end):
            await asyncio.sleep(gateway.tags.period / 2)
        self.stop()
        await self._ended.wait()

    def stop(self) -> None:
        """Ends ``run`` at once."""
        self._stop = True
        self._wake.set()

    def command(self, command: Command) -> Refusal | None:
        """Takes a command; it is written as soon as the link is free."""
        refusal = self.gateway.command(command, self._clock())
        self._on_look()
        if refusal is None:
            self._wake.set()
        return refusal

    async def _watch(self) -> None:
        """Looks at the time even while the field does not answer: no time-out of a link delays a change of state."""
        while True:
            await asyncio.sleep(self.gateway.tags.period / 4)
            self.gateway.tick(self._clock())
            self._on_look()

    async def _until(self, end: float) -> None:
        """Waits; writes what commands bring meanwhile."""
        while not self._stop and (left := end - self._clock()) > 0:
            try:
                async with asyncio.timeout(left):
                    await self._wake.wait()
            except TimeoutError:
                return
            self._wake.clear()
            if self._connected:
                await self._flush()

    async def _look(self) -> None:
        if not self._connected and not await self._connect():
            return
        try:
            started = self._clock()
            scan = await self._read()
            now = self._clock()
        except LinkError as error:
            await self._lost(error)
            return
        self.gateway.answered(now - started)
        outputs = self.gateway.scan(scan, now, time.time_ns())
        if outputs is not None:
            self._on_outputs(outputs)
        await self._flush()
        self._on_look()

    async def _connect(self) -> bool:
        try:
            await self._link.connect()
        except LinkError as error:
            self.gateway.failed(str(error), self._clock())
            self._on_look()
            await self._until(self._clock() + _RETRY)
            return False
        self._connected = True
        return True

    async def _read(self) -> Scan:
        """One coherent scan: if it took several requests, the field must not have moved on meanwhile."""
        scan = await self._link.read()
        if self._scan_at is None or self._link.atomic or scan.raw[self._scan_at] == self._count:
            return scan
        for _ in range(_SAME):
            again = await self._link.read()
            if again.raw[self._scan_at] == scan.raw[self._scan_at]:
                break
            scan = again
        else:  # the field is faster than we read: these numbers need not belong together
            scan = replace(scan, quality=np.maximum(scan.quality, Quality.UNCERTAIN).astype(np.uint8))
        self._count = scan.raw[self._scan_at]
        return scan

    async def _flush(self) -> None:
        order: Array | None = self.gateway.order(self._clock())
        if order is None:
            return
        try:
            sent = self._clock()
            await self._link.write(order)
        except LinkError as error:
            await self._lost(error)
            return
        self.gateway.wrote(order, sent)

    async def _lost(self, error: LinkError) -> None:
        self._connected = False
        self.gateway.failed(str(error), self._clock())
        self._on_look()
        await self._link.close()
