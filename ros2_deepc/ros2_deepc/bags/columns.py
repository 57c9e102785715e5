# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Growing columns of numbers taken from messages, and their alignment by epoch and sample index."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import BagError
from .outline import Block

Array = NDArray[np.float64]
Keys = NDArray[np.int64]
NO_EPOCH = -1
_K_BITS = 40


class Grown:
    """An array that grows at its end; room is doubled, so that appending costs the same however long it is."""

    def __init__(self, kind: Any) -> None:
        self._room, self._n = np.empty(64, dtype=kind), 0

    def extend(self, values: NDArray[Any]) -> None:
        """Appends values, shape (n,)."""
        end = self._n + len(values)
        if end > len(self._room):
            room = np.empty(max(end, 3 * len(self._room) // 2), dtype=self._room.dtype)
            room[: self._n] = self._room[: self._n]
            self._room = room
        self._room[self._n : end] = values
        self._n = end

    def __len__(self) -> int:
        return self._n

    @property
    def values(self) -> NDArray[Any]:
        """What is there so far: a view, read-only."""
        view = self._room[: self._n]
        view.flags.writeable = False
        return view


class Columns:
    """Numbers of many messages of one kind that have header, epoch and k.

    Args:
        scalars: paths of the scalar fields to keep; a field that a message lacks is NaN.
        vector: path of one vector field to keep, "" = none. Empty vectors become NaN; all others must have one length.
    """

    def __init__(self, scalars: Sequence[str] = (), vector: str = "") -> None:
        self._epoch, self._k, self._stamp = Grown(np.int64), Grown(np.uint64), Grown(np.int64)
        self._scalars: Mapping[str, Grown] = {name: Grown(np.float64) for name in scalars}
        self._vector_name, self._vector, self._width, self._leading = vector, Grown(np.float64), 0, 0

    def __len__(self) -> int:
        return len(self._k)

    def add(self, block: Block) -> None:
        """Appends the messages of a block.

        Raises:
            BagError: if a vector is longer or shorter than those before.
        """
        self._epoch.extend(block.column("epoch", np.int64, 0))
        self._k.extend(block.column("k", np.uint64, 0))
        self._stamp.extend(stamps(block))
        for name, column in self._scalars.items():
            column.extend(block.column(name))
        if self._vector_name:
            self._add_vectors(*block.vectors(self._vector_name), block)

    def _add_vectors(self, values: Array, widths: NDArray[np.intp], block: Block) -> None:
        given = np.flatnonzero(widths)
        if not self._width:
            self._leading += len(widths) if not len(given) else int(given[0])
            if not len(given):
                return
            self._width = int(widths[given[0]])
            values, widths = values[given[0] :], widths[given[0] :]
        wrong = np.flatnonzero((widths != self._width) & (widths != 0))
        if len(wrong):
            k = block.column("k", np.uint64, 0)[len(block) - len(widths) + wrong[0]]
            have = f"{widths[wrong[0]]} {self._vector_name}"
            raise BagError(f"sample k = {k} has {have}, those before have {self._width}")
        padded = values if values.shape[1] == self._width else np.full((len(values), self._width), np.nan)
        self._vector.extend(padded.ravel())

    @property
    def epoch(self) -> NDArray[np.int64]:
        """Epoch of each message, shape (R,)."""
        return self._epoch.values

    @property
    def k(self) -> NDArray[np.uint64]:
        """Sample index of each message, shape (R,)."""
        return self._k.values

    @property
    def stamp(self) -> NDArray[np.int64]:
        """Stamp in the header of each message, shape (R,) [ns]."""
        return self._stamp.values

    def column(self, name: str) -> Array:
        """One scalar field of all messages, shape (R,)."""
        return self._scalars[name].values

    def vectors(self) -> Array:
        """The vector field of all messages, shape (R, width)."""
        rows = self._vector.values.reshape(-1, max(self._width, 1))
        if self._leading:
            rows = np.vstack([np.full((self._leading, rows.shape[1]), np.nan), rows])
        return rows[:, : self._width]

    def keys(self, epochs: Sequence[int]) -> Keys:
        """One ordered number for (epoch, k): epochs rank as given; those not given get NO_EPOCH.

        Raises:
            BagError: if an index k is 2**40 or more, which no sampled plant reaches.
        """
        rank = {epoch: i for i, epoch in enumerate(epochs)}
        k, epoch = self.k, self.epoch
        if k.size and k.max() >= 1 << _K_BITS:
            raise BagError(f"sample index {k.max()} makes no sense")
        ranks = np.full(len(epoch), NO_EPOCH, dtype=np.int64)
        for name, place in rank.items():
            ranks[epoch == name] = place
        return np.where(ranks < 0, NO_EPOCH, (ranks << _K_BITS) + k.astype(np.int64))


def stamps(block: Block) -> NDArray[np.int64]:
    """Stamps in the headers of a block's messages, shape (n,) [ns]."""
    sec, nanosec = (block.column(f"header.stamp.{part}", np.int64, 0) for part in ("sec", "nanosec"))
    return np.asarray(sec * 10**9 + nanosec, dtype=np.int64)


def first_rows(keys: Keys) -> tuple[Keys, NDArray[np.intp]]:
    """Sorted distinct keys (without NO_EPOCH) and the row where each came first."""
    distinct, rows = np.unique(keys, return_index=True)
    known = distinct != NO_EPOCH
    return distinct[known], rows[known]


def pick(values: NDArray[Any], keys: Keys, wanted: Keys, missing: Any = np.nan) -> NDArray[Any]:
    """Rows of ``values`` (which have these keys, the first ones count) for the wanted keys; else ``missing``."""
    if len(keys) == len(wanted) and np.array_equal(keys, wanted) and (np.diff(keys) > 0).all():
        return values
    distinct, rows = first_rows(keys)
    out = np.full((len(wanted), *values.shape[1:]), missing, dtype=values.dtype)
    if len(distinct):
        place = np.minimum(np.searchsorted(distinct, wanted), len(distinct) - 1)
        found = distinct[place] == wanted
        out[found] = values[rows[place[found]]]
    return out
