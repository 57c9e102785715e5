# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Splitting the infinite eigenvalues off a pencil zE - A by rank decisions.

Infinite eigenvalues of index s come out of QZ as finite ones of size eps^(-1/s): no threshold on QZ's output finds
them. The staircase here decides ranks on the data instead, by orthogonal transformations with exact zeros imposed: what
it returns is the exact split of a pencil within rounding of the given one (Van Dooren, Linear Algebra Appl. 27, 1979).
"""

from dataclasses import dataclass

import numpy as np
from scipy import linalg

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


def _null_space(E: Array, tolerance: float, norm: float) -> tuple[Array, RankDecision]:
    """Orthogonal V with E V = [0, E'], null space first, and the decision. Exact zero columns need no arithmetic."""
    size = len(E)
    live = np.flatnonzero(E.any(axis=0))
    dead = np.flatnonzero(~E.any(axis=0))
    live_rows = np.flatnonzero(E.any(axis=1))
    V = np.zeros((size, size))
    V[dead, np.arange(len(dead))] = 1.0
    if not len(live):
        return V, RankDecision(size=size, rank=0, kept=np.inf, dropped=0.0, tolerance=tolerance)
    _, sigma, Wt = linalg.svd(E[np.ix_(live_rows, live)])
    rank = int((sigma > tolerance * norm).sum())
    V[np.ix_(live, np.arange(len(dead), size))] = Wt[::-1].T
    dropped = float(sigma[rank] / norm) if rank < len(sigma) else 0.0
    kept = float(sigma[rank - 1] / norm) if rank else np.inf
    return V, RankDecision(size=size, rank=rank, kept=kept, dropped=dropped, tolerance=tolerance)


def deflate(E: Array, A: Array, tolerance: float | None = None) -> Deflation:
    """Splits the infinite eigenvalues of zE - A off.

    Args:
        E: shape (n, n).
        A: shape (n, n).
        tolerance: a singular value of the equilibrated E (or a part of it) counts as zero up to tolerance * norm(E);
            default 100 n eps.

    Raises:
        NotRegularError: if det(zE - A) = 0 for all z, up to a perturbation of size tolerance.
    """
    n = len(E)
    tolerance = 100 * n * EPS if tolerance is None else tolerance
    rows, cols = equilibrate(E, A)
    E, A = E * rows[:, None] * cols, A * rows[:, None] * cols
    U, V = np.eye(n), np.eye(n)
    norm_E, norm_A = float(linalg.norm(E, 2)) if E.any() else 1.0, float(linalg.norm(A, 2))
    start, stages, decisions = 0, [], []
    while start < n:
        W, decision = _null_space(E[start:, start:], tolerance, norm_E)
        decisions.append(decision)
        nullity = decision.size - decision.rank
        if nullity == 0:
            break
        stop = start + nullity
        E[:, start:], A[:, start:], V[:, start:] = E[:, start:] @ W, A[:, start:] @ W, V[:, start:] @ W
        Q, R = linalg.qr(A[start:, start:stop])
        weakest = float(linalg.svd(R[:nullity], compute_uv=False)[-1]) / max(norm_A, 1e-300)
        if weakest <= tolerance:
            raise NotRegularError(
                f"the pencil zE - A is singular: det(zE - A) vanishes for every z after a relative "
                f"change of {weakest:.1e} of A (an unknown is missing from the equations, or an equation is repeated)"
            )
        E[start:], A[start:], U[:, start:] = Q.T @ E[start:], Q.T @ A[start:], U[:, start:] @ Q
        E[start:, start:stop], A[start:, start:stop] = 0.0, np.triu(R)
        stages.append(nullity)
        start = stop
    return Deflation(
        r=start, stages=tuple(stages), U=U, V=V, E=E, A=A, rows=rows, cols=cols, decisions=tuple(decisions)
    )  # fmt: skip
