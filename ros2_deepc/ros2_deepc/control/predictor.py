# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""From data to a multi-step predictor, with the rank decided once and in the open.

With the rows of the data matrix grouped as inputs, context (disturbances, past outputs), future outputs, its triangular
factor is L = [L11 0 0; L21 L22 0; L31 L32 L33]. The inputs give the coordinates L11^-1 u. What is left of the context
lies in the range of L22, which on exact data has the rank of the slow part and alone carries the initial condition.
L33 is zero on exact data; it is what noise adds (the "noise block"), and it stays out of the prediction. On exact data
this is (6.1b).
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dpotrf, dsyevd, dtrtri

from ros2_deepc.behavior.hankel import Array

from .layout import Layout

EPS = float(np.finfo(np.float64).eps)


class PoorDataError(ValueError):
    """The data do not determine a predictor; the message says why."""


@dataclass(frozen=True, slots=True)
class Predictor:
    """Predicted outputs y_f = G u_f + F w, with w = [known inputs; disturbances; past outputs].

    Attributes:
        G: shape (future_y, free_u).
        F: shape (future_y, known_u + context).
        noise: y_f may be off by noise xi with xi of unit covariance: the noise block per sample, shape (future_y, any).
        state: y_f moves by state a if the context is moved by a (orthonormal) in the directions that count, (future_y,
            order).
        rank: numerical rank of the data matrix.
        order: directions of the free response kept; the slow order that the data show, if they are rich.
        gap: last singular value kept over the next one; infinity if there is none above zero.
        input_strength: lower bound of the smallest singular value of the input rows, per column of data.
        state_strength: smallest singular value kept of the free response, per column of data.
        precise: whether rounding is far below the weakest direction kept.
        doubt: norm by which noise may have moved G, by what the data leave unexplained, relative to the norm of G.
    """

    G: Array
    F: Array
    noise: Array
    state: Array
    rank: int
    order: int
    gap: float
    input_strength: float
    state_strength: float
    precise: bool
    doubt: float


@dataclass(frozen=True, slots=True)
class Truncation:
    """Which directions of the free response to keep.

    Attributes:
        how: "order" keeps at most `order` (all above rounding if 0); "gap" cuts at the largest ratio of neighbours;
            "noise" keeps what stands above `floor`; "none" keeps all above rounding.
        order: bound of the slow order.
        floor: spectral norm of the noise in the data matrix.
    """

    how: str = "order"
    order: int = 0
    floor: float = 0.0

    def keep(self, sv: Array, rounding: float) -> int:
        """How many of the falling singular values to keep."""
        alive = int(np.count_nonzero(sv > rounding))
        if self.how == "order" and self.order:
            return min(alive, self.order)
        if self.how == "noise":
            return int(np.count_nonzero(sv > max(rounding, self.floor)))
        if self.how == "gap" and alive == sv.size > 1:  # otherwise the largest gap is that to rounding
            return int(np.argmax(sv[:-1] / sv[1:])) + 1
        return alive


def triangle(W: Array) -> Array:
    """Lower-triangular L with L L' = W W', shape (rows, min(rows, columns))."""
    R: Array = np.linalg.qr(W.T, mode="r")  # type: ignore[assignment]
    return np.ascontiguousarray(R.T)


def fit(W: Array, layout: Layout, columns: int, cut: Truncation) -> Predictor:
    """Predictor from the data matrix, or from any matrix with the same W W'.

    Args:
        W: shape (rows, any), rows grouped, channels scaled alike.
        layout: the rows.
        columns: columns of the data matrix.
        cut: directions to keep.

    Raises:
        PoorDataError: if the inputs do not have full row rank.
    """
    L = triangle(W)
    nu, nc = layout.inputs, layout.context
    rounding = 10 * max(L.shape[0], columns) * EPS * float(np.linalg.norm(L))
    inverse = _inverse(L[:nu, :nu], rounding)
    rest = L[nu:, nu:]
    V, sv, Wt = np.linalg.svd(rest[:nc, :nc], full_matrices=False)
    kept = cut.keep(sv, rounding)
    rank = nu + int(np.count_nonzero(np.linalg.svd(rest, compute_uv=False) > max(rounding, cut.floor)))
    to_future = rest[nc:, :nc] @ Wt[:kept].T / sv[:kept]
    L33 = rest[nc:, nc:]
    left = float(np.sum(L33**2) + np.sum((rest[nc:, :nc] @ Wt[kept:].T) ** 2))
    return _assemble(layout, columns, inverse, L[nu:, :nu], V[:, :kept], sv, to_future, L33, left, rank, rounding)


