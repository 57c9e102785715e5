# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Columns of numbers taken from messages, as many as a bag holds, found again by epoch and sample index."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import BagError
from .outline import Block
from .spill import Spill

Array = NDArray[np.float64]
Keys = NDArray[np.int64]  # one ordered number for (epoch, k)
NO_KEY = -1
LAST_KEY = np.iinfo(np.int64).max
K_BITS = 40
_PIECE = 1 << 19  # bytes that are written together


@dataclass(frozen=True, slots=True)
class _Piece:
    """Messages of one epoch that follow one another: where each column of theirs is."""

    epoch: int
    first: int  # smallest and largest k
    last: int
    at: int
    rows: int
    width: int


class Columns:
    """Numbers of many messages of one kind that have header, epoch and k, in the order of arrival.

    The messages are kept in pieces in a temporary file; what stays in memory is which samples each piece is about.

    Args:
        spill: the file.
        scalars: paths of the scalar fields to keep; a field that a message lacks is NaN.
        vector: path of one vector field to keep, "" = none. Empty vectors become NaN; all others must have one length.
    """

    def __init__(self, spill: Spill, scalars: Sequence[str] = (), vector: str = "") -> None:
        self._spill, self._vector, self.width = spill, vector, 0
        self._place: Mapping[str, int] = {name: i for i, name in enumerate(("k", "stamp", *scalars))}
        self._waiting: list[tuple[NDArray[np.int64], list[NDArray[Any]], Array]] = []
        self._pieces: list[_Piece] = []
        self._first = self._last = np.empty(0, dtype=np.int64)  # keys, of each piece
        self._ranks: Mapping[int, int] = {}
        self.count = 0

    def add(self, block: Block) -> None:
        """Appends the messages of a block.

        Raises:
            BagError: if a vector is longer or shorter than those before, or an index k is 2**40 or more, which no
                sampled plant reaches.
        """
        k = block.column("k", np.uint64, 0)
        if k.size and k.max() >= 1 << K_BITS:
            raise BagError(f"sample index {k.max()} makes no sense")
        columns = [k.astype(np.int64), stamps(block), *map(block.column, list(self._place)[2:])]
        self._waiting.append((block.column("epoch", np.int64, 0), columns, self._vectors(block, k)))
        self.count += len(block)
        if 8 * sum(map(len, (epoch for epoch, *_ in self._waiting))) * (len(columns) + self.width) >= _PIECE:
            self._write()

    def _vectors(self, block: Block, k: NDArray[np.uint64]) -> Array:
        if not self._vector:
            return np.empty((len(block), 0))
        values, widths = block.vectors(self._vector)
        given = np.flatnonzero(widths)
        if not self.width and len(given):
            self.width = int(widths[given[0]])
        wrong = given[widths[given] != self.width]
        if len(wrong):
            have = f"{widths[wrong[0]]} {self._vector}"
            raise BagError(f"sample k = {k[wrong[0]]} has {have}, those before have {self.width}")
        return values if len(given) else np.full((len(block), self.width), np.nan)

    def _write(self) -> None:
        """What waits becomes pieces, one for each epoch."""
        if not self._waiting:
            return
        epochs, columns, vectors = zip(*self._waiting, strict=True)
        self._waiting = []
        epoch, width = np.concatenate(epochs), max(v.shape[1] for v in vectors)
        vector = np.concatenate([v if v.shape[1] == width else np.full((len(v), width), np.nan) for v in vectors])
        joined = [np.concatenate(column) for column in zip(*columns, strict=True)]
        for number in dict.fromkeys(epoch.tolist()):  # in the order of arrival
            rows = np.flatnonzero(epoch == number)
            k = joined[0][rows]
            at = self._spill.write(k)
            for column in (*joined[1:], vector):
                self._spill.write(column[rows])
            self._pieces.append(_Piece(number, int(k.min()), int(k.max()), at, len(rows), width))

    def epochs(self) -> list[int]:
        """The epochs, in the order of arrival."""
        self._write()
        return list(dict.fromkeys(piece.epoch for piece in self._pieces))

    def rank(self, epochs: Sequence[int]) -> None:
        """Puts (epoch, k) in order: epochs rank as given. Messages of other epochs are not found any more."""
        self._write()
        self._ranks = {epoch: i for i, epoch in enumerate(epochs)}
        self._pieces = [piece for piece in self._pieces if piece.epoch in self._ranks]
        self.count = sum(piece.rows for piece in self._pieces)
        starts = np.array([self._ranks[p.epoch] << K_BITS for p in self._pieces], dtype=np.int64)
        self._first = starts + np.array([p.first for p in self._pieces], dtype=np.int64)
        self._last = starts + np.array([p.last for p in self._pieces], dtype=np.int64)

    def find(self, wanted: Keys) -> "Found":
        """The first message for each of the wanted keys, which are sorted and distinct."""
        missing = np.ones(len(wanted), dtype=bool)
        hits = []
        for i in self._overlapping(wanted[0], wanted[-1]) if len(wanted) else ():
            low, high = np.searchsorted(wanted, [self._first[i], self._last[i] + 1])
            if not missing[low:high].any():
                continue
            keys, rows = np.unique(self._keys(self._pieces[i]), return_index=True)
            places = np.minimum(np.searchsorted(wanted, keys), len(wanted) - 1)
            new = (wanted[places] == keys) & missing[places]
            hits.append((self._pieces[i], rows[new], places[new]))
            missing[places[new]] = False
        return Found(self, wanted, ~missing, hits)

    def within(self, start: int, end: int) -> "Found":
        """All messages with keys from start to end (exclusive), in the order of the keys, then of arrival."""
        keys, hits, n = [np.empty(0, dtype=np.int64)], [], 0
        for i in self._overlapping(start, end - 1):
            mine = self._keys(self._pieces[i])
            rows = np.flatnonzero((mine >= start) & (mine < end))
            hits.append((self._pieces[i], rows, n + np.arange(len(rows))))
            keys.append(mine[rows])
            n += len(rows)
        order = np.argsort(found := np.concatenate(keys), kind="stable")
        place = np.empty_like(order)
        place[order] = np.arange(n)
        moved = [(piece, rows, place[at]) for piece, rows, at in hits]
        return Found(self, found[order], np.ones(n, dtype=bool), moved)

    def stretches(self, size: int) -> Iterator[tuple[Keys, int]]:
        """Yields the distinct keys in order, ``size`` at a time, and the first one after them (LAST_KEY: none)."""
        keys: list[Keys] = []
        n, at = 0, self.after(0)
        while at < LAST_KEY:
            end = at + size - n
            keys.append(np.unique(self.within(at, end).keys))
            n, at = n + len(keys[-1]), self.after(end)
            if n == size or at == LAST_KEY:
                yield np.concatenate(keys), at
                keys, n = [], 0

    def after(self, key: int) -> int:
        """The smallest key that is not smaller, or LAST_KEY."""
        found = int(self._first[self._first >= key].min(initial=LAST_KEY))
        for i in np.flatnonzero((self._first < key) & (self._last >= key)).tolist():
            mine = self._keys(self._pieces[i])
            found = min(found, int(mine[mine >= key].min()))
        return found

    def _overlapping(self, first: int, last: int) -> list[int]:
        found: list[int] = np.flatnonzero((self._first <= last) & (self._last >= first)).tolist()
        return found

    def _keys(self, piece: _Piece) -> Keys:
        k: Keys = self._spill.read(piece.at, np.int64, (piece.rows,))
        return (self._ranks[piece.epoch] << K_BITS) + k

    def read(self, piece: _Piece, name: str) -> NDArray[Any]:
        """A column of a piece, shape (rows,); "" is the vector, shape (rows, width)."""
        place = self._place[name] if name else len(self._place)
        kind = np.int64 if name in ("k", "stamp") else np.float64
        shape = (piece.rows,) if name else (piece.rows, piece.width)
        return self._spill.read(piece.at + 8 * piece.rows * place, kind, shape)


