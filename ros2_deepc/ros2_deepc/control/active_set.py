# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The solution of a quadratic program as long as the same bounds hold."""

import numpy as np

from ros2_deepc.behavior.hankel import Array

LARGEST = 300  # unknowns and bounds that hold; beyond, the inverse costs more than it saves


class ActiveSet:
    """Which bounds hold at a solution. As long as the same ones do, x is affine in f and in those bounds.

    This is the law of explicit predictive control, for the one region that the loop is in (Bemporad, Morari, Dua and
    Pistikopoulos, Automatica 38, 2002). A plant that settles stays in it for many samples.

    Args:
        x: solution of min x'Hx/2 + f'x subject to lower <= [I; A] x <= upper, shape (n,).
        y: its multipliers, positive where an upper bound pushes, shape (n + rows,).
        A: shape (rows, n).
        lower: shape (n + rows,).
        upper: shape (n + rows,).
    """

    def __init__(self, x: Array, y: Array, A: Array, lower: Array, upper: Array) -> None:
        z = np.concatenate([x, A @ x])
        self._low = (z - lower < -y) | (lower == upper)
        held = self._low | (upper - z < y)
        self._held = np.flatnonzero(held)
        self.key = held.tobytes() + self._low.tobytes()
        self._law: Array | None = None

    def build(self, H: Array, A: Array) -> bool:
        """Works out the law; False if there is none or it is too large."""
        n, count = len(H), self._held.size
        if n + count > LARGEST:
            return False
        K = np.zeros((n + count, n + count))
        K[:n, :n] = H
        K[n:, :n] = np.vstack([np.eye(n), A])[self._held]
        K[:n, n:] = K[n:, :n].T
        try:
            law = np.asarray(np.linalg.inv(K), dtype=np.float64)
        except np.linalg.LinAlgError:  # bounds that depend on each other
            return False
        law[:, :n] *= -1.0
        self._law = law
        return True

    def solve(self, f: Array, lower: Array, upper: Array) -> tuple[Array, Array]:
        """Solution x and multipliers y if the same bounds hold; whether they do is for the caller to check."""
        assert self._law is not None  # build comes first
        bounds = np.where(self._low, lower, upper)[self._held]
        solution: Array = self._law.dot(np.concatenate([f, bounds]))
        y = np.zeros(lower.size)
        y[self._held] = solution[f.size :]
        return solution[: f.size], y
