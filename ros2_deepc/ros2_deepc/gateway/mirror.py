# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""What the zone looks like from outside: a read-only server for HMIs and historians, behind OPC UA or Modbus/TCP."""

import asyncio
from collections.abc import Mapping
from contextlib import suppress
from datetime import UTC, datetime
from typing import Any, Protocol

from .core import Gateway, Outputs
from .extras import with_extra
from .tags import TagMap

PROPERTIES = ("r_controllability", "c_controllability", "r_observability", "c_observability")
MODES = ("IDLE", "COLLECTING", "CONTROLLING", "HOLDING", "FALLBACK", "SHADOW")
VERDICTS = ("UNDECIDED", "PROVED", "NOT_PROVED", "PRIOR_VIOLATED", "REFUTED", "NOT_DECIDABLE")
_UNCERTAIN, _BAD = 0x40000000, 0x80000000
_STATUS = (0, _UNCERTAIN, _UNCERTAIN, _BAD)  # of GOOD, UNCERTAIN, STALE, BAD


class Window(Protocol):
    """A server that shows named values."""

    async def start(self, values: Mapping[str, Any]) -> None:
        """Listens; ``values`` are names and values at the start."""

    async def put(self, name: str, value: Any, *, status: int = 0, time: datetime | None = None) -> None:
        """Shows a value, with OPC UA status code and source time."""

    async def stop(self) -> None:
        """Stops listening."""


class Mirror:
    """Shows the newest of everything; every method is called in the loop that ``run`` runs in.

    Args:
        tags: with the section ``serve``.

    Raises:
        GatewayError: if the password is missing.
        MissingExtraError: if the package of the protocol is not installed.
    """

    def __init__(self, tags: TagMap) -> None:
        assert tags.serve is not None
        self._tags, self._wake = tags, asyncio.Event()
        self._news: dict[str, tuple[Any, int, int]] = {}
        self.window: Window = with_extra(tags.serve.kind, f"mirror_{tags.serve.kind}").window(tags)

    async def run(self) -> None:
        """Listens until cancelled.

        Raises:
            GatewayError: if the port cannot be had.
        """
        await self.window.start(self._start())
        try:
            with suppress(asyncio.CancelledError):
                while True:
                    await self._wake.wait()
                    self._wake.clear()
                    await self._flush()
        finally:
            await self.window.stop()

    def _start(self) -> dict[str, Any]:
        """Every name with its value before anything is known."""
        m, p = len(self._tags.inputs), len(self._tags.outputs)
        start: dict[str, Any] = dict.fromkeys(("state", "reason", "mode", *PROPERTIES), "")
        start |= {"epoch": 0, "k": 0, "refused": 0, "round_trip": 0.0}
        start |= {"outputs": [0.0] * p, "reference": [0.0] * p, "inputs": [0.0] * m}
        start |= {"output_names": [tag.name for tag in self._tags.outputs]}
        return start | {"input_names": [tag.name for tag in self._tags.inputs]}

    def sample(self, outputs: Outputs) -> None:
        """Takes outputs."""
        vector = outputs.vector
        status = _STATUS[int(vector.quality.max(initial=0))]
        self._set("outputs", vector.values.tolist(), status, vector.stamp_ns)
        self._set("epoch", outputs.epoch)
        self._set("k", outputs.k)

    def gateway(self, gateway: Gateway) -> None:
        """Takes the state of the gateway."""
        self._set("state", str(gateway.state))
        self._set("reason", gateway.supervisor.reason)
        self._set("refused", sum(gateway.guard.counts.refused.values()))
        if gateway.round_trip.measured:
            self._set("round_trip", gateway.round_trip.median)

    def inputs(self, msg: Any) -> None:
        """Takes a Sample of inputs."""
        self._set("inputs", [float(value) for value in msg.values])

    def reference(self, msg: Any) -> None:
        """Takes a Sample of references."""
        self._set("reference", [float(value) for value in msg.values])

    def controller(self, msg: Any) -> None:
        """Takes a ControllerState."""
        self._set("mode", MODES[msg.mode] if msg.mode < len(MODES) else str(msg.mode))

    def report(self, msg: Any) -> None:
        """Takes a MonitorReport."""
        for name in PROPERTIES:
            verdict = getattr(msg, name).verdict
            self._set(name, VERDICTS[verdict] if verdict < len(VERDICTS) else str(verdict))

    def _set(self, name: str, value: Any, status: int = 0, time_ns: int = 0) -> None:
        self._news[name] = (value, status, time_ns)
        self._wake.set()

    async def _flush(self) -> None:
        news, self._news = self._news, {}
        for name, (value, status, time_ns) in news.items():
            time = datetime.fromtimestamp(time_ns / 1e9, tz=UTC).replace(tzinfo=None) if time_ns else None
            await self.window.put(name, value, status=status, time=time)
