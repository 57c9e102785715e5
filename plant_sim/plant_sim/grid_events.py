# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""What happens to a grid while it runs: load steps, line trips, generator limits, written as text."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .arrays import Array
from .errors import PlantError
from .swing_dae import SwingGrid

_NUMBER = r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)"
_FORMS = {
    "load": re.compile(rf"load\s+(\d+)\s+{_NUMBER}"),
    "trip": re.compile(r"trip\s+(\d+)-(\d+)"),
    "close": re.compile(r"close\s+(\d+)-(\d+)"),
    "limit": re.compile(rf"limit\s+(\d+)\s+{_NUMBER}\s+{_NUMBER}"),
}
GRAMMAR = "load BUS CHANGE @ K, trip FROM-TO @ K, close FROM-TO @ K, limit BUS LOW HIGH @ K; several separated by ';'"


@dataclass(frozen=True, slots=True)
class GridEvent:
    """One event.

    Attributes:
        k: sample at whose instant it happens, after the outputs are measured.
        kind: "load", "trip", "close" or "limit".
        buses: numbers of the bus, or of both ends of the branch.
        values: change of load, or lower and upper limit of mechanical power, per unit.
        text: as written.
    """

    k: int
    kind: str
    buses: tuple[int, ...]
    values: tuple[float, ...]
    text: str


@dataclass(frozen=True, slots=True, eq=False)
class Switched:
    """A grid between two events: its loads and branches as they are, and the limits of its machines, shape (g,)."""

    grid: SwingGrid
    low: Array
    high: Array


def parse_events(text: str) -> tuple[GridEvent, ...]:
    """Events in the order of k, from text such as "load 9 +0.3 @ 250; trip 4-7 @ 300".

    Raises:
        PlantError: if an event is not understood.
    """
    events = []
    for item in filter(None, (part.strip() for part in text.split(";"))):
        what, at, when = (part.strip() for part in item.partition("@"))
        kind = what.split(" ")[0]
        found = _FORMS[kind].fullmatch(what) if kind in _FORMS else None
        if not at or not when.isdecimal() or found is None:
            raise PlantError(f"event {item!r} is not understood: write {GRAMMAR}")
        split = 2 if kind in ("trip", "close") else 1
        groups = found.groups()
        buses, values = tuple(map(int, groups[:split])), tuple(map(float, groups[split:]))
        events.append(GridEvent(int(when), kind, buses, values, item))
    return tuple(sorted(events, key=lambda event: event.k))


def apply(event: GridEvent, now: Switched, whole: SwingGrid) -> Switched:
    """The grid after an event.

    Args:
        event: the event.
        now: the grid before it.
        whole: the grid with all its branches.

    Raises:
        PlantError: if a bus or branch does not exist, or a trip leaves a bus without any machine.
    """
    places = [_position(event, bus, whole) for bus in event.buses]
    if event.kind == "load":
        load = now.grid.load.copy()
        load[places[0]] += event.values[0]
        return replace(now, grid=replace(now.grid, load=load))
    if event.kind == "limit":
        return _limited(event, places[0], now)
    ends = {tuple(places), tuple(reversed(places))}
    closed = list(zip(now.grid.branches, now.grid.b, strict=True))
    if event.kind == "trip":
        after = [branch for branch in closed if branch[0] not in ends]
    else:
        after = closed + [branch for branch in zip(whole.branches, whole.b, strict=True) if branch[0] in ends]
    if len(after) == len(closed) or (event.kind == "close" and any(branch[0] in ends for branch in closed)):
        raise PlantError(f"event {event.text!r}: there is no branch {event.buses[0]}-{event.buses[1]} to {event.kind}")
    pairs, b = zip(*after, strict=True) if after else ((), ())
    grid = replace(now.grid, branches=tuple(pairs), b=np.array(b, dtype=np.float64))
    _check_islands(event, grid)
    return replace(now, grid=grid)


def rehearse(events: Sequence[GridEvent], start: Switched) -> None:
    """Applies all events in turn, so that mistakes show before a run and not in the middle of it.

    Raises:
        PlantError: as `apply`.
    """
    now = start
    for event in events:
        now = apply(event, now, start.grid)


def _position(event: GridEvent, bus: int, grid: SwingGrid) -> int:
    if bus not in grid.buses:
        raise PlantError(f"event {event.text!r}: the grid has no bus {bus}")
    return grid.buses.index(bus)


def _limited(event: GridEvent, place: int, now: Switched) -> Switched:
    if place >= now.grid.machines:
        raise PlantError(f"event {event.text!r}: there is no machine at bus {event.buses[0]}")
    if not event.values[0] <= event.values[1]:
        raise PlantError(f"event {event.text!r}: the lower limit exceeds the upper one")
    low, high = now.low.copy(), now.high.copy()
    low[place], high[place] = event.values
    return replace(now, low=low, high=high)


def _check_islands(event: GridEvent, grid: SwingGrid) -> None:
    group = list(range(len(grid.buses)))
    for i, j in grid.branches:
        old, new = group[j], group[i]
        group = [new if member == old else member for member in group]
    alone = [bus for bus, member in zip(grid.buses, group, strict=True) if member not in group[: grid.machines]]
    if alone:
        raise PlantError(f"event {event.text!r} leaves bus {alone[0]} without any machine")
