# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""How well the loop runs, over its newest samples, with hysteresis: a level is left at a lower value than entered."""

from collections import deque
from dataclasses import dataclass, field

import numpy as np

_WINDOW = 100  # samples
_EVERY = 20  # samples between two judgements


@dataclass(slots=True)
class Band:
    """A quantity that is wrong from ``enter`` on, and right again from ``leave`` down.

    Attributes:
        enter: value at which it becomes wrong.
        leave: value at which it is right again, below ``enter``.
        complaint: what to say.
        wrong: whether it is wrong now.
    """

    enter: float
    leave: float
    complaint: str
    wrong: bool = False

    def judge(self, value: float) -> bool:
        """Takes the newest value."""
        self.wrong = value >= (self.leave if self.wrong else self.enter)
        return self.wrong


def _bands() -> dict[str, Band]:
    return {
        "jitter": Band(0.5, 0.25, "outputs come unevenly"),
        "answer": Band(0.8, 0.5, "answers take most of the period"),
        "missed": Band(0.05, 0.01, "deadlines are missed"),
        "limited": Band(0.9, 0.5, "inputs are at their limits most of the time"),
    }


@dataclass(slots=True)
class Health:
    """Takes every sample, and tells what a person should know.

    Attributes:
        period: of the samples in real time [s]; 0 in lockstep, which knows no lateness.
    """

    period: float
    _taken: int = 0
    _wrong: list[str] = field(default_factory=list)
    _bands: dict[str, Band] = field(default_factory=_bands)
    _gaps: deque[float] = field(default_factory=lambda: deque(maxlen=_WINDOW))
    _answers: deque[float] = field(default_factory=lambda: deque(maxlen=_WINDOW))
    _missed: deque[bool] = field(default_factory=lambda: deque(maxlen=_WINDOW))
    _limited: deque[bool] = field(default_factory=lambda: deque(maxlen=_WINDOW))

    def sample(self, gap: float, answer: float, limited: bool) -> bool:
        """Takes a sample that was answered.

        Args:
            gap: time since the sample before, over the samples between them [s]; NaN if there was none.
            answer: time from its arrival to the command [s].
            limited: whether the limiter acted.

        Returns:
            Whether the answer missed its deadline, one period.
        """
        missed = 0.0 < self.period < answer
        self._taken += 1
        self._answers.append(answer)
        self._missed.append(missed)
        self._limited.append(limited)
        if not np.isnan(gap):
            self._gaps.append(gap)
        return missed

    def overdue(self) -> None:
        """Outputs did not come in time."""
        self._missed.append(True)

    def values(self) -> dict[str, float]:
        """The quantities now: jitter and answer as 95 % quantiles over the period, missed and limited as shares."""
        timed = self.period > 0.0
        return {
            "jitter": _quantile([abs(gap - self.period) / self.period for gap in self._gaps]) if timed else 0.0,
            "answer": _quantile([answer / self.period for answer in self._answers]) if timed else 0.0,
            "missed": float(np.mean(self._missed)) if self._missed else 0.0,
            "limited": float(np.mean(self._limited)) if self._limited else 0.0,
        }

    def complaints(self) -> list[str]:
        """What is wrong; judged anew every 20 samples."""
        if self._taken % _EVERY == 0 and self._taken:
            values = self.values()
            self._wrong = [band.complaint for name, band in self._bands.items() if band.judge(values[name])]
        return self._wrong


def _quantile(values: list[float]) -> float:
    return float(np.quantile(values, 0.95)) if values else 0.0
