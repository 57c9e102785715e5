# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The newest samples of a running plant, in unbroken records."""

from itertools import pairwise
from math import isfinite
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .hankel import Array, hankel


class Record(NamedTuple):
    """One unbroken stretch of samples.

    Attributes:
        u: inputs, shape (n, m).
        y: outputs, shape (n, p), y[i] of the same instant as u[i].
    """

    u: Array
    y: Array


class DataWindow:
    """The last ``capacity`` samples (u(k), y(k)), kept as one or more unbroken records.

    A gap, a clock jump or a restart starts a new record (`cut`): no column of a Hankel matrix may span two.
    Columns of several records stand side by side (a mosaic-Hankel matrix): a gap costs a few columns, not the window.
    Pushing takes constant time: a mirrored ring buffer keeps the window contiguous.

    Args:
        m: number of inputs, at least 1.
        p: number of outputs, at least 1.
        capacity: samples kept over all records, at least 1.

    Raises:
        ValueError: if a dimension is below 1.
    """

    def __init__(self, m: int, p: int, capacity: int) -> None:
        for name, value in (("m", m), ("p", p), ("capacity", capacity)):
            if value < 1:
                raise ValueError(f"{name} = {value}: a window needs {name} >= 1")
        self.m, self.p, self.capacity = m, p, capacity
        self._ring = np.zeros((2 * capacity, m + p))
        self._pushed = 0
        self._starts: list[int] = []  # positions, counted from the first push, at which records begin

    def __len__(self) -> int:
        """Number of samples held, all records together."""
        return min(self._pushed, self.capacity)

    @property
    def pushed(self) -> int:
        """Number of samples ever pushed since the window was made or cleared."""
        return self._pushed

    def push(self, u: ArrayLike, y: ArrayLike) -> None:
        """Adds one sample; the oldest one leaves when the window is full.

        Args:
            u: input u(k), shape (m,).
            y: output y(k), shape (p,).

        Raises:
            ValueError: on wrong shapes, NaN or infinity; the window is then unchanged. Cut the record and go on.
        """
        self.append(np.concatenate([as_sample(u, self.m, "u"), as_sample(y, self.p, "y")]))

    def append(self, w: Array) -> None:
        """Adds a sample w = [u; y], shape (m+p,), known to be finite."""
        if not self._starts:
            self._starts.append(0)
        place = self._pushed % self.capacity
        self._ring[place] = w
        self._ring[place + self.capacity] = w
        self._pushed += 1
        oldest = self._pushed - len(self)
        while len(self._starts) > 1 and self._starts[1] <= oldest:
            self._starts.pop(0)

    def cut(self) -> None:
        """Ends the record: the next sample starts a new one."""
        if self._starts and self._starts[-1] != self._pushed:
            self._starts.append(self._pushed)

    def clear(self) -> None:
        """Forgets everything."""
        self._pushed = 0
        self._starts.clear()

    def records(self) -> tuple[Record, ...]:
        """Copies of the records held, oldest first; a record just cut open and still empty is left out."""
        n = len(self)
        oldest = self._pushed - n
        first = oldest % self.capacity
        window = self._ring[first : first + n].copy()
        edges = [max(start, oldest) - oldest for start in self._starts] + [n]
        pieces = [window[a:b] for a, b in pairwise(edges) if b > a]
        return tuple(Record(piece[:, : self.m], piece[:, self.m :]) for piece in pieces)

    @property
    def unbroken(self) -> int:
        """Number of samples held of the record that is being written."""
        return min(self._pushed - self._starts[-1], self.capacity) if self._starts else 0

    def last(self, count: int) -> Array:
        """The newest samples [u, y], at most as many as held, in time order, shape (count, m+p); a copy."""
        end = (self._pushed - 1) % self.capacity + self.capacity + 1
        return self._ring[end - count : end].copy()

    def newest(self) -> Record:
        """The record that is being written; empty right after `cut`."""
        if self._starts and self._starts[-1] < self._pushed:
            return self.records()[-1]
        return Record(np.empty((0, self.m)), np.empty((0, self.p)))


def as_sample(value: ArrayLike, size: int, name: str) -> Array:
    """Returns ``value`` as a finite float64 vector of that size, or raises a ValueError that says what is wrong."""
    a = np.array(value, dtype=np.float64)
    if a.shape != (size,) and not (size == 1 and a.shape == ()):
        raise ValueError(f"{name} must have shape ({size},), got {a.shape}")
    a = a.reshape(size)
    if not all(map(isfinite, a.tolist())):
        i = int(np.flatnonzero(~np.isfinite(a))[0])
        raise ValueError(f"{name}[{i}] is {a[i]}: drop the sample and cut the record there")
    return a


def data_matrix(records: tuple[Record, ...] | list[Record], rows_u: int, rows_y: int) -> Array:
    """Stacked Hankel matrix [H(u); H(y)] of several records side by side.

    Column j of a record holds u(j), ..., u(j+rows_u-1) over y(j), ..., y(j+rows_y-1). A record may hold more
    inputs than outputs (with index s >= 2 the inputs are known s-1 samples further). Records that are too short give no
    column.

    Args:
        records: the records; u (n_u, m), y (n_y, p), both starting at the same instant.
        rows_u: block rows of inputs, at least 1.
        rows_y: block rows of outputs, at least 1.

    Returns:
        Shape (rows_u*m + rows_y*p, columns); no columns if every record is too short.
    """
    blocks = []
    for u, y in records:
        columns = min(len(u) - rows_u, len(y) - rows_y) + 1
        if columns > 0:
            blocks.append(np.vstack([hankel(u, rows_u)[:, :columns], hankel(y, rows_y)[:, :columns]]))
    if not blocks:
        m, p = (records[0].u.shape[1], records[0].y.shape[1]) if records else (0, 0)
        return np.empty((rows_u * m + rows_y * p, 0))
    return np.hstack(blocks)
