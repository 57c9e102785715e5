# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""One sample after the other: the only place where a linear plant moves."""

from collections import deque
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from .arrays import Array, matrix
from .weierstrass import Weierstrass


class Stepper(Protocol):
    """A running plant: takes the inputs in order, returns the outputs in order."""

    def push(self, u: ArrayLike) -> Array | None:
        """Takes u(j), shape (m,), for j = 0, 1, ...; returns y(j-s+1), shape (p,), or None for the first s-1 inputs."""
        ...


class LinearStepper:
    """Restriction of an infinite trajectory (paper, (2_4) and (2_6)), one sample at a time.

    z1(k+1) = A1 z1(k) + B1 u(k), y(k) = C1 z1(k) + sum_{i<s} P_i u(k+i). Both come from one
    product of a constant matrix with [z1(k); u(k); ...; u(k+s-1)], summed column after column: no BLAS, hence the same
    bits in every process and with any number of threads.
    """

    def __init__(
        self,
        form: Weierstrass,
        z10: Array,
        *,
        outputs_noise: Array | None = None,
        rng: np.random.Generator | None = None,
    ) -> None:
        """Starts at z1(0) = ``z10``, shape (q,).

        ``form`` may have been extended by noise inputs (see `simulate`); ``outputs_noise`` is the standard deviation of
        white measurement noise, shape (p,), drawn from ``rng`` after each output.
        """
        q, p, m, s = form.q, len(form.D), form.D.shape[1], form.s
        rows = np.zeros((q + p, q + s * m))
        rows[:q, :q], rows[q:, :q] = form.A1, form.C1
        rows[:q, q : q + m] = form.B1
        rows[q:, q:] = np.hstack(list(form.markov()))
        self._columns = np.ascontiguousarray(rows.T)
        self._q, self._m = q, m
        self._z1 = matrix(z10, "z1(0)", (q,))
        self._inputs: deque[Array] = deque(maxlen=s)
        self._noise, self._rng = outputs_noise, rng

    @property
    def z1(self) -> Array:
        """Slow state at the instant of the next output, shape (q,), read-only."""
        return self._z1

    def push(self, u: ArrayLike) -> Array | None:
        """Takes u(j), shape (m,), for j = 0, 1, ...; returns y(j-s+1), shape (p,), or None for the first s-1 inputs.

        Raises:
            ShapeError: if ``u`` has another shape or is not finite.
        """
        self._inputs.append(matrix(u, "u", (self._m,)))
        if len(self._inputs) < (self._inputs.maxlen or 0):
            return None
        known = np.concatenate((self._z1, *self._inputs))
        step = (self._columns * known[:, None]).sum(axis=0)
        self._z1 = step[: self._q]
        y: Array = step[self._q :]
        if self._noise is not None and self._rng is not None:
            y = y + self._noise * self._rng.standard_normal(len(y))
        return y
