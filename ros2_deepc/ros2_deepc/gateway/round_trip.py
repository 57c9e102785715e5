# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""How long the way to the field and back takes, and whether it is still what it was when the data were collected.

A delay that is in the data costs a data-driven controller nothing; a change of it by one sample ruins the loop.
"""

import json
import math
import os
from collections import deque
from pathlib import Path
from statistics import median

_KEPT = 64  # newest measurements behind a median
_ENOUGH = 3  # measurements before the median means anything
_REFERENCE = 32  # measurements behind the reference that belongs to the data


class RoundTrip:
    """Measures round trips; compares their median with that of the data.

    A round trip is the time from writing a heartbeat to reading it back from the field's echo; without an echo it is
    the time of one request and its answer.

    Args:
        period: [s], of the samples.
        reference: [s], of the data collected before, or NaN.
    """

    def __init__(self, period: float, reference: float = math.nan) -> None:
        self._period = period
        self.reference = reference
        self._times: deque[float] = deque(maxlen=_KEPT)
        self._sent: dict[int, float] = {}

    @property
    def median(self) -> float:
        """Median of the newest measurements [s]; NaN while there are too few."""
        return median(self._times) if len(self._times) >= _ENOUGH else math.nan

    @property
    def measured(self) -> bool:
        """Whether there are enough measurements."""
        return len(self._times) >= _ENOUGH

    def add(self, seconds: float) -> None:
        """Takes one measurement."""
        self._times.append(seconds)

    def sent(self, beat: int, now: float) -> None:
        """Heartbeat ``beat`` was written at ``now`` [s]."""
        if len(self._sent) > _KEPT:  # the echo has been silent for long
            self._sent.clear()
        self._sent[beat] = now

    def returned(self, beat: float, now: float) -> None:
        """The echo reads ``beat`` at ``now`` [s]; whatever was sent before it is on its way no more."""
        if not math.isfinite(beat) or int(beat) not in self._sent:
            return
        at = self._sent.pop(int(beat))
        self._sent = {other: when for other, when in self._sent.items() if when > at}
        self.add(now - at)

    def learn(self) -> bool:
        """Makes the present median the reference, if there is none and enough was measured; says whether it did."""
        if math.isnan(self.reference) and len(self._times) >= _REFERENCE:
            self.reference = self.median
            return True
        return False

    def forget(self) -> None:
        """New data are about to be collected: their round trip will be the reference."""
        self.reference = math.nan
        self._times.clear()

    def restart(self) -> None:
        """Measures afresh; the reference stays."""
        self._times.clear()
        self._sent.clear()

    def moved(self) -> str:
        """One line, if the median has moved by half a sample or more from the reference; else empty."""
        now = self.median
        if math.isnan(now) or math.isnan(self.reference) or abs(now - self.reference) < 0.5 * self._period:
            return ""
        return (
            f"the round trip is {1e3 * now:.3g} ms, it was {1e3 * self.reference:.3g} ms when the data were collected: "
            "collect new data"
        )


def load(path: Path) -> float:
    """The reference kept in a file [s]; NaN if there is none.

    Raises:
        ValueError: if the file does not hold one.
    """
    try:
        kept = json.loads(path.read_text(encoding="utf-8"))
        seconds = float(kept["round_trip"])
    except FileNotFoundError:
        return math.nan
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path} holds no round trip ({error}); delete it if new data will be collected") from None
    if not (math.isfinite(seconds) and seconds >= 0.0):
        raise ValueError(f"{path}: a round trip of {seconds} s is impossible")
    return seconds


def save(path: Path, seconds: float) -> None:
    """Keeps a reference [s] in a file, whole or not at all."""
    draft = path.with_name(path.name + ".new")
    draft.write_text(json.dumps({"round_trip": seconds}) + "\n", encoding="utf-8")
    os.replace(draft, path)
