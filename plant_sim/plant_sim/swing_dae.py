# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Nonlinear swing equations of a lossless grid with every bus kept, a semi-explicit DAE of index 1.

dtheta_gen/dt = omega,  M domega/dt = P_gen - P_load,gen - D omega - f_gen(theta),  0 = -P_load - f_load(theta),

with f(theta) = A diag(b) sin(A' theta), A the incidence matrix and b = 1/x (Kundur, Power System Stability and Control,
1994, chapter 12, without resistances and at nominal voltages). The load angles are the algebraic unknowns.
"""

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from .arrays import Array
from .errors import PlantError

NEWTON = 50  # iterations of a Newton method that starts from the flat grid
BALANCED = 1e-12  # per unit: residual of power balances that counts as zero


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SwingGrid:
    """A grid: N buses of which the first g carry a machine, all powers in per unit.

    Attributes:
        buses: numbers of the buses.
        M: inertia [pu s2/rad], shape (g,).
        D: damping [pu s/rad], shape (g,).
        branches: pairs of positions (i, j).
        b: susceptances, one a branch.
        generation: mechanical power of the machines, shape (g,).
        load: power drawn at each bus, shape (N,); sums up to that of ``generation``.
    """

    buses: tuple[int, ...]
    M: Array
    D: Array
    branches: tuple[tuple[int, int], ...]
    b: Array
    generation: Array
    load: Array

    @property
    def machines(self) -> int:
        """Number of machines g."""
        return len(self.M)

    def incidence(self) -> Array:
        """Incidence matrix A, shape (N, branches): +1 where a branch begins, -1 where it ends."""
        A = np.zeros((len(self.buses), len(self.branches)))
        for column, (i, j) in enumerate(self.branches):
            A[i, column], A[j, column] = 1.0, -1.0
        return A


def flows(A: Array, b: Array, theta: Array) -> Array:
    """Power that leaves each bus over the branches, shape (..., N), from angles of the same shape."""
    return np.asarray((np.sin(theta @ A) * b) @ A.T)


def stiffness(A: Array, b: Array, theta: Array) -> Array:
    """Derivative of `flows` at theta (N,), shape (N, N): the Laplacian with weights b cos(theta_i - theta_j)."""
    return np.asarray((A * (b * np.cos(theta @ A))) @ A.T)


def operating_point(grid: SwingGrid) -> Array:
    """Angles at rest, shape (N,), the first one zero: a lossless power flow by Newton's method.

    Raises:
        PlantError: if powers do not balance, or no operating point is found.
    """
    A, g = grid.incidence(), grid.machines
    injection = -grid.load
    injection[:g] += grid.generation
    surplus = float(injection.sum())
    if abs(surplus) > 1e-9 * max(1.0, float(np.abs(injection).max())):
        raise PlantError(f"generation exceeds load by {surplus:.6g} pu: they must balance at the operating point")
    injection -= surplus / len(injection)
    theta = np.zeros(len(grid.buses))
    for _ in range(NEWTON):
        residual = flows(A, grid.b, theta) - injection
        if np.abs(residual).max() < BALANCED:
            return theta
        try:
            theta[1:] -= linalg.solve(stiffness(A, grid.b, theta)[1:, 1:], residual[1:])
        except linalg.LinAlgError:
            break
        if not np.isfinite(theta).all():
            break
    raise PlantError("the grid has no operating point: its branches cannot carry the scheduled power")


def rates(grid: SwingGrid, theta: Array) -> Array:
    """Eigenvalues of the linearisation at theta (N,), shape (2 g,), complex [1/s]."""
    g = grid.machines
    K = stiffness(grid.incidence(), grid.b, theta)
    K = K[:g, :g] - K[:g, g:] @ linalg.solve(K[g:, g:], K[g:, :g]) if g < len(K) else K
    inverse = 1.0 / grid.M[:, None]
    X = np.block([[np.diag(-grid.D / grid.M), -inverse * K], [np.eye(g), np.zeros((g, g))]])
    return np.asarray(linalg.eigvals(X))
