# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Splitting the infinite eigenvalues off a pencil zE - A by rank decisions.

Infinite eigenvalues of index s come out of QZ as finite ones of size eps^(-1/s): no threshold on QZ's output finds
them. The staircase here decides ranks on the data instead, by orthogonal transformations with exact zeros imposed: what
it returns is the exact split of a pencil within rounding of the given one (Van Dooren, Linear Algebra Appl. 27, 1979).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg
from scipy.linalg import lapack

from .arrays import Array
from .errors import NotRegularError

EPS = float(np.finfo(np.float64).eps)


@dataclass(frozen=True, slots=True, kw_only=True)
class RankDecision:
    """One rank decision of the staircase: singular values relative to the norm of the equilibrated E."""

    size: int
    rank: int
    kept: float
    dropped: float
    tolerance: float

    @property
    def clear(self) -> bool:
        """Whether nothing lies near the tolerance: the smallest kept value stands 1e3 above what was dropped."""
        return self.kept >= 10 * self.tolerance and self.kept >= 1e3 * self.dropped


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Deflation:
    """U' diag(rows) (E, A) diag(cols) V = ([E11 E12; 0 E22], [A11 A12; 0 A22]), infinite part first.

    E11 is strictly upper block triangular (nilpotent against A11), A11 upper triangular and regular, E22 regular.
    """

    r: int
    stages: tuple[int, ...]
    U: Array
    V: Array
    E: Array
    A: Array
    rows: Array
    cols: Array
    decisions: tuple[RankDecision, ...]


def equilibrate(E: Array, A: Array, sweeps: int = 3) -> tuple[Array, Array]:
    """Powers of two that bring the largest entry of every row and column of (E, A) near 1; shapes (n,), (n,)."""
    size = np.maximum(np.abs(E), np.abs(A))
    rows, cols = np.ones(len(E)), np.ones(len(E))
    for _ in range(sweeps):
        for axis, scale in ((1, rows), (0, cols)):
            largest = (size * rows[:, None] * cols).max(axis=axis, initial=0.0)
            if not largest.all():
                what, i = ("row", "equation") if axis == 1 else ("column", "unknown")
                index = int(np.flatnonzero(largest == 0)[0])
                raise NotRegularError(
                    f"{what} {index} of E and A is zero: {i} {index} does not take part in the system"
                )
            scale *= 2.0 ** -np.round(np.log2(largest))
    return rows, cols


@dataclass(frozen=True, slots=True, eq=False)
class _Columns:
    """An orthogonal change of columns: the ``still`` ones first, untouched, then ``moved`` @ ``W``."""

    still: NDArray[np.intp]
    moved: NDArray[np.intp]
    W: Array

    def apply(self, X: Array) -> Array:
        return np.hstack([X[:, self.still], X[:, self.moved] @ self.W])


def _null_space(E: Array, tolerance: float, norm: float) -> tuple[_Columns, RankDecision]:
    """Columns V with E V = [0, E'], null space first, and the decision; zero rows and columns need no arithmetic."""
    nonzero = E != 0
    columns, rows = nonzero.any(axis=0), np.flatnonzero(nonzero.any(axis=1))
    dead, live = np.flatnonzero(~columns), np.flatnonzero(columns)
    if not len(live):
        none = _Columns(dead, live, np.empty((0, 0)))
        return none, RankDecision(size=len(E), rank=0, kept=np.inf, dropped=0.0, tolerance=tolerance)
    _, sigma, Wt = linalg.svd(E[np.ix_(rows, live)])
    rank = int((sigma > tolerance * norm).sum())
    return _Columns(dead, live, Wt[::-1].T), RankDecision(
        size=len(E),
        rank=rank,
        kept=float(sigma[rank - 1] / norm) if rank else np.inf,
        dropped=float(sigma[rank] / norm) if rank < len(sigma) else 0.0,
        tolerance=tolerance,
    )


def _compress(block: Array, norm: float, tolerance: float) -> tuple[Array, Array]:
    """QR factors of a block that must have full column rank: Q of shape (k, k), R of shape (columns, columns).

    Raises:
        NotRegularError: if it has not; then the null vectors of E and A meet.
    """
    Q, R = linalg.qr(block)
    R = R[: block.shape[1]]
    weakest = float(lapack.dtrcon(R)[0]) * float(linalg.norm(R, 1)) / norm if norm > 0 else 0.0
    if not weakest > tolerance:
        raise NotRegularError(
            f"the pencil zE - A is singular: det(zE - A) vanishes for every z after a relative change of {weakest:.1e} "
            "of A (an unknown is missing from the equations, or an equation is repeated)"
        )
    return np.asarray(Q, dtype=np.float64), np.asarray(R, dtype=np.float64)


def deflate(E: Array, A: Array, tolerance: float | None = None) -> Deflation:
    """Splits the infinite eigenvalues of zE - A off.

    Args:
        E: shape (n, n).
        A: shape (n, n).
        tolerance: singular values of the equilibrated E, and of its parts, count as zero up to this fraction of its
            Frobenius norm; default 100 n eps.

    Raises:
        NotRegularError: if det(zE - A) = 0 for all z, up to a perturbation of size tolerance.
    """
    n = len(E)
    tolerance = 100 * n * EPS if tolerance is None else tolerance
    rows, cols = equilibrate(E, A)
    E, A = E * rows[:, None] * cols, A * rows[:, None] * cols
    norm_E, norm_A = float(linalg.norm(E)) or 1.0, float(linalg.norm(A))
    U, V = np.eye(n), np.eye(n)
    start, stages, decisions = 0, [], []
    while start < n:
        columns, decision = _null_space(E[start:, start:], tolerance, norm_E)
        decisions.append(decision)
        nullity = decision.size - decision.rank
        if nullity == 0:
            break
        stop = start + nullity
        for X in (E, A, V):
            X[:, start:] = columns.apply(X[:, start:])
        Q, R = _compress(A[start:, start:stop], norm_A, tolerance)
        E[start:, stop:], A[start:, stop:] = Q.T @ E[start:, stop:], Q.T @ A[start:, stop:]
        E[start:, start:stop], A[start:, start:stop] = 0.0, 0.0
        A[start:stop, start:stop] = np.triu(R)
        U[:, start:] = U[:, start:] @ Q if start else Q
        stages.append(nullity)
        start = stop
    return Deflation(
        r=start, stages=tuple(stages), U=U, V=V, E=E, A=A, rows=rows, cols=cols, decisions=tuple(decisions)
    )  # fmt: skip
