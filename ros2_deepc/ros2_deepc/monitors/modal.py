# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Modes of the autonomous part X1 - lambda X0 of a pencil, and how far noise can move them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla
from numpy.typing import NDArray

from .compress import Array
from .pencil import Complex, Pencil

_REGULAR = 1.6 * np.exp(2.3j)
"""A lambda at which X(lambda) is hardly ever singular."""


@dataclass(frozen=True, slots=True)
class Modal:
    """W (X1 - lambda X0) V = diag(d1) - lambda diag(d0) up to a residual; rows of W and columns of V have unit norm.

    Attributes:
        eigenvalues: roots of det(X1 - lambda X0), shape (q,); inf where X0 is singular.
        d1: shape (q,).
        d0: shape (q,).
        residual: norm of what is off the diagonals, inf when V is singular.
    """

    eigenvalues: Complex
    d1: Complex
    d0: Complex
    residual: float

    @property
    def size(self) -> Array:
        """Size of each diagonal pair: small for modes that little noise moves far, shape (q,)."""
        return np.maximum(abs(self.d1), abs(self.d0))

    def radius(self, eps: float) -> Array:
        """How far, to first order and along the unit circle, an eps of noise moves each mode, shape (q,)."""
        return 2 * eps / np.maximum(self.size, np.finfo(np.float64).tiny)

    def reach(self, eps: float) -> Array:
        """Radii of discs about the modes, in their charts, that hold every lambda with sigma_min(X) <= 2 eps; (q,).

        For a unit vector a with |a* X(lambda)| <= 2 eps and a* = b* W: |b| >= 1/sqrt(q) and
        min_i |alpha d1_i - beta d0_i| |b| <= |b| residual + 2 eps sqrt(q), the argument of Bauer and Fike.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            return (self.residual + 2 * eps * self.d1.size) / self.size


def eigenvalues(pencil: Pencil) -> Complex:
    """Roots of det(X1 - lambda X0) alone, shape (q,); inf where X0 is singular."""
    return _ratio(sla.eigvals(pencil.X1, pencil.X0, homogeneous_eigvals=True, check_finite=False))


def _ratio(w: NDArray[np.complexfloating]) -> Complex:
    """Homogeneous eigenvalues (2, q) as numbers."""
    finite = abs(w[1]) > 0
    return np.where(finite, w[0] / np.where(finite, w[1], 1), np.inf).astype(np.complex128)


def modal(pencil: Pencil) -> Modal:
    """Diagonalises the autonomous part as well as it can be."""
    w, V = sla.eig(pencil.X1, pencil.X0, homogeneous_eigvals=True, check_finite=False)
    V = V / np.linalg.norm(V, axis=0)
    roots = _ratio(w)
    try:
        W = np.linalg.inv((pencil.X1 - _REGULAR * pencil.X0) @ V)  # multiple modes spoil left eigenvectors, not this
    except np.linalg.LinAlgError:
        nothing = np.zeros(pencil.q, dtype=np.complex128)
        return Modal(roots, nothing, nothing, np.inf)
    W = W / np.linalg.norm(W, axis=1, keepdims=True)
    W1, W0 = W @ pencil.X1 @ V, W @ pencil.X0 @ V
    d1, d0 = np.diag(W1).copy(), np.diag(W0).copy()
    residual = float(np.linalg.norm(W1 - np.diag(d1)) + np.linalg.norm(W0 - np.diag(d0)))
    return Modal(roots, d1, d0, residual)
