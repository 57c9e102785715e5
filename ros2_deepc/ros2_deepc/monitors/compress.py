# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The LQ factor of a data window: all that the tests need, whatever the length of the record."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla
from numpy.typing import NDArray

Array = NDArray[np.float64]

EPS = float(np.finfo(np.float64).eps)
ROUNDING = 10
"""Factor of all rounding bounds: rounding itself stayed 40 dB below them in thousands of random plants."""

EXCITATION_RCOND = 100 * EPS
"""Inputs whose triangular factor is closer to singular than this do not count as persistently exciting."""


@dataclass(frozen=True, slots=True)
class Compression:
    """Factor [R11 0; R21 R22] of [H_d(u); H_{L+1}(y)], orthogonal columns removed.

    Attributes:
        R11: inputs, lower triangular, shape (m d, m d).
        R21: what the outputs share with the inputs, shape (p (L+1), m d).
        inverse: of R11; None when the inputs are not persistently exciting of order d.
        directions: left singular vectors times singular values of what the outputs do not share, shape (p (L+1), k).
        sigma: those singular values, shape (k,).
        m: inputs.
        p: outputs.
        L: output block rows of the pencils, one less than in the window.
        columns: columns of the data matrix.
        spread: what white noise of the columns kept amounts to: their number, when all are kept.
        norm: Frobenius norm of the data matrix.
    """

    R11: Array
    R21: Array
    inverse: Array | None
    directions: Array
    sigma: Array
    m: int
    p: int
    L: int
    columns: int
    spread: float
    norm: float

    @property
    def d(self) -> int:
        """Input block rows of the window."""
        return int(self.R11.shape[0]) // self.m

    @property
    def floor(self) -> float:
        """Backward-error bound of the factorisation: singular values below it are rounding."""
        return ROUNDING * EPS * float(np.sqrt(self.R11.shape[0] + self.R21.shape[0])) * self.norm

    def spare(self, q: int) -> tuple[int, int]:
        """Output rows and columns beyond those that q directions fill: only they can contradict the prior."""
        return len(self.directions) - q, self.columns - len(self.R11) - q

    def per_input(self, rows: Array) -> Array:
        """Solves J R11 = rows, row by row backward stable."""
        return np.asarray(sla.solve_triangular(self.R11, rows.T, lower=True, trans="T", check_finite=False).T)


def compress(
    W: Array, m: int, p: int, L: int, columns: int, instruments: int = 0, pieces: Sequence[int] = ()
) -> Compression:
    """Compresses a data matrix [H_d(u); instruments; H_{L+1}(y)], block rows in time order.

    With instruments (inputs before the window) only that share of the columns is kept which they and the inputs
    explain. They are free of noise, so that averaging along the record lets less noise through; what it hides of the
    signal can only lower singular values.

    Args:
        W: the data matrix, or any matrix with the same Gram matrix, shape (m d + instruments + p (L+1), c).
        m: inputs.
        p: outputs.
        L: output block rows of the pencils.
        columns: columns of the data matrix before any earlier compression, usually c.
        instruments: rows of instruments; needs the data matrix itself, columns in time order.
        pieces: columns of each record, when there are several; only used with instruments.

    Raises:
        ValueError: if there are fewer columns than input rows.
    """
    kept = W.shape[0] - p * (L + 1)
    a = kept - instruments
    if W.shape[1] < kept:
        raise ValueError(f"{W.shape[1]} columns cannot excite {kept} input rows: record longer or take a smaller L")
    norm = float(np.linalg.norm(W))
    if not instruments:
        R = triangle(W)
        return split(R[:a, :a], R[a:, :a], R[a:, a:], m, p, L, columns, float(columns), norm)
    Q, R = np.linalg.qr(W[:kept].T)
    Y = W[kept:] @ Q
    spread = toeplitz_norm(np.split(Q, np.cumsum(pieces, dtype=int)[:-1]), L + 1)
    return split(R[:a, :a].T, Y[:, :a], Y[:, a:], m, p, L, columns, spread, norm)


def split(
    R11: Array, R21: Array, R22: Array, m: int, p: int, L: int, columns: int, spread: float, norm: float
) -> Compression:
    """A compression from its factor [R11 0; R21 R22]; see `Compression` for the others."""
    left, sigma, _ = np.linalg.svd(R22, full_matrices=False)
    inverse = np.asarray(sla.lapack.dtrtri(R11, lower=1)[0]) if excites(R11) else None
    return Compression(R11, R21, inverse, left * sigma, sigma, m, p, L, columns, spread, norm)


def triangle(W: Array) -> Array:
    """Lower triangular factor R of W = R Q, shape (rows, min(rows, columns))."""
    order = min(W.shape)
    packed, _, _, info = sla.lapack.dgeqrf(W.T, lwork=64 * max(1, W.shape[0]))
    if info:
        raise np.linalg.LinAlgError(f"dgeqrf: argument {-info}")
    return np.tril(packed[:order].T)


def excites(R11: Array) -> bool:
    """Whether a lower triangular factor of an input Hankel matrix has full rank to working precision."""
    rcond, info = sla.lapack.dtrcon(R11, uplo="L")
    return info == 0 and bool(rcond > EXCITATION_RCOND)


def toeplitz_norm(pieces: Sequence[Array], rows: int) -> float:
    """Spectral norm of the Toeplitz matrix of the diagonal sums of the projector V V'.

    It takes the place of the number of columns of a Hankel matrix of white noise when only the directions V are kept.

    Args:
        pieces: rows of V by record, each in time order, shape (c_i, k); the columns of V are orthonormal.
        rows: order of the Toeplitz matrix.
    """
    sums = np.zeros(rows)
    for V in filter(len, pieces):  # a record may be too short for a column
        spectrum = np.sum(abs(np.fft.rfft(V, 2 * len(V), axis=0)) ** 2, axis=1)
        part = np.fft.irfft(spectrum)[: min(rows, len(V))]
        sums[: part.size] += part
    return float(np.linalg.norm(sla.toeplitz(sums), 2))
