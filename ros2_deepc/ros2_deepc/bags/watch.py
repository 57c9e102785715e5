# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Follows the messages of a topic, block by block, and remembers what went wrong how often, and where first."""

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .columns import stamps
from .messages import Messages
from .outline import Block
from .topic import TopicInfo

SHOWN = 5  # places that are named one by one before the rest is only counted
_NOTES = frozenset({"new epoch", "input held", "controller refused samples", "optimisation failed", "quality not good"})
Rows = NDArray[Any]
_Add = Callable[[str, str, str], None]


class Watch:
    """A topic of which nothing is known but its type: can its messages be decoded?"""

    def __init__(self) -> None:
        self._places: dict[str, list[str]] = {}
        self._counts: dict[str, int] = {}

    def note(self, what: str, rows: Rows, where: Callable[[int], str]) -> None:
        """Counts an event in each of the rows; ``where`` says where a row is."""
        if len(rows):
            self._counts[what] = self._counts.get(what, 0) + len(rows)
            places = self._places.setdefault(what, [])
            places += [where(int(row)) for row in rows[: SHOWN - len(places)]]

    def look(self, block: Block) -> None:
        """Looks at messages."""
        reasons = dict(block.bad)
        self.note("cannot be decoded", np.array(list(reasons), dtype=np.intp), reasons.__getitem__)

    def report(self, name: str, add: _Add) -> None:
        """Hands level, topic and words of all that was remembered to ``add``."""
        for what, places in self._places.items():
            more = self._counts[what] - len(places)
            text = f"{what}: {', '.join(places)}{f' and {more} more' if more else ''}"
            add("note" if what in _NOTES else "error", name, text)


class LogWatch(Watch):
    """The log times of a whole bag."""

    def __init__(self) -> None:
        super().__init__()
        self._last = 0

    def look(self, block: Messages) -> None:  # type: ignore[override]  # of all topics, not decoded
        """Looks at messages."""
        if not len(block):
            return
        times = np.r_[np.uint64(self._last), block.log_time]
        highest = np.maximum.accumulate(times)
        self._last = int(highest[-1])
        back = np.flatnonzero(times[1:] < highest[:-1])
        self.note("goes back", back, lambda row: f"{int(highest[row] - times[row + 1]) * 1e-9:.6g} s")


class SampleWatch(Watch):
    """Outputs or inputs: gaps, repetitions, stamps, values."""

    def __init__(self) -> None:
        super().__init__()
        self._last: _Samples | None = None
        self._period = 0  # [ns], the first one of an epoch

    def look(self, block: Block) -> None:
        """Looks at samples; rows that cannot be decoded count as none."""
        super().look(block)
        new = _Samples.of(block)
        if not len(new.k):
            return
        values, widths = new.values, new.widths
        unknown = ~np.isfinite(values) & (np.arange(values.shape[1]) < widths[:, None])
        self.note("values not finite", np.flatnonzero(unknown.any(axis=1)), new.here)
        self.note("quality not good", np.flatnonzero(new.doubtful), new.here)
        self.note("input held", np.flatnonzero(new.held > 0), new.here)
        all_ = new if self._last is None else self._last.before(new)
        self._compare(all_)
        self._last = all_.tail()

    def _compare(self, all_: "_Samples") -> None:
        """Each sample with the one before."""
        step = np.diff(all_.k.astype(np.int64))
        sizes, same = np.diff(all_.widths) != 0, np.diff(all_.epoch) == 0

        def here(row: int) -> str:
            return all_.here(row + 1)

        self.note("number of values changes", np.flatnonzero(sizes),
                  lambda r: f"{here(r)} from {all_.widths[r]} to {all_.widths[r + 1]}")  # fmt: skip
        self.note("new epoch", np.flatnonzero(~same), here)
        self.note("samples missing", np.flatnonzero(same & (step > 1)), lambda r: f"{step[r] - 1} before {here(r)}")
        self.note("sample repeated", np.flatnonzero(same & (step == 0)),
                  lambda r: f"{here(r)}{'' if all_.equal(r, r + 1) else ' with other values'}")  # fmt: skip
        self.note(
            "sample out of order", np.flatnonzero(same & (step < 0)), lambda r: f"{here(r)} after k = {all_.k[r]}"
        )
        edges = [0, *(np.flatnonzero(~same) + 1).tolist(), len(step)]
        for i, (a, b) in enumerate(pairwise(edges)):
            self._period = 0 if i else self._period
            rows = a + np.flatnonzero(same[a:b] & (step[a:b] == 1))
            self._stamps(rows, np.diff(all_.stamp)[rows], here)

    def _stamps(self, rows: Rows, passed: Rows, here: Callable[[int], str]) -> None:
        """Time [ns] that passed before the samples behind ``rows``, all of one epoch."""
        places = dict(zip(rows.tolist(), passed.tolist(), strict=True))
        self.note("clock goes back or stands", rows[passed <= 0], lambda r: f"{here(r)} by {-places[r] * 1e-9:.6g} s")
        forward = passed > 0
        if not self._period and forward.any():
            self._period = int(passed[forward][0])
        odd = forward & ((passed < 0.5 * self._period) | (passed > 1.5 * self._period))
        usual = f"{self._period * 1e-9:.6g} s"
        self.note("clock jumps", rows[odd], lambda r: f"{here(r)} by {places[r] * 1e-9:.6g} s instead of {usual}")


