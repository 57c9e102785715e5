# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The monitors on a running plant: pairs inputs and outputs by index and analyses the newest stretch now and then."""

import time
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .analysis import analyze
from .verdict import Prior, Report

Array = NDArray[np.float64]

_PATIENCE = 20  # outputs that may wait for a late input before it counts as lost


@dataclass(frozen=True, slots=True)
class LiveReport:
    """A report and when it was made.

    Attributes:
        k: index of the newest outputs used.
        report: the analysis.
        samples: outputs in the window.
        compute_time: processor time of the analysis [s].
    """

    k: int
    report: Report
    samples: int
    compute_time: float


class LiveMonitor:
    """The window of one run (one epoch) and its reports.

    Inputs and outputs come in two streams; outputs k are used once the inputs that they depend on are there.

    Args:
        prior: what is known of the plant.
        window: outputs kept, at least 1.
        period: outputs between two reports, at least 1.
        noise: as in `analyze`.
        L: block rows of the tests, None = chosen by the analysis.
    """

    def __init__(self, prior: Prior, *, window: int, period: int, noise: float = 0.0, L: int | None = None) -> None:
        self.prior, self.window, self.period, self.noise, self.L = prior, window, period, noise, L
        self._inputs: dict[int, Array] = {}
        self._waiting: deque[tuple[int, Array, int]] = deque()
        self._outputs: deque[Array] = deque(maxlen=window)
        self._next = 0  # outputs expected next

    def input(self, k: int, u: ArrayLike) -> list[LiveReport]:
        """Takes the input commanded for k, shape (m,); returns the reports that it completes."""
        self._inputs[k] = np.array(u, dtype=np.float64)
        return self._drain()

    def output(self, k: int, y: ArrayLike, held: int = 0) -> list[LiveReport]:
        """Takes outputs k, shape (p,); returns the reports that they complete.

        Args:
            k: index of the outputs.
            y: outputs.
            held: the plant used the input commanded ``held`` samples earlier for the newest one that y(k) depends on.
        """
        self._waiting.append((k, np.array(y, dtype=np.float64), held))
        return self._drain()

    def record(self) -> tuple[Array, Array] | None:
        """The window: inputs (K+s-1, m) and outputs (K, p) that start at the same k; None while it is empty."""
        K = len(self._outputs)
        if K == 0:
            return None
        first = self._next - K
        u = np.array([self._inputs[k] for k in range(first, self._next + self.prior.s - 1)])
        return u, np.array(self._outputs)

    def _drain(self) -> list[LiveReport]:
        reports = []
        while self._waiting:
            k, y, held = self._waiting[0]
            newest = k + self.prior.s - 1
            applied = self._inputs.get(newest - held)
            if applied is None and len(self._waiting) <= _PATIENCE:
                break
            self._waiting.popleft()
            self._take(k, y, newest, applied)
            if (k + 1) % self.period == 0:
                reports += self._report(k)
        return reports

    def _take(self, k: int, y: Array, newest: int, applied: Array | None) -> None:
        """Adds outputs k to the record; a gap in either stream starts a new one."""
        whole = all(j in self._inputs for j in range(k, newest))
        if k != self._next or applied is None or not whole:
            self._outputs.clear()
        self._next = k + 1
        if applied is not None and whole:
            self._inputs[newest] = applied
            self._outputs.append(y)
        for old in [j for j in self._inputs if j < self._next - self.window]:
            del self._inputs[old]

    def _report(self, k: int) -> list[LiveReport]:
        record = self.record()
        if record is None:
            return []
        started = time.process_time()
        report = analyze(*record, prior=self.prior, L=self.L, noise=self.noise)
        return [LiveReport(k, report, len(record[1]), time.process_time() - started)]
