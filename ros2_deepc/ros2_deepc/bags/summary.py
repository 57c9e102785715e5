# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The numbers of a run that fit on one line each."""

import hashlib
from typing import Any

import numpy as np

from .quantiles import Quantiles
from .recording import Recording
from .run import MODES, PROPERTIES, VERDICTS, Array, Run, loop_bytes

TAIL = 20  # samples at the end of a phase that its RMSE is taken over
PHASES = 1000  # stretches with one reference that are listed; a reference that never rests has no end of them


def summarize(run: Run | Recording, *, seed: int | None = None) -> dict[str, Any]:
    """Sums a run up, ready for JSON.

    Args:
        run: the run.
        seed: of the run; default: the one in the bag's metadata, else None.

    Returns:
        Keys: plant, seed, steps; outputs.<name>.rmse (over the last 20 samples of each stretch with one reference,
        after collecting; of the first 1000 of them), outputs.<name>.peak_to_peak (after collecting); verdicts.<name>
        (at the end); controller.failures, controller.solve_time_ms.median and .p99; loop_hash. What does not exist is
        None.
    """
    summary = Summary()
    for stretch in run.stretches():
        summary.add(stretch)
    return summary.result(seed=seed)


class Summary:
    """Sums a run up that comes in stretches, in order; memory does not grow with its length.

    Attributes:
        solve_time: of all optimisations [s].
    """

    def __init__(self) -> None:
        self.solve_time = Quantiles()
        self._hash, self._phases = hashlib.sha256(), _Phases()
        self._low: Array | None = None
        self._high: Array | None = None
        self._failures, self._verdicts = np.nan, np.empty(0, dtype=np.uint8)
        self._run: Run | None = None

    def add(self, run: Run) -> None:
        """Takes the next stretch."""
        self._run = run
        self._hash.update(loop_bytes(run.u, run.y))
        self._phases.add(run)
        self.solve_time.add(run.solve_time)
        self._failures = float(np.fmax(self._failures, np.fmax.reduce(run.state["failures"])))
        self._verdicts = run.reports.verdict[-1] if len(run.reports.k) else self._verdicts
        controlled = run.y[run.mode != MODES.index("COLLECTING")]
        if len(controlled):
            low, high = controlled.min(axis=0), controlled.max(axis=0)
            self._low = low if self._low is None else np.minimum(self._low, low)
            self._high = high if self._high is None else np.maximum(self._high, high)

    def result(self, *, seed: int | None = None) -> dict[str, Any]:
        """What ``summarize`` returns, of the stretches so far; there must have been one."""
        run = self._run
        assert run is not None
        if seed is None and run.metadata.get("seed", "").lstrip("-").isdigit():
            seed = int(run.metadata["seed"])
        phases = self._phases.rmse()
        spans = None if self._low is None or self._high is None else self._high - self._low
        return {
            "plant": run.plant,
            "seed": seed,
            "steps": run.total,
            "outputs": {
                name: {
                    "rmse": [_number(rmse[i]) for rmse in phases],
                    "peak_to_peak": None if spans is None else _number(spans[i]),
                }
                for i, name in enumerate(run.output_names)
            },
            "verdicts": {
                name: VERDICTS[self._verdicts[j]] if len(self._verdicts) else None for j, name in enumerate(PROPERTIES)
            },
            "controller": {
                "failures": int(self._failures) if np.isfinite(self._failures) else None,
                "solve_time_ms": {
                    name: _number(1e3 * self.solve_time(q)) for name, q in (("median", 0.5), ("p99", 0.99))
                },
            },
            "loop_hash": self._hash.hexdigest(),
        }


class _Phases:
    """Stretches with one reference: the errors at their ends. Samples while collecting do not count."""

    def __init__(self) -> None:
        self._found: list[Array] = []
        self._reference: Array | None = None
        self._tail: list[Array] = []  # errors at the end of the phase that goes on

    def add(self, run: Run) -> None:
        rows = np.flatnonzero(~np.isnan(run.ref).any(axis=1) & (run.mode != MODES.index("COLLECTING")))
        if not len(rows) or len(self._found) == PHASES:
            return
        ref, error = run.ref[rows], run.y[rows] - run.ref[rows]
        before = ref[:1] if self._reference is None else self._reference[None]
        changes = np.flatnonzero((np.diff(ref, axis=0, prepend=before) != 0).any(axis=1))
        goes_on, *phases = np.split(error, changes)
        self._tail = [*self._tail, *goes_on[-TAIL:]][-TAIL:]
        for phase in phases:
            self._found = self.rmse()
            self._tail = [*phase[-TAIL:]]
        self._reference = ref[-1]

    def rmse(self) -> list[Array]:
        """Of each phase so far, shape (p,)."""
        errors = np.ascontiguousarray(
            np.transpose(self._tail)
        )  # each channel is summed up alike, however many there are
        last = [np.sqrt(np.mean(errors**2, axis=1))] if self._tail else []
        return [*self._found, *last][:PHASES]


def _number(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None
