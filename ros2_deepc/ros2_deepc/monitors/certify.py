# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Proof that the pencil keeps its rank at every lambda: a finite cover of all candidates.

N(lambda) contains X(lambda) = X1 - lambda X0, so a lambda with kappa <= eps makes X(lambda) nearly singular and lies in
one of q discs about the modes (see `modal`), however ill-conditioned these are. Squares cover the discs; a square is
done when a bound of the variation of N over it keeps kappa above eps, and is split in four otherwise.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .compress import EPS, Array
from .modal import Modal, modal
from .pencil import Complex, Mask, Pencil, Points, norms

BUDGET = 20000
"""Squares looked at before giving up."""

_MEMORY = 500_000
"""Numbers that a batch of squares may take for its input directions."""

_WIDE = 0.2
"""Discs wider than this are replaced by the whole sphere."""


class Squares(NamedTuple):
    """Squares of one size list: centres in their charts, half sides, shape (k,)."""

    at: Points
    half: Array

    def only(self, which: Mask | slice) -> Squares:
        """Some of the squares."""
        return Squares(Points(self.at.t[which], self.at.outer[which]), self.half[which])


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


def certify(pencil: Pencil, eps: float, modes: Modal | None = None, budget: int = BUDGET) -> Certificate:
    """Decides whether kappa(lambda) > eps for every complex lambda and infinity.

    Args:
        pencil: the reduced pencil.
        eps: threshold, in the units of kappa, positive.
        modes: of the pencil, if they are known already.
        budget: squares looked at before giving up.
    """
    curve, looked = Curvature(pencil), 0
    pending = [candidates(modes or modal(pencil), eps)]
    batch = max(16, _MEMORY // pencil.M[0].size)
    while pending:
        todo = pending.pop()
        if todo.half.size > batch:
            pending.append(todo.only(slice(batch, None)))
            todo = todo.only(slice(batch))
        looked += todo.half.size
        if looked > budget:
            return Certificate(False, looked, None)
        done, bad = _examine(pencil, curve, todo, eps)
        if bad.any():
            i = int(np.argmax(bad))
            return Certificate(False, looked, complex(todo.at.lambda_[i]))
        if not done.all():
            pending.append(_split(todo.only(~done)))
    return Certificate(True, looked, None)


def candidates(modes: Modal, eps: float) -> Squares:
    """Squares that together hold every lambda with kappa <= eps and no negative imaginary part."""
    radius = modes.reach(eps)
    if not np.all(radius < _WIDE):
        return _sphere()
    outer = abs(modes.d1) > abs(modes.d0)
    t = np.asarray(np.where(outer, modes.d0, modes.d1) / np.where(outer, modes.d1, modes.d0), dtype=np.complex128)
    half = radius / (1 - radius)  # the divisor covers what lies across the unit circle
    upper = np.where(outer, -t.imag, t.imag) + half >= 0  # data are real: kappa is the same at conjugate lambda
    return Squares(Points(t, outer), half).only(upper)


def _sphere() -> Squares:
    """Squares that cover all lambda with a positive imaginary part, from both charts; the others are their mirror."""
    t = np.array([0.5 + 0.5j, -0.5 + 0.5j])
    return Squares(Points(np.concatenate([t, t.conj()]), np.repeat([False, True], 2)), np.full(4, 0.5))


class Curvature:
    """Bounds of second derivatives of the polynomials in N, from the norms of their coefficients.

    Rows of J n are weighed by what the autonomous part shows of each direction: strong ones must not drown weak ones.

    Attributes:
        rows: the weights' inverse, shape (q, q).
    """

    def __init__(self, pencil: Pencil) -> None:
        left, size, _ = np.linalg.svd(np.hstack([pencil.X1, pencil.X0]), full_matrices=False)
        size = np.maximum(size, size[0] * EPS)
        self.rows = left * size
        zero = np.zeros((1, *pencil.J1.shape[1:]))
        J = np.concatenate([pencil.J1, zero]) - np.concatenate([zero, pencil.J0])
        self._J = np.linalg.norm(left.T @ J / size[:, None], axis=(1, 2))
        self._M = np.linalg.norm(pencil.M, axis=(1, 2))

    def __call__(self, reach: Array, outer: Mask) -> tuple[Array, Array]:
        """Bounds for |t| <= reach of the second derivatives of the weighed J n and of M n, shapes (k,)."""
        return self._bound(self._J, reach, outer), self._bound(self._M, reach, outer)

    @staticmethod
    def _bound(coefficients: Array, reach: Array, outer: Mask) -> Array:
        j = np.arange(2, coefficients.size)
        powers = j * (j - 1) * reach[:, None] ** (j - 2)
        return np.where(outer, powers @ coefficients[::-1][2:], powers @ coefficients[2:])


def _examine(pencil: Pencil, curve: Curvature, todo: Squares, eps: float) -> tuple[Mask, Mask]:
    """Which squares are proved, and which have a centre with kappa <= eps.

    Within rho of the centre Q = Q0 + (t - t0) across + rest has a norm of at most `grown`, and
    N = N0 + (t - t0) rate + rest. With N0 = U S V* and |a| = 1,
    |a* N| >= |a* U S| (1 - rho |S^-1 U* rate| - |S^-1 U* rest|): all is relative to the size of each direction.
    """
    at, rho = todo.at, todo.half * np.sqrt(2)
    value = pencil.evaluate(at)
    reach = abs(at.t) + rho
    need = eps * pencil.weight(reach)
    bend_J, bend_M = curve(reach, at.outer)
    bend = 0.5 * rho**2 * value.inverse * (1 + rho * value.tilt)
    grown = np.hypot(1, rho * value.across) + rho**2 * value.spread * value.tilt + bend * bend_M
    sigma, relative = _relative(value.N)
    loss = rho * norms(relative @ value.rate) + rho**2 * norms(relative @ value.response) * value.tilt
    loss += bend * norms(relative @ curve.rows) * bend_J
    done = sigma * (1 - loss) > need * grown
    if not done.all():  # far from every eigenvalue the square part of N alone will do, and needs no curvature
        left = np.flatnonzero(~done)
        part, relative = _relative(value.N[left][:, :, -pencil.q :])
        loss = rho[left] * norms(relative @ value.rate[left][:, :, -pencil.q :])
        done[left] = part * (1 - loss) > need[left]
    return done, sigma <= eps * pencil.weight(at.t)


def _relative(N: Complex) -> tuple[Array, Complex]:
    """Smallest singular value of each N = U S V*, and S^-1 U*."""
    left, sigma, _ = np.linalg.svd(N, full_matrices=False)
    safe = np.maximum(sigma, 1e-100)  # a zero in sigma fails every bound as it is
    return sigma[:, -1], left.conj().transpose(0, 2, 1) / safe[:, :, None]


def _split(squares: Squares) -> Squares:
    """Quarters of squares."""
    (t, outer), half = squares
    quarter = half / 2
    corners = np.array([1 + 1j, 1 - 1j, -1 + 1j, -1 - 1j])
    centres: Complex = (t[:, None] + quarter[:, None] * corners).ravel()
    return Squares(Points(centres, np.repeat(outer, 4)), np.repeat(quarter, 4))
