# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""What happened in a run, in words."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .run import MODES, NO_MODE, Run
from .style import MODE

LISTED = 300
_COUNTERS = {"failures": "optimisation failed", "deadline_misses": "deadline missed", "refused": "samples refused"}
_MOST = {"reference": 200, "missing": 50, **dict.fromkeys(_COUNTERS, 50)}  # of what may happen at every sample
Event = tuple[int, int, float, str]  # epoch, k, seconds, words


class Events:
    """Modes, epochs, references, failures, missing inputs of a run that comes in stretches, in order.

    Attributes:
        first: the first 300.
        count: how many there are; of each kind of fault the first 50 count, of changes of the reference 200.
    """

    def __init__(self) -> None:
        self.first: list[Event] = []
        self.count = 0
        self._counts: dict[str, int] = {}
        self._last: dict[str, Any] = {}  # row of the stretch before

    def add(self, run: Run) -> None:
        """Takes the next stretch."""
        counts = {name: np.nan_to_num(run.state[name]) for name in _COUNTERS}
        now: dict[str, NDArray[Any]] = {"mode": run.mode.astype(np.intp), "epoch": run.epoch, "ref": run.ref, **counts}
        start = {"mode": -1, "epoch": run.epoch[0], "ref": np.full(run.ref.shape[1], np.nan)}
        last = self._last or start | dict.fromkeys(counts, 0.0)
        old = {name: np.concatenate([[last[name]], values[:-1]]) for name, values in now.items()}
        self._last = {name: values[-1] for name, values in now.items()}
        moved = (run.ref != old["ref"]).any(axis=1) & ~np.isnan(run.ref + old["ref"]).any(axis=1)
        missing = np.isnan(run.u).any(axis=1)

        found: list[tuple[int, str]] = []
        found += self._some("mode", (now["mode"] != old["mode"]) & (run.mode != NO_MODE),
                            lambda row: f"mode {MODE[MODES[run.mode[row]]].word}")  # fmt: skip
        found += self._some("epoch", run.epoch != old["epoch"], lambda row: f"new epoch {run.epoch[row]}")
        found += self._some("reference", moved, lambda _: "reference changes")
        for name, words in _COUNTERS.items():
            found += self._some(name, counts[name] > old[name],
                                lambda row, n=name, w=words: f"{w}, {counts[n][row]:.0f} in all")  # type: ignore[misc]  # fmt: skip
        found += self._some("missing", missing, lambda _: "input not recorded")
        found.sort(key=lambda event: event[0])
        room = LISTED - len(self.first)
        self.first += [(int(run.epoch[row]), int(run.k[row]), float(run.t[row]), words) for row, words in found[:room]]

    def _some(self, kind: str, happened: NDArray[np.bool_], words: Callable[[int], str]) -> list[tuple[int, str]]:
        """Rows and words of one kind, as many as count."""
        rows = np.flatnonzero(happened)
        known = self._counts.get(kind, 0)
        rows = rows[: _MOST[kind] - known] if kind in _MOST else rows
        self._counts[kind] = known + len(rows)
        self.count += len(rows)
        return [(row, words(row)) for row in rows[:LISTED].tolist()]
