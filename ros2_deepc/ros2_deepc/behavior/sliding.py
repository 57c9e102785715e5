# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Triangular factor of a sliding Hankel matrix by orthogonal transformations only."""

from dataclasses import dataclass, field

import numpy as np

from .hankel import Array


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

    Nothing is ever subtracted: factors are only merged, by QR decompositions. So the factor is as good as a fresh one
    for ever, whatever passed through the window. Columns are gathered in chunks and chunks in segments of half a
    window; a segment's tails, needed when its front expires, are worked out one chunk at a time while the next segment
    fills. A push therefore costs a copy, and at the end of a chunk two small QR decompositions, for every window
    length.

    Args:
        channels: size of a sample, at least 1.
        blocks: block rows of H, at least 1.
        columns: columns of H, at least 1; the window holds columns + blocks - 1 samples.
        chunk: columns per chunk; 0 takes half the rows of H, at least 8.
    """

    def __init__(self, channels: int, blocks: int, columns: int, chunk: int = 0) -> None:
        self.channels, self.blocks, self.columns = channels, blocks, columns
        self._rows = channels * blocks
        self._chunk = min(chunk or max(8, self._rows // 2), max(1, (columns + 1) // 2))
        # Columns of a segment: whole chunks, and so few that its tails are done before its front expires.
        self._half = max(1, (columns + 1) // 2) // self._chunk * self._chunk
        self._keep = columns + self._half + blocks  # samples that may still be needed
        self._ring = np.zeros((2 * self._keep, channels))
        self.clear()

    @property
    def full(self) -> bool:
        """Whether the window holds all its columns."""
        return self._next >= self.columns

    @property
    def held(self) -> int:
        """Columns in the window."""
        return min(self._next, self.columns)

    def clear(self) -> None:
        """Starts a new record: nothing of what was pushed may share a column with what follows."""
        self._pushed = 0
        self._next = 0  # columns of this record so far
        self._segments: list[_Segment] = []
        self._first = 0  # first column of the segment that is filling
        self._growing = np.zeros((0, self._rows))  # factor of its complete chunks

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
        """R, shape (at most channels*blocks, channels*blocks), upper triangular or trapezoidal, R'R = H H'."""
        oldest = self._next - self.held
        parts = []
        for segment in self._segments:
            if segment.first + self._half <= oldest:
                continue
            if segment.first >= oldest:
                parts.append(segment.whole)
                continue
            begin = -(-(oldest - segment.first) // self._chunk)  # first chunk wholly inside the window
            parts.append(self._raw(oldest, min(segment.first + begin * self._chunk, self._next)))
            if begin < len(segment.tails):
                tail = segment.tails[begin]
                assert tail is not None  # worked out while the next segment filled
                parts.append(tail)
        closed = self._first + (self._next - self._first) // self._chunk * self._chunk
        if self._first < oldest:  # only while the first segment of a short window fills
            parts.append(self._raw(oldest, self._next))
        else:
            parts += [self._growing, self._raw(closed, self._next)]
        return merge(parts, self._rows)

    def _raw(self, start: int, stop: int) -> Array:
        """Columns start, ..., stop - 1 of the record as rows, shape (stop - start, rows)."""
        if stop <= start:
            return np.zeros((0, self._rows))
        newest = (self._pushed - 1) % self._keep + self._keep + 1
        begin = newest - (self._pushed - start)
        flat = self._ring[begin : begin + stop - start + self.blocks - 1].ravel()
        return np.lib.stride_tricks.sliding_window_view(flat, self._rows)[:: self.channels]

    def _close_chunk(self) -> None:
        """Takes a complete chunk in; works out one more tail of the segment before."""
        self._growing = merge([self._growing, self._raw(self._next - self._chunk, self._next)], self._rows)
        if self._segments:
            self._extend_tails(self._segments[-1])
        if self._next - self._first == self._half:
            chunks = self._half // self._chunk
            self._segments.append(_Segment(self._first, self._growing, [None] * chunks, chunks - 1))
            self._first, self._growing = self._next, np.zeros((0, self._rows))
            oldest = self._next - self.held
            self._segments = [s for s in self._segments if s.first + self._half > oldest]

    def _extend_tails(self, segment: _Segment) -> None:
        """One chunk more at the front of the tails."""
        i = segment.open
        if i < 0:
            return
        start = segment.first + i * self._chunk
        later = segment.tails[i + 1] if i + 1 < len(segment.tails) else None
        parts = [self._raw(start, start + self._chunk)]
        segment.tails[i] = merge(parts if later is None else [*parts, later], self._rows)
        segment.open -= 1


def merge(parts: list[Array], rows: int) -> Array:
    """Upper-triangular R with R'R the sum of P'P over the parts; shape (at most rows, rows)."""
    stacked = np.vstack([part for part in parts if len(part)] or [np.zeros((0, rows))])
    return np.asarray(np.linalg.qr(stacked, mode="r")) if len(stacked) else stacked
