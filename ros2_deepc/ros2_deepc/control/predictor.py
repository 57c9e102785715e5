# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""From data to a multi-step predictor, with the rank decided once and in the open."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from ros2_deepc.behavior.hankel import Array

EPS = float(np.finfo(np.float64).eps)


@dataclass(frozen=True, slots=True)
class Blocks:
    """Where the rows of the data matrix [H(u); H(y)] belong.

    Attributes:
        known_u: scalar rows of inputs known at the time of a step: past and committed.
        free_u: scalar rows of planned inputs.
        past_y: scalar rows of past outputs.
        future_y: scalar rows of predicted outputs.
    """

    known_u: int
    free_u: int
    past_y: int
    future_y: int

    @property
    def inputs(self) -> int:
        """Scalar rows of inputs."""
        return self.known_u + self.free_u


@dataclass(frozen=True, slots=True)
class Predictor:
    """Predicted outputs y_f = G u_f + F w, with w = [known inputs; past outputs].

    Attributes:
        G: shape (future_y, free_u).
        F: shape (future_y, known_u + past_y).
        rank: numerical rank of the data matrix.
        order: directions of the free response kept (the slow order that the data show, if rich).
        gap: last singular value kept over the first one dropped; infinity if none was dropped or the next one is zero.
    """

    G: Array
    F: Array
    rank: int
    order: int
    gap: float


def channel_scale(u: Array, y: Array) -> tuple[Array, Array]:
    """Root mean square of each channel, 1 for a channel that is zero; shapes (m,) and (p,)."""
    scales = []
    for w in (u, y):
        rms = np.sqrt(np.mean(np.square(w), axis=0))
        scales.append(np.where(rms > 0, rms, 1.0))
    return scales[0], scales[1]


def triangle(W: Array) -> Array:
    """Lower-triangular factor of the data matrix: L with L L' = W W', shape (rows, min(rows, columns))."""
    R: Array = np.linalg.qr(W.T, mode="r")  # type: ignore[assignment]
    return np.ascontiguousarray(R.T)


def fit(L: Array, blocks: Blocks, columns: int, order: int = 0, floor: float = 0.0) -> Predictor:
    """Predictor from the triangular factor of the data matrix (rows: inputs, past outputs, future outputs).

    With L = [L11 0 0; L21 L22 0; L31 L32 L33], inputs u give the coordinates L11^-1 u; what is left of the past outputs
    lies in the range of L22, whose rank is the slow order on exact data and which alone carries the initial condition.
    L33 is zero on exact data; it is what noise adds, and it is left out. On exact data this is (6.1b).

    Args:
        L: factor, shape (rows, min(rows, columns)), channels scaled alike.
        blocks: the rows.
        columns: columns of the data matrix.
        order: keep at most this many directions of the free response; 0 for as many as stand above the floor.
        floor: size of noise in the data matrix (spectral norm); directions below it are dropped.

    Raises:
        ValueError: if the inputs do not have full row rank.
    """
    nu, ni = blocks.inputs, blocks.past_y
    largest = float(np.linalg.norm(L, 2))
    rounding = 10 * max(L.shape[0], columns) * EPS * largest
    L11 = L[:nu, :nu]
    if L.shape[1] < nu or np.linalg.svd(L11, compute_uv=False)[-1] <= rounding:
        raise ValueError(f"the inputs do not excite of order {nu}: more samples or richer inputs are needed")
    rest = np.linalg.svd(L[nu:, nu:], compute_uv=False)
    rank = nu + int(np.count_nonzero(rest > max(rounding, floor)))
    Ui, si, Vi = np.linalg.svd(L[nu : nu + ni, nu : nu + ni], full_matrices=False)
    kept = int(np.count_nonzero(si > max(rounding, floor)))
    if order:
        kept = min(kept, order)
    below = si[kept] if kept < si.size else 0.0
    gap = float(si[kept - 1] / below) if kept and below > 0 else np.inf
    from_past = (L[nu + ni :, nu : nu + ni] @ Vi[:kept].T / si[:kept]) @ Ui[:, :kept].T
    from_inputs = solve_triangular(
        L11, (L[nu + ni :, :nu] - from_past @ L[nu : nu + ni, :nu]).T, lower=True, trans="T"
    ).T
    F = np.hstack([from_inputs[:, : blocks.known_u], from_past])
    return Predictor(np.ascontiguousarray(from_inputs[:, blocks.known_u :]), F, rank, kept, gap)


def unscale(predictor: Predictor, u_scale: Array, y_scale: Array, blocks: Blocks) -> Predictor:
    """The predictor in the units of the channels."""
    m, p = u_scale.size, y_scale.size
    future = np.tile(y_scale, blocks.future_y // p)[:, None]
    known = np.concatenate([np.tile(u_scale, blocks.known_u // m), np.tile(y_scale, blocks.past_y // p)])
    G = future * predictor.G / np.tile(u_scale, blocks.free_u // m)
    return Predictor(G, future * predictor.F / known, predictor.rank, predictor.order, predictor.gap)