def fit_gram(S: Array, layout: Layout, columns: int, cut: Truncation, noise_block: bool) -> Predictor:
    """Predictor from the Gram matrix S = W W' of the data matrix: much faster than `fit`, with half the digits.

    Args:
        S: shape (rows, rows), rows grouped, channels scaled alike.
        layout: the rows.
        columns: columns of the data matrix.
        cut: directions to keep.
        noise_block: whether the noise block is wanted.

    Raises:
        PoorDataError: if the inputs do not have full row rank.
    """
    nu, nc = layout.inputs, layout.context
    rounding = float(np.sqrt(10 * S.shape[0] * EPS * np.trace(S)))
    L11, flag = dpotrf(S[:nu, :nu], lower=1, clean=1)
    if flag != 0:
        raise PoorDataError(f"the inputs do not excite: their Gram matrix is singular in row {flag}")
    inverse = _inverse(L11, rounding)
    below = S[nu:, :nu] @ inverse.T
    M = S[nu:, nu:] - below @ below.T
    squares, V, _ = dsyevd(M[:nc, :nc])
    sv, V = np.sqrt(np.maximum(squares[::-1], 0.0)), V[:, ::-1]
    kept = cut.keep(sv, rounding)
    to_future = (M[nc:, :nc] @ V[:, :kept]) / sv[:kept] ** 2
    L33 = np.zeros((layout.future_y, 0))
    left = float(np.trace(M[nc:, nc:]) - np.sum((to_future * sv[:kept]) ** 2))
    if noise_block:
        energy, U = np.linalg.eigh(M[nc:, nc:] - (to_future * sv[:kept] ** 2) @ to_future.T)
        L33 = U * np.sqrt(np.maximum(energy, 0.0))
    return _assemble(layout, columns, inverse, below, V[:, :kept], sv, to_future, L33, left, nu + kept, rounding)


def fit_causal(W: Array, layout: Layout, columns: int, cut: Truncation) -> Predictor:
    """Predictor in which y(k+j) never leans on inputs later than those that shape it.

    On closed-loop data later inputs answer to earlier noise, and a joint regression takes the answer for a cause. Here
    each future instant is regressed on the past and on the instants before it, with their prediction errors left out,
    as in transient predictive control (Moffat, Dorfler, Chiuso 2025). On exact data it equals `fit`.

    Args:
        W: shape (rows, any), rows grouped, channels scaled alike; see `fit` for all arguments.
        layout: the rows.
        columns: columns of the data matrix.
        cut: directions to keep.

    Raises:
        PoorDataError: if the inputs do not have full row rank.
    """
    joint = fit(W, layout, columns, cut)
    L = triangle(W[layout.causal])
    L = np.hstack([L, np.zeros((L.shape[0], L.shape[0] - L.shape[1]))])
    known, past = layout.known_u, layout.past
    place = np.empty_like(layout.causal)
    place[layout.causal] = np.arange(place.size)  # where a grouped row has gone
    u_rows = place[known : known + layout.free_u]
    y_rows = place[layout.inputs + layout.context :]
    rounding = 10 * max(L.shape[0], columns) * EPS * float(np.linalg.norm(L))
    K_known = _inverse(L[:known, :known], rounding)
    V, sv, Wt = np.linalg.svd(L[known:past, known:past])
    kept = cut.keep(sv, rounding)
    # coordinates of the past: first those of the known inputs, then the directions of the context that are kept
    from_context = (Wt[:kept].T / sv[:kept]) @ V[:, :kept].T
    to_past = np.block(
        [
            [K_known, np.zeros((known, past - known))],
            [-from_context @ L[known:past, :known] @ K_known, from_context],
        ]
    )
    U = _inverse(L[np.ix_(u_rows, u_rows)], rounding)  # innovations of the inputs, given what came before
    G = L[np.ix_(y_rows, u_rows)] @ U
    F = (L[y_rows, :past] - G @ L[u_rows, :past]) @ to_past
    return Predictor(
        G,
        F,
        joint.noise,
        joint.state,
        joint.rank,
        kept,
        joint.gap,
        joint.input_strength,
        joint.state_strength,
        joint.precise,
        joint.doubt,
    )


def _inverse(L11: Array, rounding: float) -> Array:
    """Inverse of the inputs' triangle."""
    if L11.shape[0] != L11.shape[1]:
        raise PoorDataError(
            f"{L11.shape[1]} columns of data cannot hold {L11.shape[0]} input rows: more samples needed"
        )
    diagonal = np.abs(np.diag(L11))
    if diagonal.size and diagonal.min() <= rounding:
        raise PoorDataError("the inputs do not excite of the order needed: richer inputs are needed")
    inverse, flag = dtrtri(L11, lower=1)
    if flag != 0:
        raise PoorDataError("the inputs do not excite of the order needed: richer inputs are needed")
    return np.asarray(inverse)


def _assemble(
    layout: Layout,
    columns: int,
    inverse: Array,
    below: Array,
    V: Array,
    sv: Array,
    to_future: Array,
    L33: Array,
    left: float,
    rank: int,
    rounding: float,
) -> Predictor:
    """The predictor from the parts of the factor.

    below = [L21; L31], to_future maps free coordinates to outputs, left is the energy that these leave unexplained.
    """
    nc, kept = layout.context, V.shape[1]
    from_context = to_future @ V.T
    from_inputs = (below[nc:] - from_context @ below[:nc]) @ inverse
    weakest = float(sv[kept - 1]) if kept else 0.0
    following = float(sv[kept]) if kept < sv.size else 0.0
    root, spread = np.sqrt(columns), float(np.linalg.norm(inverse))
    G = from_inputs[:, layout.known_u :]
    noise = max(left, 0.0) / max(columns - layout.inputs - kept, 1)  # variance per sample, all future outputs together
    return Predictor(
        G=G,
        F=np.hstack([from_inputs[:, : layout.known_u], from_context]),
        noise=L33 / root,
        state=to_future,
        rank=rank,
        order=kept,
        gap=weakest / following if following > 0 else np.inf,
        input_strength=1.0 / (spread * root),
        state_strength=weakest / root,
        precise=kept == 0 or weakest > 1e2 * rounding,
        doubt=float(np.sqrt(noise)) * spread / max(float(np.linalg.norm(G)), EPS),
    )
