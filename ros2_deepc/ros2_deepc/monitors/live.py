# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The monitors on a running plant: pairs inputs and outputs by index and analyses the newest stretch now and then."""

import time
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .analysis import analyze_records
from .increments import Form, increments, require_level
from .indicator import Indicator
from .noise import Noise, as_noise
from .stream import Stream
from .verdict import Finding, Prior, Report, Verdict

Array = NDArray[np.float64]
Pair = tuple[Array, Array]

_PATIENCE = 20  # outputs that may wait for a late input before it counts as lost
CHEAP = 110  # rows of the indicator's window up to which it follows the reports to longer windows
ENTER = 3.0  # [dB] margin from which a property counts as proved; it is kept down to 0 dB
PROPERTIES = ("r_controllability", "c_controllability", "r_observability", "c_observability")


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


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveSettings:
    """What may change while a run goes on.

    Attributes:
        window: outputs kept, at least 1.
        period: outputs between two reports, at least 1.
        noise: as in `analyze`.
        L: block rows of the tests, None = chosen by the analysis.
        enter: margin from which a property counts as proved [dB]; it is kept down to 0 dB.
    """

    window: int
    period: int
    noise: Noise | ArrayLike | None = 0.0
    L: int | None = None
    enter: float = ENTER


@dataclass(frozen=True, slots=True)
class Job:
    """An analysis that is due: everything it needs, so that another thread may do it.

    Attributes:
        k: index of the newest outputs.
        records: unbroken records, pairs (u, y).
        settings: in force at k.
    """

    k: int
    records: list[Pair]
    settings: LiveSettings


