# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Long records cut down to what a picture can show."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def stretches(values: NDArray[Any]) -> list[tuple[int, int, Any]]:
    """Runs of equal values as (first row, row after the last, value)."""
    if not len(values):
        return []
    edges = np.flatnonzero(values[1:] != values[:-1]) + 1
    starts, ends = np.r_[0, edges], np.r_[edges, len(values)]
    return [(int(a), int(b), values[a]) for a, b in zip(starts, ends, strict=True)]


def thin(x: Array, y: Array, points: int = 4000) -> tuple[Array, Array]:
    """At most about ``points`` points that draw the same line: smallest and largest value of each bin, in order.

    Args:
        x: shape (K,).
        y: shape (K,); NaN leaves a gap, and a bin with a NaN keeps one.
        points: largest number of points wanted.
    """
    if len(x) <= points:
        return x, y
    size = -(-len(x) // (points // 2))
    K = len(x) // size * size
    bins = y[:K].reshape(-1, size)
    low, high = np.where(np.isnan(bins), np.inf, bins), np.where(np.isnan(bins), -np.inf, bins)
    first = np.minimum(low.argmin(1), high.argmax(1))
    last = np.maximum(low.argmin(1), high.argmax(1))
    hole = np.isnan(bins)
    last = np.where(hole.any(1), hole.argmax(1), last)
    rows = np.arange(0, K, size)
    keep = np.unique(np.concatenate([rows + first, rows + last, np.arange(K, len(x)), [0, len(x) - 1]]))
    return x[keep], y[keep]
