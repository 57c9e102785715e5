# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The shifted data pencil, reduced to a small matrix function of lambda.

The pencil (S1 - lambda S0)[U; Y] has rank m (d-1) + rank(Y(lambda) Pi), where Pi projects on the kernel of U(lambda):
the inputs of the form v lambda^k. So it is enough to follow a q x (m+q) matrix N(lambda). Its smallest singular value
over the norm of S1 - lambda S0, called kappa, is a lower bound of that of Y(lambda) Pi over the same, and moves by at
most the norm of the noise Hankel matrix.

lambda lives on the Riemann sphere: it is t in the inner chart, 1/t in the outer one; kappa has the same form in both.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .compress import EPS, ROUNDING, Array, Compression

Complex = NDArray[np.complex128]
Mask = NDArray[np.bool_]


class Points(NamedTuple):
    """Points of the sphere: lambda = t in the inner chart, 1/t in the outer one; both arrays of shape (k,)."""

    t: Complex
    outer: Mask

    @property
    def lambda_(self) -> Complex:
        """The points as complex numbers, inf where t = 0 in the outer chart."""
        zero = self.outer & (self.t == 0)
        inverse = np.where(zero, np.inf, 1 / np.where(self.t == 0, 1, self.t))
        return np.where(self.outer, inverse, self.t)

    @classmethod
    def of(cls, lam: Complex) -> Points:
        """Charts of complex numbers (inf allowed), each in the chart where |t| <= 1."""
        outer = abs(lam) > 1
        finite = np.isfinite(lam) & (lam != 0)
        inverse = np.where(finite, 1 / np.where(finite, lam, 1), 0)
        return cls(np.where(outer, inverse, lam), outer)


class Values(NamedTuple):
    """N and what bounds its variation, at k points.

    Attributes:
        N: shape (k, q, m+q).
        rate: derivative along t, the input directions turning no more than they must, shape (k, q, m+q).
        response: derivative of J n C^-1 with C held, shape (k, q, m).
        spread: norm of the derivative of the orthonormal input directions Q = M n C^-1 with C held, shape (k,).
        tilt: norm of its part within the span of Q, which `rate` takes out, shape (k,).
        across: norm of its part across, shape (k,).
        inverse: norm of C^-1, shape (k,).
    """

    N: Complex
    rate: Complex
    response: Complex
    spread: Array
    tilt: Array
    across: Array
    inverse: Array


@dataclass(frozen=True, slots=True)
class Pencil:
    """N(lambda) = [(J1 - lambda J0) n(lambda) C(lambda)^-1, X1 - lambda X0], block k of n(lambda) being lambda^k I.

    C(lambda) makes the data directions with U(lambda) = 0 orthonormal: C* C = |M n(lambda)|^2.

    Attributes:
        M: inverse of the input factor by block columns, shape (d, m d, m).
        J1: response of the later shift to the inputs, shape (d, q, m).
        J0: same of the earlier shift.
        X1: autonomous part of the later shift, shape (q, q).
        X0: same of the earlier shift.
        overlap: cos(pi/(L+1)), for the norm of the shifts.
        floor: rounding made by the reduction, same units as kappa.
    """

    M: Array
    J1: Array
    J0: Array
    X1: Array
    X0: Array
    overlap: float
    floor: float

    @property
    def q(self) -> int:
        """Rows of N."""
        return int(self.X1.shape[0])

    def value(self, at: Points) -> Complex:
        """N at each point, shape (k, q, m+q)."""
        v, _ = _powers(at, self.M.shape[0])
        C = np.asarray(np.linalg.qr(_contract(v, self.M), mode="r"))
        F = _shifted(_contract(v, self.J1), _contract(v, self.J0), at)
        return np.concatenate([F @ np.linalg.inv(C), _shifted(self.X1, self.X0, at)], axis=2)

    def evaluate(self, at: Points) -> Values:
        """N, its derivative and the size of its normalisation at each point."""
        k, q = at.t.size, self.q
        both = np.concatenate(_powers(at, self.M.shape[0]))  # n and its derivative
        n, F1, F0 = (_contract(both, T) for T in (self.M, self.J1, self.J0))
        Q, C = np.linalg.qr(n[:k])
        Cinv = np.linalg.inv(C)
        outer = at.outer[:, None, None]
        own = np.where(outer, F1[:k], -F0[:k])  # the derivative of the shift itself
        rows = [_shifted(F1[:k], F0[:k], at), _shifted(F1[k:], F0[k:], at) + own, n[k:]]
        stack = np.concatenate(rows, axis=1) @ Cinv
        value, response, turn = stack[:, :q], stack[:, q : 2 * q], stack[:, 2 * q :]
        tilt = Q.conj().transpose(0, 2, 1) @ turn
        return Values(
            N=np.concatenate([value, _shifted(self.X1, self.X0, at)], axis=2),
            rate=np.concatenate([response - value @ tilt, np.where(outer, self.X1, -self.X0)], axis=2),
            response=response,
            spread=norms(turn),
            tilt=norms(tilt),
            across=norms(turn - Q @ tilt),
            inverse=norms(Cinv),
        )

    def weight(self, t: Complex | Array) -> Array:
        """Norm of S1 - t S0, a bidiagonal Toeplitz matrix of L block rows: at most 1 + |t|, and increasing in |t|."""
        size = np.abs(t)
        return np.sqrt(1 + size**2 + 2 * self.overlap * size)

    def singular_values(self, lam: Complex) -> Array:
        """Singular values of N over the weight at each lambda (inf allowed), shape (k, q), largest first."""
        at = Points.of(lam)
        sigma = np.asarray(np.linalg.svd(self.value(at), compute_uv=False))
        return sigma / self.weight(at.t)[:, None]


