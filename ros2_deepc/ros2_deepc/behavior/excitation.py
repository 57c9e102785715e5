# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Persistency of excitation of an input record."""

import numpy as np
from numpy.typing import ArrayLike

from .hankel import Array, as_signal, hankel


def numerical_rank(M: Array) -> int:
    """Number of singular values of M above ``max(M.shape) * eps * sigma_1``, the rounding level of M itself."""
    if M.size == 0:
        return 0
    sv = np.linalg.svd(M, compute_uv=False)
    return int(np.count_nonzero(sv > max(M.shape) * np.finfo(np.float64).eps * sv[0]))


def excites(u: Array, L: int) -> bool:
    """Whether u is persistently exciting of order L: H_L(u) has full row rank m L (paper, section 1).

    Args:
        u: finite input record, shape (T, m), every channel of similar size.
        L: order, L >= 0.
    """
    T, m = u.shape
    if L == 0:
        return True
    wide = (m + 1) * L - 1 <= T
    return bool(wide and numerical_rank(hankel(u, L)) == m * L)


def excitation_order(u: ArrayLike, at_most: int | None = None) -> int:
    """Largest L for which u is persistently exciting of order L (paper, section 1).

    Channels are scaled to unit peak first, so that units do not matter. The rank of H_L(u) counts the singular
    values above ``max(shape) * eps * sigma_1``. Orders are searched by bisection, since an input exciting of order L
    excites of every lower one: about log2(T / m) singular value decompositions.

    Args:
        u: input record, shape (T, m) or (T,).
        at_most: stop at this order; keeps the test cheap on long records.

    Returns:
        The order; 0 if some channel or combination of channels is identically zero.

    Raises:
        ValueError: if u is not a finite signal.
    """
    a = as_signal(u, "u")
    T, m = a.shape
    peak = np.abs(a).max(axis=0, initial=0.0)
    if m == 0 or not peak.all():
        return 0
    a = a / peak
    highest = int((T + 1) // (m + 1))  # more block rows than this and H_L(u) is taller than wide
    if at_most is not None:
        highest = min(highest, at_most)
    if excites(a, highest):
        return highest
    low, high = 0, highest  # excites(low) holds, excites(high) does not
    while high - low > 1:
        middle = (low + high) // 2
        if excites(a, middle):
            low = middle
        else:
            high = middle
    return low
