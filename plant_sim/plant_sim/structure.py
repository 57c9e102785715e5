# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""True structural properties of a descriptor system, decided on the model."""

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from .arrays import Array, frozen
from .descriptor import DescriptorSystem
from .reach import EPS, Reach, reach
from .weierstrass import Weierstrass


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Structure:
    """Controllability and observability (paper, section 2), with margins and directions.

    Attributes:
        controllability: of the slow part (A1, B1), in an orthonormal basis of the slow subspace.
        observability: of the slow part (A1, C1), in the same basis.
        fast_control_margin: smallest singular value of [E, B], equilibrated and relative; inf if r = 0.
        fast_observe_margin: smallest singular value of [E; C], equilibrated and relative; inf if r = 0.
        fast_controllable: rank [E, B] = n, equivalent to rank [B2, N B2, ...] = r.
        fast_observable: rank [E; C] = n.
        conserved: rows c with c x(k) constant whatever the inputs do, in reduced echelon form, shape (k, n).
        reachable: orthonormal basis of the reachable slow states, shape (n, controllability.rank).
        unobservable: orthonormal basis of the slow states that no output sees, shape (n, q - observability.rank).
    """

    controllability: Reach
    observability: Reach
    fast_control_margin: float
    fast_observe_margin: float
    fast_controllable: bool
    fast_observable: bool
    conserved: Array
    reachable: Array
    unobservable: Array

    @property
    def r_controllable(self) -> bool:
        """Controllable in the initial reachable set: every finite mode is."""
        return self.controllability.full

    @property
    def r_observable(self) -> bool:
        """Observable in the initial reachable set: every finite mode is."""
        return self.observability.full

    @property
    def c_controllable(self) -> bool:
        """Completely controllable: finite and infinite modes."""
        return self.r_controllable and self.fast_controllable

    @property
    def c_observable(self) -> bool:
        """Completely observable: finite and infinite modes."""
        return self.r_observable and self.fast_observable

    @property
    def uncontrollable_modes(self) -> tuple[complex, ...]:
        """Finite eigenvalues that no input reaches."""
        return self.controllability.modes

    @property
    def unobservable_modes(self) -> tuple[complex, ...]:
        """Finite eigenvalues that no output sees."""
        return self.observability.modes


def _size(*factors: Array) -> float:
    """Largest entry of the product of the absolute values: what the rounding of the product is relative to."""
    product = np.abs(factors[0])
    for factor in factors[1:]:
        product = product @ np.abs(factor)
    return float(product.max(initial=0.0))


def _conserved(system: DescriptorSystem, form: Weierstrass, control: Reach) -> Array:
    """Rows c = w' S1 E with w' A1 = w' among what no input reaches, in reduced echelon form; shape (k, n)."""
    W = control.lost
    if not W.size:
        return np.empty((0, system.n))
    U, sigma, _ = linalg.svd(W.T @ form.A1 @ W - np.eye(W.shape[1]))
    rows = (W @ U[:, sigma <= 10 * control.floor]).T @ form.S[: form.q] @ system.E
    if not len(rows):
        return np.empty((0, system.n))
    pivots = linalg.qr(rows, mode="r", pivoting=True)[1][: len(rows)]
    rows = np.asarray(np.linalg.solve(rows[:, np.sort(pivots)], rows))
    rows[np.abs(rows) < 1e3 * control.floor * np.abs(rows).max()] = 0.0
    return rows


def _fast(system: DescriptorSystem, side: Array, axis: int) -> tuple[float, bool]:
    """Margin and verdict of rank [E, side] = n (axis 1) or [E; side] = n (axis 0), on the equilibrated pencil."""
    d = system._deflation
    if d.r == 0:
        return np.inf, True
    E = system.E * d.rows[:, None] * d.cols
    side = side * d.rows[:, None] if axis == 1 else side * d.cols
    for part in (E, side):
        size = float(np.abs(part).max(initial=0.0))
        if size > 0:
            part /= size
    sigma = linalg.svdvals(np.concatenate([E, side], axis=axis))
    margin = float(sigma[-1] / sigma[0]) if sigma[0] > 0 else 0.0
    return margin, margin > 100 * system.n * EPS


def structure(system: DescriptorSystem) -> Structure:
    """Decides controllability and observability on the model (paper, Lemmas 1 and 2).

    Finite modes by the PBH test in an orthonormal basis of the slow subspace, checked by the reachable subspace;
    infinite modes by rank [E, B] and rank [E; C].

    Raises:
        UnclearStructureError: if the split between finite and infinite modes is hidden by rounding.
    """
    form = system.weierstrass()
    S1, P1 = form.S[: form.q], form.P[:, : form.q]
    noise = EPS * max(1.0, _size(S1, system.A, P1))  # of A1, and as a rule of the subspaces behind S1 and P1
    control = reach(form.A1, form.B1, noise, noise * _size(S1, system.B))
    observe = reach(form.A1.T, form.C1.T, noise, noise * _size(system.C, P1))
    control_margin, fast_controllable = _fast(system, system.B, 1)
    observe_margin, fast_observable = _fast(system, system.C, 0)
    return Structure(
        controllability=control,
        observability=observe,
        fast_control_margin=control_margin,
        fast_observe_margin=observe_margin,
        fast_controllable=fast_controllable,
        fast_observable=fast_observable,
        conserved=frozen(_conserved(system, form, control)),
        reachable=frozen(P1 @ control.reachable),
        unobservable=frozen(P1 @ observe.lost),
    )
