# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""A look at the modes alone, cheap enough for every sample. It warns; it proves nothing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .compress import Array, Compression
from .modal import eigenvalues
from .noise import Noise, as_noise
from .pencil import reduce
from .source import from_records
from .theorems import decibel, threshold
from .verdict import Prior


@dataclass(frozen=True, slots=True, kw_only=True)
class Indicator:
    """Margins met at the modes of the data; upper bounds of those that `analyze` reports for the same window.

    Attributes:
        controllability: margin at the weakest mode [dB]; -inf when fewer than q directions are seen.
        observability: margin of the q-th direction [dB].
        lambda_star: the weakest mode; nan when none is seen.
        rank: of the data matrix.
        rank_need: rank of a rich window of an observable plant.
        reason: why nothing could be said; empty otherwise.
    """

    controllability: float = -np.inf
    observability: float = -np.inf
    lambda_star: complex = complex("nan")
    rank: int = 0
    rank_need: int = 0
    reason: str = ""


def indicate(u: ArrayLike, y: ArrayLike, *, prior: Prior, L: int, noise: Noise | ArrayLike | None = 0.0) -> Indicator:
    """Margins of the slow part at the modes that the data show: one factorisation and one small eigenvalue problem.

    Args:
        u: inputs, as for `analyze`.
        y: outputs, as for `analyze`.
        prior: what is known of the plant; only q and s are used.
        L: output block rows of the pencil.
        noise: as for `analyze`.

    Raises:
        ValueError: wrong shapes, or values that are not finite.
    """
    source, d = from_records([(u, y)], prior.s), L + prior.s
    missing = source.m * d + prior.q + 1 - source.columns(L, d)
    if missing > 0:
        return too_short(missing, source.m * d + prior.q, L)
    return margins(source.window(L, d), source.y_scale, prior.q, as_noise(noise))


def too_short(missing: int, need: int, L: int) -> Indicator:
    """What is said of a window that cannot show the rank."""
    return Indicator(rank_need=need, reason=f"at least {missing} more samples needed at L = {L}")


def margins(data: Compression, y_scale: Array, q: int, noise: Noise) -> Indicator:
    """The indicator of a compressed window.

    Args:
        data: the window, scaled, with at least one column more than the rank.
        y_scale: output units per scaled unit, shape (p,).
        q: slow dimension.
        noise: on the outputs.
    """
    m, d = data.m, data.d
    need = m * d + q
    if data.inverse is None:
        return Indicator(rank_need=need, reason=f"the inputs are not persistently exciting of order {d}")
    try:
        eps = threshold(data, q, noise.hankel_bound(data, noise.level(data, y_scale, q)))
    except ValueError as error:
        return Indicator(rank_need=need, reason=str(error))
    seen = int(np.count_nonzero(data.sigma > eps))
    rank = m * d + seen
    if not min(seen, q):
        return Indicator(rank=rank, rank_need=need, reason="no direction rises above the noise bound")
    observe = decibel(float(data.sigma[q - 1]), eps) if q <= data.sigma.size else -np.inf
    pencil = reduce(data, min(seen, q))
    modes = eigenvalues(pencil)
    modes = modes[modes.imag >= 0]  # conjugates are equally strong
    strength = pencil.singular_values(modes)[:, -1]
    weakest = int(np.argmin(strength))
    control = decibel(float(strength[weakest]), eps + pencil.floor) if seen >= q else -np.inf
    return Indicator(
        controllability=control,
        observability=observe,
        lambda_star=complex(modes[weakest]),
        rank=rank,
        rank_need=need,
    )
