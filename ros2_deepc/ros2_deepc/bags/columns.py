# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Growing columns of numbers taken from messages, and their alignment by epoch and sample index."""

from array import array
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import BagError

Array = NDArray[np.float64]
Keys = NDArray[np.int64]
NO_EPOCH = -1
_K_BITS = 40


class Columns:
    """Numbers of many messages of one kind, eight bytes each.

    Args:
        scalars: names of the scalar fields to keep; a field that a message lacks is NaN.
        vector: name of one vector field to keep, "" = none. Empty vectors become NaN; all others must have one length.
    """

    def __init__(self, scalars: Sequence[str] = (), vector: str = "") -> None:
        self.epoch, self.k, self.stamp = array("q"), array("Q"), array("q")  # stamp in ns
        self.scalars: Mapping[str, array[float]] = {name: array("d") for name in scalars}
        self._vector_name, self._vector, self._width, self._leading = vector, array("d"), 0, 0

    def __len__(self) -> int:
        return len(self.k)

    def add(self, message: Any) -> None:
        """Appends one decoded message that has header, epoch and k.

        Raises:
            BagError: if its vector is longer or shorter than those before.
        """
        self.epoch.append(message.epoch)
        self.k.append(message.k)
        self.stamp.append(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)
        for name, column in self.scalars.items():
            column.append(getattr(message, name, np.nan))
        if self._vector_name:
            self._add_vector(getattr(message, self._vector_name, ()), message.k)

    def _add_vector(self, values: Any, k: int) -> None:
        if len(values):
            self._width = self._width or len(values)
            if len(values) != self._width:
                raise BagError(f"sample k = {k} has {len(values)} {self._vector_name}, those before have {self._width}")
            self._vector.frombytes(np.asarray(values, np.float64).tobytes())
        elif self._width:
            self._vector.extend([np.nan] * self._width)
        else:
            self._leading += 1

    def column(self, name: str) -> Array:
        """One scalar field of all messages, shape (R,); a view, read-only: no message can be added after it."""
        return _view(self.scalars[name], np.float64)

    def vectors(self) -> Array:
        """The vector field of all messages, shape (R, width)."""
        rows = _view(self._vector, np.float64).reshape(-1, max(self._width, 1))
        if self._leading:
            rows = np.vstack([np.full((self._leading, rows.shape[1]), np.nan), rows])
        return rows[:, : self._width]

    def keys(self, epochs: Sequence[int]) -> Keys:
        """One ordered number for (epoch, k): epochs rank as given; those not given get NO_EPOCH.

        Raises:
            BagError: if an index k is 2**40 or more, which no sampled plant reaches.
        """
        rank = {epoch: i for i, epoch in enumerate(epochs)}
        k = _view(self.k, np.uint64)
        if k.size and k.max() >= 1 << _K_BITS:
            raise BagError(f"sample index {k.max()} makes no sense")
        epoch = _view(self.epoch, np.int64)
        ranks = np.full(len(epoch), NO_EPOCH, dtype=np.int64)
        for name, place in rank.items():
            ranks[epoch == name] = place
        return np.where(ranks < 0, NO_EPOCH, (ranks << _K_BITS) + k.astype(np.int64))


def _view(column: "array[Any]", kind: type[np.generic]) -> NDArray[Any]:
    """A column without copying it."""
    view = np.frombuffer(column, dtype=kind) if len(column) else np.empty(0, kind)
    view.flags.writeable = False
    return view


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
