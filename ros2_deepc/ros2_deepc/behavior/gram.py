# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Gram matrix of a sliding Hankel matrix, in constant time and without drift."""

import numpy as np
from numpy.lib.stride_tricks import as_strided

from .hankel import Array

LOUD = 1e3  # a leaving sample this much larger than what remains would leave its rounding errors behind


class SlidingGram:
    """S = H H' for the time-major Hankel matrix H of the last samples: column j is [w(j); ...; w(j+blocks-1)].

    When the window moves by one sample, S moves along its own diagonal: S_ab becomes S_(a+1)(b+1). Only the last block
    column is new. It is updated by what enters and what leaves, and one of its blocks is summed afresh at every push,
    so that no entry is ever older than 2 * blocks pushes: rounding errors cannot pile up, and a push costs the same
    for every window length but for one block's sum.

    S squares the condition of H: directions of H weaker than about 1e-7 of the strongest are lost in it. Use
    `SlidingFactor` where that matters.

    Args:
        channels: size of a sample, at least 1.
        blocks: block rows of H, at least 1.
        columns: columns of H, at least 1; the window holds columns + blocks - 1 samples.
    """

    def __init__(self, channels: int, blocks: int, columns: int) -> None:
        self.channels, self.blocks, self.columns = channels, blocks, columns
        self._length = columns + blocks - 1
        self._ring = np.zeros((2 * self._length + 2, channels))
        self._pushed = 0
        d = channels * blocks
        self._S = np.zeros((d, d))

    @property
    def full(self) -> bool:
        """Whether the window holds all its columns."""
        return self._pushed >= self._length

    @property
    def matrix(self) -> Array:
        """S, shape (channels*blocks, channels*blocks), time-major; a view that the next push changes.

        Raises:
            ValueError: if the window is not full.
        """
        if not self.full:
            raise ValueError(f"the window holds {self._pushed} of {self._length} samples")
        return self._S

    def clear(self) -> None:
        """Starts a new record: nothing of what was pushed may share a column with what follows."""
        self._pushed = 0

    def push(self, w: Array) -> None:
        """Adds a sample, shape (channels,); the oldest one leaves when the window is full."""
        size = self._length + 1  # one sample more than the window: the one that has just left
        place = self._pushed % size
        self._ring[place] = w
        self._ring[place + size] = w
        self._pushed += 1
        if self._pushed == self._length:
            self._fresh()
        elif self._pushed > self._length:
            self._shift()

    def _samples(self, count: int) -> Array:
        """The newest samples in time order, shape (count, channels); a view."""
        end = (self._pushed - 1) % (self._length + 1) + self._length + 2
        if end > len(self._ring):
            end -= self._length + 1
        return self._ring[end - count : end]

    def _fresh(self) -> None:
        """All blocks from the samples."""
        w, n, c, dw = self._samples(self._length), self.blocks, self.columns, self.channels
        H = as_strided(w, (n, dw, c), (w.strides[0], w.strides[1], w.strides[0])).reshape(n * dw, c)
        np.matmul(H, H.T, out=self._S)

    def _shift(self) -> None:
        """Moves S along its diagonal and brings its last block column up to date."""
        n, c, dw, S = self.blocks, self.columns, self.channels, self._S
        w = self._samples(self._length + 1)  # w[0] has just left; the window's first column starts at w[1]
        last = S[:, -dw:].copy()
        if n > 1:
            S[:-dw, :-dw] = S[dw:, dw:].copy()
        entering, leaving = w[c:].reshape(-1, 1) * w[-1], w[:n].reshape(-1, 1) * w[n - 1]
        last += entering
        last -= leaving
        if np.abs(leaving).max() > LOUD * np.abs(last).max():
            for a in range(n):
                last[a * dw : (a + 1) * dw] = w[1 + a : 1 + a + c].T @ w[n:]
        else:
            a = self._pushed % n
            last[a * dw : (a + 1) * dw] = w[1 + a : 1 + a + c].T @ w[n:]
        S[:, -dw:] = last
        S[-dw:, :] = last.T
