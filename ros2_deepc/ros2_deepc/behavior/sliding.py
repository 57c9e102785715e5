# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Triangular factor of a sliding Hankel matrix by orthogonal transformations only."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg.lapack import dtpqrt

from .hankel import Array

TAILS = 64
"""Factors of tails kept, above which chunks are made longer."""


@dataclass(slots=True)
class _Segment:
    """Half a window of columns: the factor of all of them, and of its ends, from chunk boundaries on.

    Attributes:
        first: number of its first column, counted from the start of the record.
        whole: factor of all its columns.
        tails: tails[i] is the factor of its columns from chunk i on; None while it is not yet worked out.
        open: chunk whose tail is worked out next; below zero when done.
    """

    first: int
    whole: Array
    tails: list[Array | None] = field(default_factory=list)
    open: int = -1


class SlidingFactor:
    """R with R'R = H H' for the time-major Hankel matrix H of the last samples: column j is [w(j); ...; w(j+blocks-1)].

    Columns that would span two records are left out: a gap costs blocks - 1 of them.

    Nothing is ever subtracted: factors are only merged, by QR decompositions. So the factor is as good as a fresh one
    for ever, whatever passed through the window. Columns are gathered in chunks and chunks in segments of half a
    window; a segment's tails, needed when its front expires, are worked out one chunk at a time while the next segment
    fills. A push therefore costs a copy, and at the end of a chunk two small QR decompositions, for every window
    length.

    Args:
        channels: size of a sample, at least 1.
        blocks: block rows of H, at least 1.
        columns: columns of H, at least 1; the window holds columns + blocks - 1 samples.
        chunk: columns per chunk; 0 takes an eighth of the rows, up to half of them for long windows, at least 8.
        order: which rows of H to keep, in which order; None keeps all as they are.
    """

    def __init__(
        self, channels: int, blocks: int, columns: int, chunk: int = 0, order: Sequence[int] | Array | None = None
    ) -> None:
        self.channels, self.blocks, self.columns = channels, blocks, columns
        self._order = np.arange(channels * blocks) if order is None else np.asarray(order, dtype=np.intp)
        self._rows = self._order.size
        half = max(1, (columns + 1) // 2)
        self._chunk = min(chunk or max(8, self._rows // 8, min(half // TAILS, self._rows // 2)), half)
        # Columns of a segment: whole chunks, and so few that its tails are done before its front expires.
        self._half = half // self._chunk * self._chunk
        self._keep = columns + self._half + blocks  # samples that may still be needed
        self._ring = np.zeros((2 * self._keep, channels))
        self.clear()

    @property
    def full(self) -> bool:
        """Whether the window holds all its columns."""
        return self.held == self.columns

    @property
    def held(self) -> int:
        """Columns in the window."""
        oldest = max(0, self._next - self.columns)
        spanning = {j for cut in self._cuts for j in range(max(oldest, cut - self.blocks + 1), min(cut, self._next))}
        return self._next - oldest - len(spanning)

    def clear(self) -> None:
        """Forgets everything."""
        self._cuts: list[int] = []  # samples, counted from the first, with which a record begins
        self._pushed = 0
        self._next = 0  # columns of this record so far
        self._segments: list[_Segment] = []
        self._first = 0  # first column of the segment that is filling
        self._nothing = np.zeros((self._rows, self._rows), order="F")
        self._growing = self._nothing  # factor of its complete chunks
        self._solid: tuple[list[Array], Array] = ([], self._nothing)

    def cut(self) -> None:
        """Starts a new record: no column spans what was pushed and what follows."""
        oldest = self._pushed - self._keep
        self._cuts = [cut for cut in self._cuts if oldest <= cut < self._pushed] + [self._pushed] * (self._pushed > 0)

    def push(self, w: Array) -> None:
        """Adds a sample, shape (channels,); the oldest one leaves when the window is full."""
        place = self._pushed % self._keep
        self._ring[place] = w
        self._ring[place + self._keep] = w
        self._pushed += 1
        self._next = max(0, self._pushed - self.blocks + 1)
        if self._next > self._first and (self._next - self._first) % self._chunk == 0:
            self._close_chunk()

    def factor(self) -> Array:
        """R, upper triangular, R'R = H H'; shape (rows, rows), or fewer rows as long as columns are fewer."""
        triangles, spans = self._pieces()
        known, R = self._solid
        if len(known) != len(triangles) or any(a is not b for a, b in zip(known, triangles, strict=True)):
            R = functools.reduce(join, triangles, self._nothing)
            self._solid = (triangles, R)  # the same until a chunk is closed or expires
        for start, stop in spans:
            R = self._absorb(R, start, stop)
        return np.asarray(R[: self.held])

    def _pieces(self) -> tuple[list[Array], list[tuple[int, int]]]:
        """What the window consists of: factors of whole chunks, and spans of single columns."""
        oldest = max(0, self._next - self.columns)
        triangles: list[Array] = []
        spans: list[tuple[int, int]] = []
        for segment in self._segments:
            if segment.first + self._half <= oldest:
                continue
            if segment.first >= oldest:
                triangles.append(segment.whole)
                continue
            begin = -(-(oldest - segment.first) // self._chunk)  # first chunk wholly inside the window
            spans.append((oldest, min(segment.first + begin * self._chunk, self._next)))
            if begin < len(segment.tails):
                tail = segment.tails[begin]
                assert tail is not None  # worked out while the next segment filled
                triangles.append(tail)
        if self._first < oldest:  # only while the first segment of a short window fills
            spans.append((oldest, self._next))
        else:
            closed = self._first + (self._next - self._first) // self._chunk * self._chunk
            triangles.append(self._growing)
            spans.append((closed, self._next))
        return triangles, spans

    def _absorb(self, R: Array, start: int, stop: int) -> Array:
        """The factor R with columns start, ..., stop - 1 of the run added."""
        if stop <= start:
            return R
        newest = (self._pushed - 1) % self._keep + self._keep + 1
        begin = newest - (self._pushed - start)
        flat = self._ring[begin : begin + stop - start + self.blocks - 1].ravel()
        windows = np.lib.stride_tricks.sliding_window_view(flat, self.channels * self.blocks)[:: self.channels]
        columns = np.asfortranarray(windows[:, self._order])
        for cut in self._cuts:
            columns[max(0, cut - self.blocks + 1 - start) : max(0, cut - start)] = 0
        return join(R, columns, triangular=False)

    def _close_chunk(self) -> None:
        """Takes a complete chunk in; works out one more tail of the segment before."""
        self._growing = self._absorb(self._growing, self._next - self._chunk, self._next)
        if self._segments:
            self._extend_tails(self._segments[-1])
        if self._next - self._first == self._half:
            chunks = self._half // self._chunk
            self._segments.append(_Segment(self._first, self._growing, [None] * chunks, chunks - 1))
            self._first, self._growing = self._next, self._nothing
            oldest = self._next - self.columns
            self._segments = [s for s in self._segments if s.first + self._half > oldest]

    def _extend_tails(self, segment: _Segment) -> None:
        """One chunk more at the front of the tails."""
        i = segment.open
        if i < 0:
            return
        start = segment.first + i * self._chunk
        later = segment.tails[i + 1] if i + 1 < len(segment.tails) else None
        segment.tails[i] = self._absorb(self._nothing if later is None else later, start, start + self._chunk)
        segment.open -= 1


def join(R: Array, rows: Array, *, triangular: bool = True) -> Array:
    """Upper triangular factor of R over more rows, which are upper triangular themselves or any; R stays as it is.

    Triangles meet at a fifth of the work of a QR decomposition that does not know them.
    """
    n = len(R)
    joined, _, _, info = dtpqrt(n if triangular else 0, min(8, n), R, rows)
    if info:
        raise np.linalg.LinAlgError(f"dtpqrt: argument {-info}")
    return np.asarray(joined)
