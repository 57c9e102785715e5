# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""A plant as a field device: scans by itself, counts its scans, echoes the heartbeat, and has a watchdog.

Plants are found by the entry point group `ros2_deepc.plants`, as everywhere.
"""

import asyncio
import time
from collections.abc import Awaitable, Callable, Mapping
from typing import Any, Protocol

import numpy as np

from ..ros import plants
from .errors import GatewayError
from .tags import Array

COUNTER = 2**16  # scans and heartbeats start again from 0 here


class FieldPlant(Protocol):
    """What a registered plant must offer to be a field device; plant_sim.Plant does."""

    name: str
    variant: str
    sample_time: float
    input_names: tuple[str, ...]
    input_units: tuple[str, ...]
    output_names: tuple[str, ...]
    output_units: tuple[str, ...]
    input_min: Array
    input_max: Array
    prior: Any

    def start(self, seed: int) -> Any:
        """A running plant with a method ``push(u)`` that returns y."""


def find_plant(name: str, options: Mapping[str, str]) -> FieldPlant:
    """A registered plant.

    Raises:
        GatewayError: for an unknown name or option.
    """
    try:
        plant: FieldPlant = plants.find_plant(name, options)
    except ValueError as error:
        raise GatewayError(str(error)) from None
    return plant


class Device:
    """The program of the field device, one scan after the other.

    The plant stands still until the first heartbeat. In local control the inputs are 0 (or the nearest that the limits
    allow); the inputs that it is given count only while the heartbeat moves.

    Args:
        plant: what it runs.
        seed: of the plant's own randomness.
        watchdog: [s] without a heartbeat after which local control takes over; inf = never.
    """

    def __init__(self, plant: FieldPlant, seed: int = 0, watchdog: float = 1.0) -> None:
        self.plant = plant
        self.count = self.echo = 0
        self.local = True
        self.safe: Array = np.clip(0.0, plant.input_min, plant.input_max)
        self.u = self.safe
        self._stepper, self._watchdog = plant.start(seed), watchdog
        self.y = self._first(plant, seed)
        self._beat_at: float | None = None

    def scan(self, u: Array, beat: int, now: float) -> None:
        """One scan.

        Args:
            u: inputs asked for, shape (m,).
            beat: the gateway's heartbeat.
            now: own clock [s].
        """
        if beat != self.echo:
            self._beat_at, self.echo = now, beat
        self.local = self._beat_at is None or now - self._beat_at > self._watchdog
        self.count = (self.count + 1) % COUNTER
        if self._beat_at is None:
            return
        usable = bool(np.isfinite(u).all())
        self.u = np.clip(u, self.plant.input_min, self.plant.input_max) if usable and not self.local else self.safe
        y = self._stepper.push(self.u)
        if y is not None:
            self.y = np.asarray(y)

    def _first(self, plant: FieldPlant, seed: int) -> Array:
        """What the instruments read while the plant stands still: the outputs of a twin under local control."""
        twin, y = plant.start(seed), None
        while y is None:
            y = twin.push(self.safe)
        return np.asarray(y)


async def every(period: float, scan: Callable[[float], Awaitable[None]]) -> None:
    """Calls ``scan(now)`` every period [s] until cancelled; what is too late is skipped, not made up for."""
    due = time.monotonic()
    while True:
        await scan(time.monotonic())
        due = max(due + period, time.monotonic() - period)
        await asyncio.sleep(max(0.0, due - time.monotonic()))
