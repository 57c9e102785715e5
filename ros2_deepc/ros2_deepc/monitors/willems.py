# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The extended fundamental lemma (Theorem 5 and Corollary 1 of the paper) as functions on data.

Corrected, Theorem 5 says: with inputs persistently exciting of order L + q + s - 1,
Im[H_1(z1); H_{L+s-1}(u)] = (R + K[z10]) x R^{m (L+s-1)}, and the windows of length L of the record span all
trajectories that start in R + O + K[z10]. No controllability is needed, and later windows of the run are among them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ros2_deepc.behavior import hankel
from ros2_deepc.behavior.hankel import as_signal

from .compress import Array
from .estimate import count, excitation
from .noise import Noise, as_noise
from .source import from_records
from .verdict import Prior


class Lengths(NamedTuple):
    """Fewest inputs T, outputs then being known for T - s + 1 samples.

    Attributes:
        rank: for the rank condition to be possible; generic inputs reach it. `analyze` asks for a sample more: data
            that fill all their columns cannot contradict the prior.
        excitation: for persistency of excitation of the order that guarantees it.
    """

    rank: int
    excitation: int


def required_length(m: int, q: int, s: int, L: int) -> Lengths:
    """Fewest inputs that make windows of length L rich: (m+1)(L+s-1)+q-1 by rank, (m+1)(L+q+s-1)-1 by excitation.

    Args:
        m: inputs, at least 1.
        q: slow dimension, at least 0.
        s: index, at least 1.
        L: window length, at least 1.

    Raises:
        ValueError: if a number is too small.
    """
    if min(m, s, L) < 1 or q < 0:
        raise ValueError(f"m = {m}, s = {s} and L = {L} must be at least 1, q = {q} at least 0")
    return Lengths((m + 1) * (L + s - 1) + q - 1, (m + 1) * (L + q + s - 1) - 1)


@dataclass(frozen=True, slots=True, kw_only=True)
class Richness:
    """Whether the windows of a record span its continuations.

    Attributes:
        by_rank: the rank is the largest possible: they span every trajectory of an R-observable plant.
        by_excitation: the inputs excite enough: they span every trajectory of this very run, whatever the plant.
        rank: of [H_{L+s-1}(u); H_L(y)], above the noise bound.
        required: rank asked for.
        excitation_order: order of persistency of excitation, up to the one needed.
        excitation_need: order needed.
        samples_missing: how many more samples the larger of both ways needs at least; 0 when long enough.
    """

    by_rank: bool
    by_excitation: bool
    rank: int
    required: int
    excitation_order: int
    excitation_need: int
    samples_missing: int

    @property
    def rich(self) -> bool:
        """Whether the record serves to predict its own continuation."""
        return self.by_rank or self.by_excitation


def richness(u: ArrayLike, y: ArrayLike, *, prior: Prior, L: int, noise: Noise | ArrayLike | None = 0.0) -> Richness:
    """Whether a record is rich enough for windows of length L.

    Args:
        u: inputs, shape (K+s-1 or more, m).
        y: outputs, shape (K, p).
        prior: q and s are used.
        L: window length, at least 1.
        noise: on the outputs, as for `analyze`.

    Raises:
        ValueError: wrong shapes, values that are not finite, or L < 1.
    """
    source, level = from_records([(u, y)], prior.s), as_noise(noise)
    m, q, d = source.m, prior.q, L + prior.s - 1
    need = required_length(m, q, prior.s, L)
    order = L + q + prior.s - 1
    have = excitation(source, order)
    rank = 0
    if source.columns(L - 1, d) >= m * d:
        data = source.window(L - 1, d)
        if data.inverse is not None:
            bound = level.hankel_bound(data, level.level(data, source.y_scale, q))
            rank = m * d + count(data.sigma, bound + data.floor)
    length = source.samples + prior.s - 1
    return Richness(
        by_rank=rank >= m * d + q,
        by_excitation=have >= order,
        rank=rank,
        required=m * d + q,
        excitation_order=have,
        excitation_need=order,
        samples_missing=max(0, need.excitation - length),
    )


@dataclass(frozen=True, slots=True)
class Parameterization:
    """How well windows of a record combine to a trajectory (paper, (5_2)).

    Attributes:
        holds: whether the residual is within the tolerance.
        residual: norm of what is left over the norm of the trajectory, each channel scaled by its size in the record.
        g: the combination of least norm, shape (columns,).
    """

    holds: bool
    residual: float
    g: Array


def parameterize(
    u_bar: ArrayLike, y_bar: ArrayLike, u: ArrayLike, y: ArrayLike, *, tolerance: float = 1e-8
) -> Parameterization:
    """Combines the windows of (u, y) to the trajectory (u_bar, y_bar) as well as possible.

    Args:
        u_bar: inputs of the trajectory, shape (L, m).
        y_bar: outputs of the trajectory, shape (L, p).
        u: inputs of the record, shape (K or more, m).
        y: outputs of the record, shape (K, p).
        tolerance: largest residual that counts as none.

    Raises:
        ValueError: if shapes do not fit, the record is shorter than L, or a value is not finite.
    """
    a, b, U, Y = as_signal(u_bar, "u_bar"), as_signal(y_bar, "y_bar"), as_signal(u, "u"), as_signal(y, "y")
    K = min(len(U), len(Y))
    L = len(a)
    if len(b) != L or a.shape[1] != U.shape[1] or b.shape[1] != Y.shape[1] or not 1 <= L <= K:
        raise ValueError(f"trajectory {a.shape}, {b.shape} does not fit windows of a record {U.shape}, {Y.shape}")
    record, trajectory = np.hstack([U[:K], Y[:K]]), np.hstack([a, b])
    scale = np.sqrt(np.mean(record**2, axis=0))
    scale = np.where(scale > 0, scale, 1.0)
    H, w = hankel(record / scale, L), (trajectory / scale).ravel()
    g, *_ = np.linalg.lstsq(H, w, rcond=None)
    size = float(np.linalg.norm(w))
    residual = float(np.linalg.norm(H @ g - w)) / size if size > 0 else 0.0
    return Parameterization(residual <= tolerance, residual, np.asarray(g))