class LiveMonitor:
    """The window of one run (one epoch) and its reports.

    Inputs and outputs come in two streams; outputs k are used once the inputs that they depend on are there. A gap in
    either stream starts a new record; records stand side by side, so that a gap costs columns and no more.

    Args:
        prior: what is known of the plant.
        form: whether the values themselves are analysed, or their changes; see `increments`.
        lockstep: inputs come in order and none is lost: outputs wait until theirs are there, or later ones.
        settings: window, period, noise, L, enter; see `LiveSettings`.

    Raises:
        ValueError: if the noise on changes is to be estimated.
    """

    def __init__(self, prior: Prior, *, form: Form = "absolute", lockstep: bool = False, **settings: Any) -> None:
        self.prior, self.form, self._lockstep = prior, form, lockstep
        self.settings = self._checked(LiveSettings(**settings))
        self._changes: deque[tuple[int, LiveSettings]] = deque()
        self._commands: dict[int, Array] = {}
        self._latest = -1  # the input that came last
        self._inputs: dict[int, Array] = {}  # those that did act, by the plant's own word: a late command acts later
        self._waiting: deque[tuple[int, Array, int]] = deque()
        self._outputs: deque[tuple[int, Array]] = deque(maxlen=self.settings.window)
        self._starts: set[int] = set()  # outputs with which a record begins
        self._next = 0  # outputs expected next
        self.newest = -1
        """Index of the newest outputs that came; older ones, or the same again, are not taken."""
        self._last_L = 0  # block rows of the last report
        self._stream: Stream | None = None  # from the first indicator on
        self._proved: dict[str, int] = {}  # newest k at which each property was proved
        self._standing: set[str] = set()  # properties proved by the last report

    def input(self, k: int, u: ArrayLike) -> list[Job]:
        """Takes the input commanded for k, shape (m,); returns the analyses that are due."""
        self._commands[k] = np.array(u, dtype=np.float64)
        self._latest = k
        return self._drain()

    def output(self, k: int, y: ArrayLike, held: int = 0) -> list[Job]:
        """Takes outputs k, shape (p,), unless they are not newer than `newest`; returns the analyses that are due.

        Args:
            k: index of the outputs.
            y: outputs.
            held: the plant used the input commanded ``held`` samples earlier for the newest one that y(k) depends on.
        """
        if k <= self.newest:
            return []
        self.newest = k
        self._waiting.append((k, np.array(y, dtype=np.float64), held))
        return self._drain()

    def change(self, k: int, **settings: Any) -> None:
        """Takes other settings, in force from outputs k on; the window goes on, as far as its new length allows.

        Raises:
            ValueError: if the noise on changes is to be estimated.
        """
        latest = self._changes[-1][1] if self._changes else self.settings
        self._changes.append((k, self._checked(replace(latest, **settings))))

    def analyse(self, job: Job) -> LiveReport:
        """Does an analysis; may run in another thread than the rest."""
        started = time.thread_time()
        records, noise = job.records, as_noise(job.settings.noise)
        if self.form == "incremental":
            records, noise = increments(records, noise)
        report = analyze_records(records, prior=self.prior, L=job.settings.L, noise=noise)
        samples = sum(len(y) for _, y in job.records)
        settled = self._settle(job.k, report, job.settings.enter)
        return LiveReport(job.k, settled, samples, time.thread_time() - started)

    def indicator(self) -> Indicator | None:
        """Margins at the modes that the window shows, at the block rows of the last report or as many as are cheap.

        None before the first report. Measured with every sample: the window is followed, not factored anew.
        """
        if not self._last_L or not self._outputs:
            return None
        k, y = self._outputs[-1]
        m, p = self._inputs[k].size, y.size
        L = min(self._last_L, max(self.prior.q, -(-self.prior.q // p), CHEAP // (m + p)))
        window = self.settings.window
        if self._stream is None or (self._stream.L, self._stream.window) != (L, window):
            self._stream = Stream(m, p, self.prior, L, window, self.form)
            self._stream.refill(self.records())
        return self._stream.indicate(as_noise(self.settings.noise))

    def records(self) -> list[Pair]:
        """The window: unbroken records, inputs (K+s-1, m) and outputs (K, p) that start at the same k."""
        pieces: list[list[tuple[int, Array]]] = []
        for k, y in self._outputs:
            if not pieces or k in self._starts:
                pieces.append([])
            pieces[-1].append((k, y))
        ahead = self.prior.s - 1
        return [
            (np.array([self._inputs[k] for k in range(piece[0][0], piece[-1][0] + 1 + ahead)]),
             np.array([y for _, y in piece]))
            for piece in pieces
        ]  # fmt: skip

    def _checked(self, settings: LiveSettings) -> LiveSettings:
        if self.form == "incremental":
            require_level(as_noise(settings.noise))
        return settings

    def _drain(self) -> list[Job]:
        due = []
        while self._waiting:
            k, y, held = self._waiting[0]
            newest = k + self.prior.s - 1
            acted = self._commands.get(newest - held)
            to_come = self._lockstep and self._latest < newest - held
            if acted is None and (to_come or len(self._waiting) <= _PATIENCE):
                break
            self._waiting.popleft()
            if acted is not None:
                self._inputs[newest] = acted
            if k == 0 and held == 0:  # nothing earlier could be held
                self._inputs |= {j: self._commands[j] for j in range(newest) if j in self._commands}
            while self._changes and self._changes[0][0] <= k:
                self.settings = self._changes.popleft()[1]
                self._outputs = deque(self._outputs, maxlen=self.settings.window)
            self._take(k, y)
            if (k + 1) % self.settings.period == 0 and self._outputs:
                due.append(Job(k, self.records(), self.settings))
        return due

    def _take(self, k: int, y: Array) -> None:
        """Adds outputs k to the window; they begin a record if anything before them is missing."""
        whole = all(j in self._inputs for j in range(k, k + self.prior.s))
        if k != self._next or not whole:
            self._starts.add(k if whole else k + 1)
            if self._stream is not None:
                self._stream.cut()
        self._next = k + 1
        if whole:
            self._outputs.append((k, y))
            if self._stream is not None:
                self._stream.push(self._inputs[k + self.prior.s - 1], y)
        oldest = self._outputs[0][0] if self._outputs else k
        _forget(self._inputs, oldest)
        _forget(self._commands, oldest)
        self._starts = {start for start in self._starts if start >= oldest}

    def _settle(self, k: int, report: Report, enter: float) -> Report:
        """Hysteresis, and how old the last proof is where there is none now."""
        self._last_L = report.L
        changes: dict[str, Finding] = {}
        for name in PROPERTIES:
            finding: Finding = getattr(report, name)
            if finding.verdict is Verdict.PROVED and (name in self._standing or not finding.margin < enter):
                self._proved[name] = k
                continue
            if finding.verdict is Verdict.PROVED:
                reason = f"the margin of {finding.margin:.1f} dB is positive; it counts as proved from {enter:g} dB on"
                changes[name] = replace(finding, verdict=Verdict.UNDECIDED, reason=reason)
            if finding.verdict in (Verdict.UNDECIDED, Verdict.PROVED) and name in self._proved:
                now = changes.get(name, finding)
                ago = f"{now.reason}; last proved at k = {self._proved[name]}, {k - self._proved[name]} samples ago"
                changes[name] = replace(now, reason=ago)
        report = replace(report, **changes) if changes else report  # type: ignore[arg-type]
        self._standing = {name for name in PROPERTIES if getattr(report, name).verdict is Verdict.PROVED}
        return report


def _forget(inputs: dict[int, Array], oldest: int) -> None:
    """Drops the inputs before the window; they are in order but for late ones."""
    for k in list(_head(inputs, oldest)):
        del inputs[k]


def _head(inputs: dict[int, Array], oldest: int) -> Iterable[int]:
    for k in inputs:
        if k >= oldest:
            return
        yield k