def _powers(at: Points, d: int) -> tuple[Complex, Complex]:
    """Blocks of n at each point, t^j in the inner and t^(d-1-j) in the outer chart, and their derivatives; (k, d)."""
    v = np.ones((at.t.size, d), dtype=np.complex128)
    v[:, 1:] = at.t[:, None]
    np.cumprod(v, axis=1, out=v)
    rate = np.zeros_like(v)
    rate[:, 1:] = np.arange(1, d) * v[:, :-1]
    outer = at.outer[:, None]
    return np.where(outer, v[:, ::-1], v), np.where(outer, rate[:, ::-1], rate)


def _shifted(later: Complex | Array, earlier: Complex | Array, at: Points) -> Complex:
    """Later - t earlier in the inner chart, t later - earlier in the outer one."""
    t, outer = at.t[:, None, None], at.outer[:, None, None]
    return np.asarray(np.where(outer, t, 1) * later - np.where(outer, 1, t) * earlier, dtype=np.complex128)


def norms(A: Complex) -> Array:
    """Frobenius norm of each matrix of a stack."""
    return np.asarray(np.sqrt(np.einsum("kij,kij->k", A.real, A.real) + np.einsum("kij,kij->k", A.imag, A.imag)))


def _contract(v: Complex, T: Array) -> Complex:
    """sum_j v[:, j] T[j] for real T of shape (d, a, m); real products only, half the work of complex ones."""
    k = v.shape[0]
    parts = np.concatenate([v.real, v.imag]) @ T.reshape(T.shape[0], -1)
    return np.asarray((parts[:k] + 1j * parts[k:]).reshape(k, *T.shape[1:]))


def reduce(data: Compression, q: int) -> Pencil:
    """Projects a compressed window on its q strongest autonomous directions.

    Both projections (of the columns on those directions, of the output rows on what these reach) can only make singular
    values smaller, so what the pencil proves holds for the data.

    Args:
        data: compressed window with persistently exciting inputs.
        q: directions kept, at least 1; no more than the p L rows of a pencil can be.

    Raises:
        ValueError: if the inputs are not persistently exciting.
    """
    if data.inverse is None:
        raise ValueError(f"the inputs are not persistently exciting of order {data.d}")
    q = min(q, data.p * data.L)
    X = data.directions[:, :q]
    top, bottom = slice(0, data.p * data.L), slice(data.p, data.p * (data.L + 1))
    left, _, _ = np.linalg.svd(np.hstack([X[top], X[bottom]]), full_matrices=False)
    Z = left[:, :q].T
    J = data.per_input(np.vstack([Z @ data.R21[bottom], Z @ data.R21[top]]))
    blocks = J.reshape(2, -1, data.d, data.m).transpose(0, 2, 1, 3).copy()
    M = data.inverse.reshape(-1, data.d, data.m).transpose(1, 0, 2).copy()
    floor = ROUNDING * EPS * float(np.linalg.norm(J) * np.linalg.norm(data.R11))
    return Pencil(M, blocks[0], blocks[1], Z @ X[bottom], Z @ X[top], float(np.cos(np.pi / (data.L + 1))), floor)
