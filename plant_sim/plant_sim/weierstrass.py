# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The quasi-Weierstrass form of a regular pencil, by orthogonal staircase, QZ and one coupled Sylvester equation."""

from dataclasses import dataclass

import numpy as np
from scipy import linalg
from scipy.linalg import lapack

from .arrays import Array, frozen
from .deflate import Deflation, RankDecision
from .errors import UnclearStructureError


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Weierstrass:
    """S E P = diag(I_q, N), S A P = diag(A1, I_r), S B = [B1; B2], C P = [C1, C2] (paper, section 2).

    The form is unique up to a change of basis in each part; here the slow columns of P are orthonormal, so are
    the fast ones.

    Attributes:
        q: number of finite eigenvalues, the order of the slow part.
        r: number of infinite eigenvalues, n - q.
        s: nilpotency index of N (1 if r = 0): y(k) depends on u(k), ..., u(k+s-1).
        S: shape (n, n).
        P: shape (n, n).
        A1: shape (q, q).
        B1: shape (q, m).
        C1: shape (p, q).
        N: shape (r, r).
        B2: shape (r, m).
        C2: shape (p, r).
        D: shape (p, m).
        decisions: the rank decisions behind r and s.
        pencil: (E, A).
    """

    q: int
    r: int
    s: int
    S: Array
    P: Array
    A1: Array
    B1: Array
    C1: Array
    N: Array
    B2: Array
    C2: Array
    D: Array
    decisions: tuple[RankDecision, ...]
    pencil: tuple[Array, Array]

    @property
    def residuals(self) -> tuple[float, float]:
        """Largest entries of |S E P - diag(I, N)| and of |S A P - diag(A1, I)|."""
        E, A = self.pencil
        targets = linalg.block_diag(np.eye(self.q), self.N), linalg.block_diag(self.A1, np.eye(self.r))
        first, second = (self.S @ M @ self.P - target for M, target in zip((E, A), targets, strict=True))
        return float(np.abs(first).max(initial=0.0)), float(np.abs(second).max(initial=0.0))

    def markov(self) -> Array:
        """P_i with y(k) = C1 z1(k) + sum_i P_i u(k+i): P_0 = D - C2 B2, P_i = -C2 N^i B2; shape (s, p, m)."""
        out, block = np.empty((self.s, *self.D.shape)), self.B2
        for i in range(self.s):
            out[i] = -self.C2 @ block
            block = self.N @ block
        out[0] += self.D
        return out


def require_clear(decisions: tuple[RankDecision, ...]) -> None:
    """Raises UnclearStructureError if a rank decision has no gap around it."""
    for stage, d in enumerate(decisions, 1):
        if not d.clear:
            raise UnclearStructureError(
                f"finite and infinite eigenvalues cannot be told apart: at stage {stage} E has a relative singular "
                f"value {d.kept:.1e} (next {d.dropped:.1e}, tolerance {d.tolerance:.1e}); pass "
                "weierstrass(tolerance=...) above or below it to decide"
            )


def _decouple(d: Deflation) -> tuple[Array, Array, Array]:
    """Block-diagonalises the deflated pencil: bases (left, right) of shape (n, n), infinite part first; E22."""
    n, r = len(d.E), d.r
    left, right = d.U.T * d.rows, d.cols[:, None] * d.V
    if r == n:
        return left, right, np.empty((0, 0))
    A22, E22, Q, Z = linalg.qz(d.A[r:, r:], d.E[r:, r:], output="real")
    left[r:], right[:, r:] = Q.T @ left[r:], right[:, r:] @ Z
    if r > 0:
        A12, E12 = d.A[:r, r:] @ Z, d.E[:r, r:] @ Z
        # A11 X - Y A22 = -A12, E11 X - Y E22 = -E12
        X, Y, scale, _, info = lapack.dtgsyl(d.A[:r, :r], A22, -A12, d.E[:r, :r], E22, -E12)
        if info > 0 or scale == 0:
            raise UnclearStructureError("finite and infinite eigenvalues lie too close together to be separated")
        right[:, r:] += right[:, :r] @ (X / scale)
        left[:r] -= (Y / scale) @ left[r:]
    return left, right, np.asarray(E22, dtype=np.float64)


def _orthonormal(basis: Array) -> tuple[Array, Array]:
    """Economic QR factors of ``basis``, shape (n, k); k may be 0."""
    if not basis.shape[1]:
        return basis, np.empty((0, 0))
    Q, R = linalg.qr(basis, mode="economic")
    return np.asarray(Q, dtype=np.float64), np.asarray(R, dtype=np.float64)


def _nilpotent(A11: Array, E11: Array, R: Array) -> Array:
    """R A11^-1 E11 R^-1 by triangular solves, which keep its zeros: N^s vanishes to the last bit."""
    if not len(R):
        return R
    inner = linalg.solve_triangular(A11, E11)
    return np.ascontiguousarray(linalg.solve_triangular(R, (R @ inner).T, trans="T").T)


def weierstrass(E: Array, A: Array, B: Array, C: Array, D: Array, deflation: Deflation) -> Weierstrass:
    """Computes the quasi-Weierstrass form from the deflated pencil.

    Args:
        E: shape (n, n).
        A: shape (n, n).
        B: shape (n, m).
        C: shape (p, n).
        D: shape (p, m).
        deflation: result of `deflate(E, A)`.

    Raises:
        UnclearStructureError: if a finite and an infinite eigenvalue are too close to be separated.
    """
    n, r = len(E), deflation.r
    q = n - r
    left, right, E22 = _decouple(deflation)
    fast, R2 = _orthonormal(right[:, :r])
    slow, R1 = _orthonormal(right[:, r:])
    # right[:, r:] = slow R1, so z1 = R1 (old coordinates): S rows for the slow part are R1 E22^-1 left
    S = np.vstack([
        R1 @ linalg.solve_triangular(E22, left[r:]) if q else left[:0],
        R2 @ linalg.solve_triangular(deflation.A[:r, :r], left[:r]) if r else left[:0],
    ])  # fmt: skip
    P = np.hstack([slow, fast])
    A1: Array = S[:q] @ A @ slow
    N = _nilpotent(deflation.A[:r, :r], deflation.E[:r, :r], R2)
    SB, CP = S @ B, C @ P
    return Weierstrass(
        q=q, r=r, s=max(1, len(deflation.stages)),
        S=frozen(S), P=frozen(P), A1=frozen(A1), N=frozen(N), D=D,
        B1=frozen(SB[:q]), B2=frozen(SB[q:]), C1=frozen(CP[:, :q]), C2=frozen(CP[:, q:]),
        pencil=(E, A),
        decisions=deflation.decisions,
    )  # fmt: skip
