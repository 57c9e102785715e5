# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Long records cut down to what a picture can show, stretch by stretch."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Rows = NDArray[np.intp]
POINTS = 4000  # more cannot be told apart on a screen
_PARTS = 100  # small arrays that are kept before they become one


class Thin:
    """At most about ``points`` points that draw the same line: smallest and largest value of each bin, in order.

    A bin with a NaN keeps one, too, so that a gap stays a gap; the first and the last point stay. How the rows come, at
    once or in stretches, makes no difference.

    Args:
        total: number of rows to come.
        points: number of points wanted; if there are no more rows than that, all stay.

    Attributes:
        last: last value that is not NaN; NaN if there is none.
    """

    def __init__(self, total: int, points: int = POINTS) -> None:
        self._total, self._size = total, 1 if total <= points else -(-total // (points // 2))
        self._binned = total // self._size * self._size  # rows behind that are too few for a bin and all stay
        self._done: list[tuple[Array, Array]] = []
        self._open: tuple[Rows, Array, Array] = (np.empty(0, dtype=np.intp), np.empty(0), np.empty(0))  # the last bin
        self._seen = 0
        self.last = np.nan

    def add(self, x: Array, y: Array) -> None:
        """Takes the next rows, x and y of shape (n,)."""
        if not len(x):
            return
        known = np.flatnonzero(~np.isnan(y))
        self.last = float(y[known[-1]]) if len(known) else self.last
        new = np.arange(self._seen, self._seen + len(x))
        self._seen += len(x)
        row, x, y = (np.concatenate(pair) for pair in zip(self._open, (new, x, y), strict=True))
        bins = np.where(row < self._binned, row // self._size, row)
        starts = np.flatnonzero(np.diff(bins, prepend=-1))
        keep = np.zeros(len(row), dtype=bool)
        keep[_extremes(y, starts)] = True
        keep |= (row == 0) | (row == self._total - 1)
        last = np.arange(len(row)) >= starts[-1]
        self._done.append((x[keep & ~last], y[keep & ~last]))
        if len(self._done) > _PARTS:
            x_done, y_done = zip(*self._done, strict=True)
            self._done = [(np.concatenate(x_done), np.concatenate(y_done))]
        self._open = row[keep & last], x[keep & last], y[keep & last]

    def points(self) -> tuple[Array, Array]:
        """What is left of the rows so far: x and y."""
        x, y = zip(*self._done, self._open[1:], strict=True)
        return np.concatenate(x), np.concatenate(y)


def _extremes(y: Array, starts: Rows) -> Rows:
    """Rows of the smallest, the largest and a NaN value of each group; the first ones of several."""
    hole = np.isnan(y)
    found = []
    for values in (np.where(hole, np.inf, y), np.where(hole, np.inf, -y), np.where(hole, 0.0, 1.0)):
        lowest = np.repeat(np.minimum.reduceat(values, starts), np.diff(starts, append=len(y)))
        found.append(np.minimum.reduceat(np.where(values == lowest, np.arange(len(y)), len(y)), starts))
    with_hole = hole[found[2]]
    return np.concatenate([found[0], found[1], found[2][with_hole]])


def thin(x: Array, y: Array, points: int = POINTS) -> tuple[Array, Array]:
    """``Thin`` for a line that is there as a whole."""
    line = Thin(len(x), points)
    line.add(x, y)
    return line.points()


class Strip:
    """Runs of equal values; where they are more than can be shown, the worst value of each of some 2000 bins.

    Args:
        total: number of rows to come.
        worst: the values, best ones first.
        most: runs that are kept one by one.
    """

    def __init__(self, total: int, worst: Sequence[int], most: int = POINTS) -> None:
        self._rank = np.zeros(256, dtype=np.intp)
        self._rank[list(worst)] = np.arange(len(worst))
        self._worst, self._most, self._size = worst, most, max(-(-total // (most // 2)), 1)
        self._bins = np.full(-(-total // self._size), -1, dtype=np.intp)
        self._at = np.full(len(self._bins), np.nan)
        self._runs: list[tuple[float, int, Any]] = []  # start, value, tag
        self._count = self._seen = 0
        self._value: int | None = None

    def add(self, x: Array, values: NDArray[Any], tags: Sequence[Any] | NDArray[Any] | None = None) -> None:
        """Takes the next rows: positions, values, and what is remembered of the last row of each run."""
        if not len(x):
            return
        changes = np.flatnonzero(np.diff(values.astype(np.intp), prepend=-1 if self._value is None else self._value))
        bins = np.arange(self._seen, self._seen + len(x)) // self._size
        np.maximum.at(self._bins, bins, self._rank[values])
        firsts, rows = np.unique(bins, return_index=True)
        self._at[firsts] = np.where(np.isnan(self._at[firsts]), x[rows], self._at[firsts])
        self._seen, self._value, self._count = self._seen + len(x), int(values[-1]), self._count + len(changes)
        if self._count > self._most:
            self._runs = []
            return
        if tags is not None and self._runs:
            self._runs[-1] = (*self._runs[-1][:2], tags[changes[0] - 1 if len(changes) else -1])
        for a, b in zip(changes.tolist(), [*changes.tolist(), len(x)][1:], strict=True):
            self._runs.append((float(x[a]), int(values[a]), None if tags is None else tags[b - 1]))

    def runs(self, end: float) -> list[tuple[float, float, int, Any]]:
        """Start, end, value and tag of each run; the last one ends at ``end``."""
        runs = self._runs
        if self._count > self._most:
            edges = np.flatnonzero(np.diff(self._bins, prepend=-1))
            runs = [(float(self._at[i]), self._worst[self._bins[i]], None) for i in edges]
        ends = [*(start for start, *_ in runs), end][1:]
        return [(start, stop, value, tag) for (start, value, tag), stop in zip(runs, ends, strict=True)]
