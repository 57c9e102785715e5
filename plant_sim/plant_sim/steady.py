# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Steady states: which (u_s, y_s) a system can rest at, within its input limits."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

from .arrays import Array, frozen, matrix
from .descriptor import DescriptorSystem
from .errors import PlantError


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SteadyStates:
    """All (u_s, y_s) = (u0, y0) + (U, Y) v with u_min <= u_s <= u_max: an affine set cut by the input limits.

    Attributes:
        u0: shape (m,).
        y0: shape (p,).
        U: input directions, shape (m, d).
        Y: output directions, shape (p, d).
        u_min: shape (m,).
        u_max: shape (m,).
    """

    u0: Array
    y0: Array
    U: Array
    Y: Array
    u_min: Array
    u_max: Array

    def _solve(self, cost: Array, rows: Array, bound: Array) -> tuple[int, Array]:
        """Minimises cost' (v, t) subject to the limits and rows (v, t) <= bound; returns HiGHS's status and (v, t)."""
        from scipy.optimize import linprog  # a quarter of a second that importing a plant should not cost

        extra = len(cost) - self.U.shape[1]
        limits = np.hstack([np.vstack([self.U, -self.U]), np.zeros((2 * len(self.u0), extra))])
        A = np.vstack([limits, rows])
        b = np.concatenate([self.u_max - self.u0, self.u0 - self.u_min, bound])
        result = linprog(cost, A_ub=A, b_ub=b, bounds=(None, None), method="highs")
        return int(result.status), np.asarray(cost * 0 if result.x is None else result.x, dtype=np.float64)

    def output_range(self) -> tuple[Array, Array]:
        """Lowest and highest resting value of each output, two arrays of shape (p,); infinite where unlimited.

        Raises:
            PlantError: if no steady state respects the input limits.
        """
        ends = np.empty((2, len(self.y0)))
        nothing = np.empty((0, self.U.shape[1])), np.empty(0)
        if self._solve(np.zeros(self.U.shape[1]), *nothing)[0] != 0:
            raise PlantError("no steady state respects the input limits")
        for i, direction in enumerate(self.Y):
            for side, sign in enumerate((1.0, -1.0)):
                status, v = self._solve(sign * direction, *nothing)  # feasible, so what fails is unbounded
                ends[side, i] = -sign * np.inf if status != 0 else self.y0[i] + direction @ v
        return ends[0], ends[1]

    def nearest(self, y_ref: ArrayLike) -> tuple[Array, Array, float]:
        """The steady state whose outputs are nearest to ``y_ref`` in the sum of their deviations.

        Args:
            y_ref: shape (p,).

        Returns:
            u_s, shape (m,), y_s, shape (p,), and the Euclidean norm of y_s - y_ref.

        Raises:
            PlantError: if no steady state respects the input limits.
        """
        y_ref = matrix(y_ref, "y_ref", (len(self.y0),))
        p, d = self.Y.shape
        gap = y_ref - self.y0
        rows = np.block([[self.Y, -np.eye(p)], [-self.Y, -np.eye(p)]])
        status, x = self._solve(np.concatenate([np.zeros(d), np.ones(p)]), rows, np.concatenate([gap, -gap]))
        if status != 0:
            raise PlantError("no steady state respects the input limits")
        y = self.y0 + self.Y @ x[:d]
        return self.u0 + self.U @ x[:d], y, float(np.linalg.norm(y - y_ref))


def steady_states(
    system: DescriptorSystem, u_min: ArrayLike, u_max: ArrayLike, z10: ArrayLike | None = None
) -> SteadyStates:
    """The steady states that inputs can lead to from z1(0).

    A steady state solves (I - A1) z1 = B1 u, y = C1 z1 + (D - C2 (I - N)^-1 B2) u. What the system conserves keeps its
    initial value. Other unreachable modes are taken at rest: where |lambda| >= 1 they rest only if they started so.

    Args:
        system: the system.
        u_min: shape (m,).
        u_max: shape (m,).
        z10: slow state at the start, shape (q,); default 0.

    Raises:
        ShapeError: if a shape does not fit.
    """
    form = system.weierstrass()
    q, m = form.q, system.m
    z10 = np.zeros(q) if z10 is None else matrix(z10, "z10", (q,))
    # left null vectors of [A1 - I, B1] are what is conserved
    floor = system.structure().controllability.floor
    motion = np.hstack([np.eye(q) - form.A1, -form.B1])
    kept = linalg.null_space(motion.T, rcond=max(floor, 1e-12)) if q else np.empty((0, 0))
    equations = np.vstack([motion, np.hstack([kept.T, np.zeros((kept.shape[1], m))])])
    values = np.concatenate([np.zeros(q), kept.T @ z10])
    start = np.linalg.lstsq(equations, values, rcond=max(floor, 1e-12))[0] if q else np.zeros(m)
    free = linalg.null_space(equations, rcond=max(floor, 1e-12)) if q else np.eye(m)
    free[np.abs(free) < 1e-12] = 0.0  # rounding would look like a weak input to the linear programs
    gain = np.hstack([form.C1, form.markov().sum(axis=0)])
    return SteadyStates(
        u0=frozen(start[q:]), U=frozen(free[q:]), y0=frozen(gain @ start), Y=frozen(gain @ free),
        u_min=matrix(u_min, "u_min", (m,)), u_max=matrix(u_max, "u_max", (m,)),
    )  # fmt: skip
