# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Structure of a plant from its data: slow dimension, index, lag, ranks of the fast part."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from .compress import Array, Compression
from .noise import Noise, as_noise
from .source import Source, from_records
from .verdict import StructureEstimate


def svdvals(W: Array) -> Array:
    """Singular values, largest first."""
    return np.asarray(np.linalg.svd(W, compute_uv=False))


def count(sigma: Array, eps: float) -> int:
    """Singular values above a noise bound."""
    return int(np.count_nonzero(sigma > eps))


def visible_lag(data: Compression, eps: float, seen: int) -> int:
    """Fewest output block rows that already show all the directions seen; 0 if none is seen."""
    if not seen:
        return 0

    def shows(rows: int) -> bool:
        return count(svdvals(data.directions[: data.p * rows, :seen]), eps) >= seen

    return first(shows, data.L + 1)


def visible_ranks(data: Compression, eps: float) -> tuple[int, ...]:
    """Ranks of [outputs beyond the first L+j block rows of inputs] for j = 1 .. d-L: q + rho_j each."""
    extra = data.d - data.L
    if extra == 1:
        return (count(data.sigma, eps),)
    shares = [np.hstack([data.R21[:, data.m * (data.L + j) :], data.directions]) for j in range(1, extra + 1)]
    return tuple(count(svdvals(W), eps) for W in shares)


def visible_index(ranks: tuple[int, ...]) -> int:
    """Smallest j from which further future inputs explain nothing more; 0 if nothing was asked."""
    return next((j for j, rank in enumerate(ranks, 1) if rank == ranks[-1]), 0)


def rho(ranks: tuple[int, ...]) -> tuple[int, ...]:
    """Ranks of the fast part rho_1, rho_2, ... from those of `visible_ranks`."""
    return tuple(rank - ranks[-1] for rank in ranks)


def first(holds: Callable[[int], bool], last: int) -> int:
    """Smallest number in 1 .. last for which a monotone condition holds; last if only that is left."""
    low, high = 0, last
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if holds(middle) else (middle, high)
    return high


def excitation(source: Source, at_most: int) -> int:
    """Order of persistency of excitation of the inputs, all records together, up to `at_most`."""
    highest = first(lambda order: not source.wide(order), at_most + 1) - 1
    if source.exciting(highest):
        return highest
    return first(lambda order: not source.exciting(order), highest) - 1


def estimate_structure(
    u: ArrayLike, y: ArrayLike, *, noise: Noise | ArrayLike | None = 0.0, s_max: int = 4
) -> StructureEstimate:
    """Slow dimension, index, lag and fast ranks that the data show.

    With J inputs beyond the window, the outputs that the first L+j block rows of inputs leave unexplained have rank
    q + rho_j, where rho_j is the rank of the block Hankel matrix of the responses to inputs j and more samples
    ahead. The numbers are counts of singular values above the noise bound, hence lower bounds of the truth. What no
    input-output data show: unobservable or unexcited slow states, n, and r (it is at least 2 rho_1 - rho_2).

    Args:
        u: inputs, shape (T, m), starting with the outputs.
        y: outputs, shape (K, p).
        noise: on the outputs, as for `analyze`.
        s_max: largest index looked for.

    Returns:
        The estimate; zeros when the record is too short or the inputs not rich enough.

    Raises:
        ValueError: wrong shapes, values that are not finite, or s_max < 1.
    """
    if s_max < 1:
        raise ValueError(f"s_max = {s_max} must be at least 1")
    source, level = from_records([(u, y)], s_max), as_noise(noise)
    # A level to be estimated needs windows in which most directions are noise: start longer and look further.
    first_length, patience = (-(-6 // source.p), 12) if level.estimated else (1, 3)
    best, stalled, L = StructureEstimate(), 0, first_length
    while stalled < patience:
        trial = _at(source, level, L, s_max)
        if trial is None:
            break
        grown = (trial.q, sum(trial.rho)) > (best.q, sum(best.rho))
        best, stalled, L = (trial, 0, L + 1) if grown else (best, stalled + 1, L + 1)
    return best


def _at(source: Source, level: Noise, L: int, s_max: int) -> StructureEstimate | None:
    """The estimate from one window length; None when the record cannot hold it with columns to spare."""
    d = L + s_max
    if source.columns(L, d) < source.m * d + source.p * (L + 1):
        return None
    data = source.window(L, d)
    if data.inverse is None:
        return None
    noise = level.level(data, source.y_scale, 0)
    eps = level.hankel_bound(data, noise) + data.floor
    ranks = visible_ranks(data, eps)
    q = ranks[-1]
    return StructureEstimate(q=q, s=visible_index(ranks), lag=visible_lag(data, eps, q), rho=rho(ranks))
