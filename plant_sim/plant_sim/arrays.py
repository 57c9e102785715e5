# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Checked, read-only float64 arrays."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import ShapeError

Array = NDArray[np.float64]


def frozen(a: Array) -> Array:
    """Marks ``a`` read-only and returns it."""
    a.setflags(write=False)
    return a


def matrix(value: ArrayLike, name: str, shape: tuple[int | None, ...]) -> Array:
    """Returns a finite, read-only float64 copy of ``value``.

    Args:
        value: anything that numpy turns into numbers.
        name: what the error message calls it.
        shape: wanted shape; None leaves a dimension free.

    Raises:
        ShapeError: if the number of dimensions or a size is wrong, or an entry is not a finite real number.
    """
    try:
        if np.iscomplexobj(value):
            raise TypeError("it has complex entries")
        a = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        ragged = "inhomogeneous" in str(error)
        raise ShapeError(f"{name} must be a real matrix: {'rows differ in length' if ragged else error}") from None
    if a.ndim != len(shape) or any(
        want is not None and have != want for have, want in zip(a.shape, shape, strict=True)
    ):
        wanted = ", ".join("any" if size is None else str(size) for size in shape)
        raise ShapeError(f"{name} must have shape ({wanted}), got {a.shape}")
    bad = np.argwhere(~np.isfinite(a))
    if bad.size:
        where = tuple(int(i) for i in bad[0])
        raise ShapeError(f"{name}{list(where)} is {a[where]}: every entry must be finite")
    return frozen(a)
