# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Proof that the pencil keeps its rank at every lambda: a finite cover of all candidates.

N(lambda) contains X(lambda) = X1 - lambda X0, so a lambda with kappa <= eps makes X(lambda) nearly singular. With V, W
that nearly diagonalise X, such a lambda lies in one of q discs about the eigenvalues (the argument of Bauer and Fike,
with the residual of V and W accounted for, so that it holds however ill-conditioned they are). Squares cover the discs;
a square is done when a bound of the variation of N over it keeps kappa above eps, and is split in four otherwise.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.linalg as sla

from .compress import Array
from .pencil import Complex, Mask, Pencil, Points

BUDGET = 20000
"""Squares looked at before giving up."""

_REGULAR = 1.6 * np.exp(2.3j)
"""A lambda at which X(lambda) is hardly ever singular."""

_WIDE = 0.2
"""Discs wider than this are replaced by the whole sphere: one square in each chart."""


class Squares(NamedTuple):
    """Squares of one size list: centres in their charts, half sides, shape (k,)."""

    at: Points
    half: Array


class Certificate(NamedTuple):
    """Outcome of a cover.

    Attributes:
        complete: whether kappa > eps is proved everywhere.
        squares: how many squares were looked at.
        counterexample: a lambda with kappa <= eps, or None.
    """

    complete: bool
    squares: int
    counterexample: complex | None


def certify(pencil: Pencil, eps: float, budget: int = BUDGET) -> Certificate:
    """Decides whether kappa(lambda) > eps for every complex lambda and infinity.

    Args:
        pencil: the reduced pencil.
        eps: threshold, in the units of kappa, positive.
        budget: squares looked at before giving up.
    """
    todo, looked = candidates(pencil, eps), 0
    curve = Curvature(pencil)
    while todo.half.size:
        looked += todo.half.size
        if looked > budget:
            return Certificate(False, looked, None)
        done, bad = _examine(pencil, curve, todo, eps)
        if bad.any():
            i = int(np.argmax(bad))
            return Certificate(False, looked, complex(todo.at.lambda_[i]))
        todo = _split(todo, ~done)
    return Certificate(True, looked, None)


def candidates(pencil: Pencil, eps: float) -> Squares:
    """Squares that together hold every lambda with kappa <= eps."""
    _, V = sla.eig(pencil.X1, pencil.X0, check_finite=False)
    try:
        W = np.linalg.inv(
            (pencil.X1 - _REGULAR * pencil.X0) @ V
        )  # serves multiple eigenvalues, unlike left eigenvectors
    except np.linalg.LinAlgError:
        return _sphere()
    W = W / np.linalg.norm(W, axis=1, keepdims=True)
    W1, W0 = W @ pencil.X1 @ V, W @ pencil.X0 @ V
    d1, d0 = np.diag(W1), np.diag(W0)
    residual = float(np.linalg.norm(W1 - np.diag(d1)) + np.linalg.norm(W0 - np.diag(d0)))
    size = np.maximum(abs(d1), abs(d0))
    # Rows of W and columns of V have unit norm: |alpha|, |beta| <= 1 and kappa <= eps give an i with
    # |alpha d1_i - beta d0_i| <= residual + 2 eps q.
    with np.errstate(divide="ignore", invalid="ignore"):
        radius = (residual + 2 * eps * pencil.q) / size
    if not np.all(radius < _WIDE):
        return _sphere()
    outer = abs(d1) > abs(d0)
    t = np.where(outer, d0, d1) / np.where(outer, d1, d0)
    half = radius / (1 - radius)  # the divisor covers what lies across the unit circle
    upper = t.imag + half >= 0  # kappa is symmetric about the real axis, for the data are real
    return Squares(Points(t[upper], outer[upper]), half[upper])


def _sphere() -> Squares:
    """One square in each chart, together the whole sphere."""
    return Squares(Points(np.zeros(2, dtype=np.complex128), np.array([False, True])), np.full(2, 1.0))


class Curvature:
    """Bounds of second derivatives of the polynomials in N, from the norms of their coefficients."""

    def __init__(self, pencil: Pencil) -> None:
        zero = np.zeros((1, *pencil.J1.shape[1:]))
        F = np.concatenate([pencil.J1, zero]) - np.concatenate([zero, pencil.J0])
        self._F = np.linalg.norm(F, axis=(1, 2))
        self._M = np.linalg.norm(pencil.M, axis=(1, 2))

    def __call__(self, reach: Array, outer: Mask) -> tuple[Array, Array]:
        """Bounds for |t| <= reach of the second derivatives of J n and of M n, shapes (k,)."""
        return self._bound(self._F, reach, outer), self._bound(self._M, reach, outer)

    @staticmethod
    def _bound(coefficients: Array, reach: Array, outer: Mask) -> Array:
        j = np.arange(2, coefficients.size)
        powers = j * (j - 1) * reach[:, None] ** (j - 2)
        return np.where(outer, powers @ coefficients[::-1][2:], powers @ coefficients[2:])


def _examine(pencil: Pencil, curve: Curvature, todo: Squares, eps: float) -> tuple[Mask, Mask]:
    """Which squares are proved, and which have a centre with kappa <= eps."""
    at, rho = todo.at, todo.half * np.sqrt(2)
    value = pencil.evaluate(at)
    reach = abs(at.t) + rho
    need = eps * pencil.weight(reach)
    sigma, slope = _relative_slope(value.N, value.rate)
    bend_F, bend_M = curve(reach, at.outer)
    grown = 1 + rho * value.spread + 0.5 * rho**2 * value.inverse * bend_M
    low = sigma * (1 - rho * slope) - 0.5 * rho**2 * value.inverse * bend_F
    done = low > need * grown
    if not done.all():  # far from every eigenvalue the square part of N alone will do, and needs no curvature
        rest = np.flatnonzero(~done)
        part, slope = _relative_slope(value.N[rest][:, :, -pencil.q :], value.rate[rest][:, :, -pencil.q :])
        done[rest] = part * (1 - rho[rest] * slope) > need[rest]
    return done, sigma <= eps * pencil.weight(abs(at.t))


def _relative_slope(N: Complex, rate: Complex) -> tuple[Array, Array]:
    """Smallest singular value of N = U S V*, and |S^-1 U* rate|: the rate at which it can shrink, relative to itself.

    For |a| = 1: |a* (N + t rate)| >= |a* U S| (1 - |t| |S^-1 U* rate|). Weak directions are weighed by their own size.
    """
    left, sigma, _ = np.linalg.svd(N, full_matrices=False)
    small = sigma[:, -1]
    safe = np.where(sigma > 0, sigma, 1)
    slope = np.linalg.norm(left.conj().transpose(0, 2, 1) @ rate / safe[:, :, None], axis=(1, 2))
    return small, slope  # a zero small makes every bound fail, whatever the slope


def _split(squares: Squares, which: Mask) -> Squares:
    """Quarters of the chosen squares."""
    (t, outer), half = squares
    quarter = half[which] / 2
    corners = np.array([1 + 1j, 1 - 1j, -1 + 1j, -1 - 1j])
    centres: Complex = (t[which][:, None] + quarter[:, None] * corners).ravel()
    return Squares(Points(centres, np.repeat(outer[which], 4)), np.repeat(quarter, 4))
