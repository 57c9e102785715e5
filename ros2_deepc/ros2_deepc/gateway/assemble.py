# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""From what the field said to one vector of one sampling instant."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from .tags import Array, TagMap


class Quality(IntEnum):
    """How far a value may be trusted; the numbers are those of deepc_msgs/Sample."""

    GOOD = 0
    UNCERTAIN = 1
    STALE = 2
    BAD = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Scan:
    """Everything that is read from the field, once; entries in the order of ``TagMap.reads``.

    Attributes:
        raw: shape (n,), raw numbers.
        quality: shape (n,), what the protocol says of each.
        source_ns: shape (n,), source time [ns since 1970]; 0 = the protocol has none.
    """

    raw: Array
    quality: NDArray[np.uint8]
    source_ns: NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Vector:
    """The outputs at one sampling instant.

    Attributes:
        values: shape (p,), in output units.
        quality: shape (p,).
        stamp_ns: oldest source time in the vector, or the time of arrival where there is none [ns since 1970].
        age: [s] since the news of each entry, shape (p,).
        reason: one line on the worst entry; empty if all are GOOD.
    """

    values: Array
    quality: NDArray[np.uint8]
    stamp_ns: int
    age: Array
    reason: str

    @property
    def good(self) -> bool:
        """Whether every entry is GOOD."""
        return not self.quality.any()


class Assembler:
    """Turns scans into vectors; knows for how long each tag has been without news.

    Staleness is counted on the gateway's own clock, from the moment at which a source time was last seen to advance:
    a field whose clock is wrong is still supervised.

    Args:
        tags: the map.
    """

    def __init__(self, tags: TagMap) -> None:
        outputs = tags.outputs
        self._p = len(outputs)
        self._names = [tag.name for tag in outputs]
        self._units = [tag.unit for tag in outputs]
        self._scale, self._offset, self._low, self._high, self._stale, self._frozen = (
            np.array([getattr(tag, name) for tag in outputs], dtype=np.float64)
            for name in ("scale", "offset", "low", "high", "stale_after", "frozen_after")
        )
        self._tolerance_ns = round(tags.supervision.clock_tolerance * 1e9)
        self._source = np.zeros(self._p, dtype=np.int64)
        self._raw = np.full(self._p, np.nan)
        self._news: Array | None = None
        self._change = np.zeros(self._p)
        self.clock_error = 0.0

    def take(self, scan: Scan, now: float, wall_ns: int) -> Vector:
        """The outputs in a scan.

        Args:
            scan: from the link, just now.
            now: own monotonic clock [s].
            wall_ns: own wall clock [ns since 1970].
        """
        p = self._p
        raw, source = scan.raw[:p], scan.source_ns[:p]
        age = self._age(raw, source, now)
        with np.errstate(over="ignore", invalid="ignore"):
            values = raw * self._scale + self._offset
        quality = np.minimum(scan.quality[:p], Quality.BAD).astype(np.uint8)
        self._worsen(quality, now - self._change > self._frozen, Quality.UNCERTAIN)
        self._worsen(quality, age > self._stale, Quality.STALE)
        wrong = ~np.isfinite(values) | (values < self._low) | (values > self._high)
        self._worsen(quality, wrong, Quality.BAD)
        reason = self._reason(values, quality) if quality.any() else ""
        stamp = self._stamp(source, wall_ns)
        return Vector(values=values, quality=quality, stamp_ns=stamp, age=age, reason=reason)

    def _age(self, raw: Array, source: NDArray[np.int64], now: float) -> Array:
        if self._news is None:
            self._news, self._change = np.full(self._p, now), np.full(self._p, now)
        changed = ~((raw == self._raw) | (np.isnan(raw) & np.isnan(self._raw)))
        self._news = np.where((source == 0) | (source != self._source), now, self._news)
        self._change = np.where(changed, now, self._change)
        self._source, self._raw = source.copy(), raw.copy()
        age: Array = now - self._news
        return age

    def _stamp(self, source: NDArray[np.int64], wall_ns: int) -> int:
        known = source[source != 0]
        if not known.size:
            self.clock_error = 0.0
            return wall_ns
        oldest = int(known.min())
        newest = int(known.max())
        self.clock_error = (newest - wall_ns) / 1e9
        return oldest if abs(newest - wall_ns) <= self._tolerance_ns else wall_ns

    @staticmethod
    def _worsen(quality: NDArray[np.uint8], where: NDArray[np.bool_], to: Quality) -> None:
        quality[where] = np.maximum(quality[where], to)

    def _reason(self, values: Array, quality: NDArray[np.uint8]) -> str:
        """The worst entry, in words that stay the same while it does."""
        i = int(np.argmax(quality))
        name, what = self._names[i], Quality(int(quality[i])).name
        more = int(np.count_nonzero(quality)) - 1
        others = f" and {more} more" if more else ""
        if quality[i] == Quality.STALE:
            why = f": no news for {self._stale[i]:g} s"
        elif not np.isfinite(values[i]):
            why = ": not a number"
        elif not self._low[i] <= values[i] <= self._high[i]:
            why = f": outside {self._low[i]:g} to {self._high[i]:g} {self._units[i]}"
        else:
            why = ""
        return f"{name} is {what}{why}{others}"