class Found:
    """Messages of a table, in the order in which they were asked for.

    Attributes:
        keys: shape (n,).
        known: whether there is such a message, shape (n,).
    """

    def __init__(
        self, table: Columns, keys: Keys, known: NDArray[np.bool_],
        hits: Sequence[tuple[_Piece, NDArray[np.intp], NDArray[np.intp]]],
    ) -> None:  # fmt: skip
        self.keys, self.known, self._table, self._hits = keys, known, table, hits

    def column(self, name: str) -> Array:
        """One scalar field, shape (n,); NaN where there is no message."""
        return self._filled(name, np.full(len(self.keys), np.nan))

    def stamps(self) -> NDArray[np.int64]:
        """Stamps in the headers, shape (n,) [ns]; 0 where there is no message."""
        return self._filled("stamp", np.zeros(len(self.keys), dtype=np.int64))

    def vectors(self) -> Array:
        """The vector field, shape (n, width); NaN where there is no message."""
        return self._filled("", np.full((len(self.keys), self._table.width), np.nan))

    def _filled(self, name: str, out: NDArray[Any]) -> NDArray[Any]:
        for piece, rows, places in self._hits:
            if len(rows) and (name or piece.width):
                out[places] = self._table.read(piece, name)[rows]
        return out


def stamps(block: Block) -> NDArray[np.int64]:
    """Stamps in the headers of a block's messages, shape (n,) [ns]."""
    sec, nanosec = (block.column(f"header.stamp.{part}", np.int64, 0) for part in ("sec", "nanosec"))
    return np.asarray(sec * 10**9 + nanosec, dtype=np.int64)
