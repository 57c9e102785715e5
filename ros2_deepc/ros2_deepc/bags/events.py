# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""What happened in a run, in words."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .run import MODES, NO_MODE, Run
from .style import MODE

LISTED = 300
_COUNTERS = {"failures": "optimisation failed", "deadline_misses": "deadline missed", "refused": "samples refused"}
_LASTING = frozenset({"reference", "missing", *_COUNTERS})  # from sample to sample: only the beginning is an event
Event = tuple[int, int, float, str]  # epoch, k, seconds, words


class Events:
    """Modes, epochs, references, failures, missing inputs of a run that comes in stretches, in order.

    What happens at sample after sample (faults, a reference that moves) is one event, where it begins.

    Attributes:
        first: the first 300.
        count: how many there are.
    """

    def __init__(self) -> None:
        self.first: list[Event] = []
        self.count = 0
        self._last: dict[str, Any] = {}  # row of the stretch before
        self._goes_on: dict[str, bool] = {}

    def add(self, run: Run) -> None:
        """Takes the next stretch."""
        counts = {name: np.nan_to_num(run.state[name]) for name in _COUNTERS}
        now: dict[str, NDArray[Any]] = {"mode": run.mode.astype(np.intp), "epoch": run.epoch, "ref": run.ref, **counts}
        start = {"mode": -1, "epoch": run.epoch[0], "ref": np.full(run.ref.shape[1], np.nan)}
        last = self._last or start | dict.fromkeys(counts, 0.0)
        old = {name: np.concatenate([[last[name]], values[:-1]]) for name, values in now.items()}
        self._last = {name: values[-1] for name, values in now.items()}
        happened = {
            "mode": (now["mode"] != old["mode"]) & (run.mode != NO_MODE),
            "epoch": run.epoch != old["epoch"],
            "reference": (run.ref != old["ref"]).any(axis=1) & ~np.isnan(run.ref + old["ref"]).any(axis=1),
            **{name: counts[name] > old[name] for name in counts},
            "missing": np.isnan(run.u).any(axis=1),
        }
        found = [(row, _words(kind, run, row)) for kind, rows in happened.items() for row in self._begun(kind, rows)]
        found.sort(key=lambda event: event[0])
        room = LISTED - len(self.first)
        self.first += [(int(run.epoch[row]), int(run.k[row]), float(run.t[row]), words) for row, words in found[:room]]

    def _begun(self, kind: str, happened: NDArray[np.bool_]) -> list[int]:
        """Rows where something begins, at most 300 of them; all are counted."""
        if kind in _LASTING:
            before = np.concatenate([[self._goes_on.get(kind, False)], happened[:-1]])
            self._goes_on[kind] = bool(happened[-1])
            happened = happened & ~before
        rows: list[int] = np.flatnonzero(happened).tolist()
        self.count += len(rows)
        return rows[:LISTED]


def _words(kind: str, run: Run, row: int) -> str:
    if kind == "mode":
        return f"mode {MODE[MODES[run.mode[row]]].word}"
    if kind == "epoch":
        return f"new epoch {run.epoch[row]}"
    if kind in _COUNTERS:
        return f"{_COUNTERS[kind]}, {run.state[kind][row]:.0f} in all"
    return {"reference": "reference changes", "missing": "input not recorded"}[kind]
