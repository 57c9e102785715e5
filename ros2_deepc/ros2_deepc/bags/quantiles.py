# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Exact quantiles of more numbers than fit in memory."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from .spill import Spill

Array = NDArray[np.float64]
_BITS, _ROWS = 16, 65536
_SIGN = np.uint64(1 << 63)


class Quantiles:
    """Takes numbers, keeps them in a temporary file, and gives the quantiles that ``numpy.quantile`` gives of all."""

    def __init__(self) -> None:
        self._spill, self._count = Spill(), 0

    def __len__(self) -> int:
        return self._count

    def add(self, values: Array) -> None:
        """Takes numbers, shape (n,); those that are not finite do not count."""
        known = values[np.isfinite(values)]
        self._spill.write(known)
        self._count += len(known)

    def __call__(self, q: float) -> float:
        """The quantile of share q, between neighbours linearly; NaN if there is no number."""
        if not self._count:
            return float("nan")
        at = q * (self._count - 1)
        low = int(at)
        neighbours = [self._ranked(low), self._ranked(min(low + 1, self._count - 1))]
        return float(np.quantile(neighbours, at - low))

    def _ranked(self, rank: int) -> float:
        """The number with so many smaller ones: 16 bits more of it are known after each reading."""
        found = 0
        for shift in range(64 - _BITS, -1, -_BITS):
            counts = np.zeros(1 << _BITS, dtype=np.int64)
            for bits in self._ordered():
                alike = bits[bits >> np.uint64(shift + _BITS) == found] if shift < 64 - _BITS else bits
                digits = (alike >> np.uint64(shift)) & np.uint64((1 << _BITS) - 1)
                counts += np.bincount(digits.astype(np.int64), minlength=1 << _BITS)
            below = np.cumsum(counts)
            digit = int(np.searchsorted(below, rank, side="right"))
            rank -= int(below[digit] - counts[digit])
            found = (found << _BITS) | digit
        bits = np.array([found], dtype=np.uint64)
        return float(np.where(bits & _SIGN, bits & ~_SIGN, ~bits).view(np.float64)[0])

    def _ordered(self) -> Iterator[NDArray[np.uint64]]:
        """The numbers as whole numbers in the same order: the bits of a double, the sign turned round."""
        for at in range(0, self._count, _ROWS):
            bits = self._spill.read(8 * at, np.uint64, (min(_ROWS, self._count - at),))
            yield np.where(bits & _SIGN, ~bits, bits | _SIGN)
