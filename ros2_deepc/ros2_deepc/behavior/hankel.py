# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Block-Hankel matrices of recorded signals."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def as_signal(w: ArrayLike, name: str = "signal") -> Array:
    """Returns ``w`` as a finite float64 array of shape (T, d); a vector of length T becomes (T, 1).

    Raises:
        ValueError: if ``w`` is not one- or two-dimensional, or holds a NaN, an infinity or no real number.
    """
    if np.iscomplexobj(w):
        raise ValueError(f"{name} must be real, got complex numbers")
    try:
        a = np.asarray(w, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} must hold numbers in the shape (T, d): {error}") from error
    if a.ndim == 1:
        a = a[:, None]
    if a.ndim != 2:
        raise ValueError(f"{name} must have shape (T, d), got {a.shape}")
    bad = ~np.isfinite(a)
    if bad.any():
        k, i = np.argwhere(bad)[0]
        raise ValueError(f"{name}[{k}, {i}] is {a[k, i]}: drop the sample and cut the record there")
    return a


def hankel(w: ArrayLike, L: int) -> Array:
    """Block-Hankel matrix H_L(w) of the paper's notation (section 1).

    Args:
        w: signal, shape (T, d) (or (T,) for d = 1).
        L: number of block rows, 1 <= L <= T.

    Returns:
        Shape (L*d, T-L+1); column j holds w(j), ..., w(j+L-1), block rows in time order.

    Raises:
        ValueError: if L does not fit the record.
    """
    a = as_signal(w)
    T, d = a.shape
    if not 1 <= L <= T:
        raise ValueError(f"L = {L} block rows need a record of at least L samples (and L >= 1), got T = {T}")
    windows = np.lib.stride_tricks.sliding_window_view(a, L, axis=0)  # (T-L+1, d, L)
    return np.ascontiguousarray(windows.transpose(2, 1, 0).reshape(L * d, T - L + 1))