class StateWatch(Watch):
    """The controller's state: counters that grow."""

    _COUNTERS = (("refused", "controller refused samples"), ("failures", "optimisation failed"))

    def __init__(self) -> None:
        super().__init__()
        self._last = dict.fromkeys((name for name, _ in self._COUNTERS), 0)

    def look(self, block: Block) -> None:
        """Looks at states."""
        super().look(block)
        if not len(block):
            return
        k = block.column("k", np.uint64, 0)
        for name, what in self._COUNTERS:
            counts = np.r_[self._last[name], block.column(name, np.int64, 0)]
            grown = counts[1:] - counts[:-1]
            words = {"refused": lambda r, g=grown: f"{g[r]} before k = {k[r]}"}
            self.note(what, np.flatnonzero(grown > 0), words.get(name, lambda r: f"k = {k[r]}"))
            self._last[name] = int(counts[-1])


def watch_of(topic: TopicInfo) -> Watch:
    """The watch for a topic."""
    if topic.type == "deepc_msgs/msg/Sample" and topic.name.endswith(("/outputs", "/inputs")):
        return SampleWatch()
    return StateWatch() if topic.type == "deepc_msgs/msg/ControllerState" else Watch()


class _Samples:
    """What is compared of samples, one a row."""

    _NAMES = ("epoch", "k", "stamp", "held", "doubtful", "widths")

    def __init__(self, columns: dict[str, NDArray[Any]], values: NDArray[np.float64]) -> None:
        self.epoch, self.k, self.stamp, self.held, self.doubtful, self.widths = (columns[n] for n in self._NAMES)
        self.values = values

    @classmethod
    def of(cls, block: Block) -> "_Samples":
        good = np.ones(len(block), dtype=bool)
        good[[row for row, _ in block.bad]] = False
        values, widths = block.vectors("values")
        quality, _ = block.vectors("quality")
        columns: dict[str, NDArray[Any]] = {
            "epoch": block.column("epoch", np.int64, 0), "k": block.column("k", np.uint64, 0), "stamp": stamps(block),
            "held": block.column("held", np.int64, 0), "widths": widths,
            "doubtful": np.asarray(np.nan_to_num(quality).any(axis=1)),
        }  # fmt: skip
        return cls({name: column[good] for name, column in columns.items()}, values[good])

    def here(self, row: int) -> str:
        return f"epoch {self.epoch[row]} k = {self.k[row]}"

    def equal(self, a: int, b: int) -> bool:
        return np.array_equal(self.values[a], self.values[b], equal_nan=True)

    def tail(self) -> "_Samples":
        """The last sample alone."""
        return _Samples({name: getattr(self, name)[-1:] for name in self._NAMES}, self.values[-1:])

    def before(self, others: "_Samples") -> "_Samples":
        """These and the others behind them."""
        columns = {name: np.concatenate([getattr(self, name), getattr(others, name)]) for name in self._NAMES}
        wide = max(self.values.shape[1], others.values.shape[1])
        parts = [
            np.pad(v, ((0, 0), (0, wide - v.shape[1])), constant_values=np.nan) for v in (self.values, others.values)
        ]
        return _Samples(columns, np.concatenate(parts))
