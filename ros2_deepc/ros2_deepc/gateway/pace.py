# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""When samples happen, and which number each has."""

import math
from dataclasses import dataclass

_JUMP = 2.0  # samples by which the field's counter may differ from the clock, beside the time that FALLBACK takes


@dataclass(frozen=True, slots=True)
class Step:
    """What a look at the field brought.

    Attributes:
        samples: by how many samples the field has moved on since the last look; 0 = none.
        broken: one line on why the record cannot go on, e.g. a restarted field; empty if it can.
    """

    samples: int
    broken: str = ""


class ScanPace:
    """Samples happen when the field's counter moves.

    Args:
        period: time between two counts [s].
        modulus: the counter starts again from 0 at this count.
        patience: [s] of silence after which a jump of the counter is no surprise any more.
    """

    def __init__(self, period: float, modulus: int, patience: float) -> None:
        self._period, self._modulus = period, modulus
        self._slack = _JUMP + patience / period
        self._count: int | None = None
        self._at = 0.0

    def look(self, count: float, now: float) -> Step:
        """Takes the counter as read at ``now`` [s]."""
        before, elapsed = self._count, now - self._at
        garbage = not (math.isfinite(count) and 0 <= count < self._modulus and count == int(count))
        if garbage or before == count:
            return Step(0)
        self._count, self._at = int(count), now
        if before is None:
            return Step(1)
        moved = (int(count) - before) % self._modulus
        if abs(moved - elapsed / self._period) > self._slack:
            return Step(1, f"the field's counter went from {before} to {int(count)} in {elapsed:.3g} s: restarted?")
        return Step(moved)


class TimerPace:
    """Samples happen on the gateway's own clock.

    Args:
        period: [s].
    """

    def __init__(self, period: float) -> None:
        self._period = period
        self._start: float | None = None
        self._done = 0

    def look(self, now: float) -> Step:
        """Takes a look at ``now`` [s]; a late one is that of the tick that it is nearest to."""
        if self._start is None:
            self._start = now
            return Step(1)
        tick = round((now - self._start) / self._period)
        moved, self._done = tick - self._done, max(tick, self._done)
        return Step(max(moved, 0))

    def wait(self, now: float) -> float:
        """Time until the next tick [s]."""
        if self._start is None:
            return 0.0
        return max(0.0, self._start + (self._done + 1) * self._period - now)
