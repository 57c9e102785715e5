# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Radau IIA of order 5 for the swing equations, with Newton's method on machines and algebraic buses together.

Stiffly accurate: the last stage is the end of the step, so the power balances of the load buses hold there as well as
Newton's method solves them (Hairer and Wanner, Solving Ordinary Differential Equations II, 1996, IV.8 and VI.1).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from .arrays import Array
from .errors import PlantError
from .swing_dae import SwingGrid, flows, stiffness

_R = np.sqrt(6.0)
RADAU_C = np.array([(4 - _R) / 10, (4 + _R) / 10, 1.0])
RADAU_A = np.array(
    [
        [(88 - 7 * _R) / 360, (296 - 169 * _R) / 1800, (-2 + 3 * _R) / 225],
        [(296 + 169 * _R) / 1800, (88 + 7 * _R) / 360, (-2 - 3 * _R) / 225],
        [(16 - _R) / 36, (16 + _R) / 36, 1 / 9],
    ]
)
TOLERANCE = 1e-12  # per unit: residual of the stage equations
ITERATIONS = 12  # with one and the same Jacobian
HALVINGS = 8


@dataclass(frozen=True, slots=True, eq=False)
class SwingState:
    """Speeds omega (g,) [rad/s], angles theta (N,) [rad] of all buses, machines first."""

    omega: Array
    theta: Array


class SwingIntegrator:
    """Steps one grid whose branches and loads do not change.

    Args:
        grid: the grid.
        h: step, s.
    """

    def __init__(self, grid: SwingGrid, h: float) -> None:
        self.grid, self.h = grid, h
        self._A = grid.incidence()
        self._AA = RADAU_A @ RADAU_A
        self._inverse: Array | None = None
        self._guess: Array | None = None  # accelerations and load angles at the end of the last step
        self._halved: SwingIntegrator | None = None

    def residual(self, state: SwingState) -> float:
        """Largest power mismatch at the load buses, per unit."""
        g = self.grid.machines
        mismatch = flows(self._A, self.grid.b, state.theta)[g:] + self.grid.load[g:]
        return float(np.abs(mismatch).max(initial=0.0))

    def step(self, state: SwingState, power: Callable[[Array], Array], depth: int = 0) -> SwingState:
        """One step of h.

        Args:
            state: at the beginning; its load angles only start Newton's method.
            power: mechanical power, shape (times, g), at times (times,) after the beginning of the step.
            depth: how often the step was halved already.

        Raises:
            PlantError: if the equations have no solution near the state: the grid has lost synchronism.
        """
        stages = power(RADAU_C * self.h) - self.grid.load[: self.grid.machines]
        for fresh in (False, True):
            if fresh or self._inverse is None:
                self._inverse = self._inverted(state.theta)
            after = self._newton(state, stages, self._inverse)
            if after is not None:
                return after
        self._inverse = None
        if depth >= HALVINGS:
            raise PlantError("the grid has lost synchronism: no angles balance the power at its load buses")
        if self._halved is None:
            self._halved = SwingIntegrator(self.grid, self.h / 2)
        middle = self._halved.step(state, power, depth + 1)
        return self._halved.step(middle, lambda t: power(t + self.h / 2), depth + 1)

    def _inverted(self, theta: Array) -> Array:
        """Inverse of the stage equations' Jacobian, the stiffness taken at theta (N,) for all stages.

        Unknowns are, stage by stage, the machines' accelerations and the load buses' angles.
        """
        grid, g, h = self.grid, self.grid.machines, self.h
        K = stiffness(self._A, grid.b, theta)
        N = len(K)
        inertia, damping, machines, loads = np.zeros((N, N)), np.zeros((N, N)), np.zeros((N, N)), np.zeros((N, N))
        inertia[:g, :g], damping[:g, :g] = np.diag(grid.M), np.diag(grid.D)
        machines[:, :g], loads[:, g:] = K[:, :g], K[:, g:]
        J = np.kron(np.eye(3), inertia + loads) + np.kron(h * RADAU_A, damping) + np.kron(h * h * self._AA, machines)
        try:
            return np.asarray(linalg.inv(J, check_finite=False))
        except linalg.LinAlgError:
            return np.full(J.shape, np.nan)  # Newton's method then gives up

    def _newton(self, state: SwingState, power: Array, inverse: Array) -> SwingState | None:
        """Solves the stage equations for net power (3, g); None if it does not converge."""
        grid, g, h = self.grid, self.grid.machines, self.h
        N = len(grid.buses)
        x = np.zeros((3, N)) if self._guess is None else np.tile(self._guess, (3, 1))
        x[:, g:] = state.theta[g:]
        drift = state.theta[:g] + (RADAU_C * h)[:, None] * state.omega
        theta, residual = np.empty((3, N)), np.empty((3, N))
        worst = np.inf
        for _ in range(ITERATIONS):
            omega = state.omega + h * (RADAU_A @ x[:, :g])
            theta[:, :g] = drift + h * h * (self._AA @ x[:, :g])
            theta[:, g:] = x[:, g:]
            residual[:] = flows(self._A, grid.b, theta)
            residual[:, :g] += grid.M * x[:, :g] + grid.D * omega - power
            residual[:, g:] += grid.load[g:]
            before, worst = worst, float(np.abs(residual).max())
            if worst < TOLERANCE:
                self._guess = x[2]
                return SwingState(omega[2], theta[2].copy())
            if not worst < 1e3 * before:
                return None
            x -= (inverse @ residual.ravel()).reshape(3, N)
        return None
