# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Persistency of excitation of an input record."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from .hankel import Array, as_signal, hankel


def numerical_rank(M: Array) -> int:
    """Number of singular values of M above ``max(M.shape) * eps * sigma_1``, the rounding level of M itself."""
    if M.size == 0:
        return 0
    sv = np.linalg.svd(M, compute_uv=False)
    return int(np.count_nonzero(sv > max(M.shape) * np.finfo(np.float64).eps * sv[0]))


def excites(records: Sequence[ArrayLike], L: int) -> bool:
    """Whether input records are collectively persistently exciting of order L: [H_L(u1), H_L(u2), ...] has rank m L.

    Cheaper than the order itself: one singular value decomposition at most.

    Args:
        records: input records, shapes (T_i, m).
        L: order, L >= 0.

    Raises:
        ValueError: if a record is not a finite signal.
    """
    pieces = _unit_peak(records)
    return L == 0 or (bool(pieces) and _excites(pieces, L))


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
    return collective_excitation_order([u], at_most)


def collective_excitation_order(records: Sequence[ArrayLike], at_most: int | None = None) -> int:
    """Largest order of which several unbroken input records excite together; see `excitation_order`.

    Args:
        records: input records, shapes (T_i, m).
        at_most: stop at this order.

    Raises:
        ValueError: if a record is not a finite signal.
    """
    pieces = _unit_peak(records)
    if not pieces:
        return 0
    m, longest = pieces[0].shape[1], max(len(u) for u in pieces)
    highest = (longest + 1) // (m + 1) if len(pieces) == 1 else longest  # beyond, the matrix is taller than wide
    if at_most is not None:
        highest = min(highest, at_most)
    if _excites(pieces, highest):
        return highest
    low, high = 0, highest  # excites of order low, not of order high
    while high - low > 1:
        middle = (low + high) // 2
        if _excites(pieces, middle):
            low = middle
        else:
            high = middle
    return low


def _unit_peak(records: Sequence[ArrayLike]) -> list[Array]:
    """The records with every channel scaled to unit peak; none if a channel is zero throughout."""
    pieces = [as_signal(u, "u") for u in records]
    if not pieces:
        return []
    peak = np.max([np.abs(u).max(axis=0, initial=0.0) for u in pieces], axis=0)
    return [u / peak for u in pieces] if peak.size and peak.all() else []


def _excites(pieces: list[Array], L: int) -> bool:
    rows = L * pieces[0].shape[1]
    if sum(max(0, len(u) - L + 1) for u in pieces) < rows:
        return False
    return L == 0 or numerical_rank(np.hstack([hankel(u, L) for u in pieces if len(u) >= L])) == rows
