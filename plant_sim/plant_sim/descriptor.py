# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Linear descriptor systems E x(k+1) = A x(k) + B u(k), y(k) = C x(k) + D u(k)."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from .arrays import Array, matrix
from .deflate import Deflation, deflate
from .weierstrass import Weierstrass, require_clear, weierstrass

if TYPE_CHECKING:
    from .simulate import Trajectory
    from .structure import Structure


@dataclass(frozen=True, eq=False, init=False)
class DescriptorSystem:
    """A regular linear descriptor system (paper, (2_1)); E may be singular. Immutable.

    Attributes:
        E: shape (n, n).
        A: shape (n, n).
        B: shape (n, m).
        C: shape (p, n).
        D: shape (p, m).
    """

    E: Array
    A: Array
    B: Array
    C: Array
    D: Array
    _deflation: Deflation = field(repr=False)

    def __init__(self, E: ArrayLike, A: ArrayLike, B: ArrayLike, C: ArrayLike, D: ArrayLike | None = None) -> None:
        """Checks and copies the matrices; ``D`` defaults to zero.

        Raises:
            ShapeError: if a shape does not fit, or an entry is not finite; the message names the matrix.
            NotRegularError: if det(zE - A) vanishes for every z, within rounding.
        """
        put = object.__setattr__
        A = matrix(A, "A", (None, None))
        n = len(A)
        put(self, "A", matrix(A, "A", (n, n)))
        put(self, "E", matrix(E, "E", (n, n)))
        B, C = matrix(B, "B", (n, None)), matrix(C, "C", (None, n))
        put(self, "B", B)
        put(self, "C", C)
        put(self, "D", matrix(np.zeros((len(C), B.shape[1])) if D is None else D, "D", (len(C), B.shape[1])))
        with threadpool_limits(1):
            put(self, "_deflation", deflate(self.E, self.A))

    @property
    def n(self) -> int:
        """Number of states."""
        return len(self.A)

    @property
    def m(self) -> int:
        """Number of inputs."""
        return int(self.B.shape[1])

    @property
    def p(self) -> int:
        """Number of outputs."""
        return len(self.C)

    @cached_property
    def _form(self) -> Weierstrass:
        require_clear(self._deflation.decisions)
        return self._decompose(self._deflation)

    def _decompose(self, deflation: Deflation) -> Weierstrass:
        with threadpool_limits(1):  # one thread: the same bits everywhere, and no fight with the control loop
            return weierstrass(self.E, self.A, self.B, self.C, self.D, deflation)

    def weierstrass(self, tolerance: float | None = None) -> Weierstrass:
        """Quasi-Weierstrass form (paper, section 2); computed once.

        Args:
            tolerance: singular values of the equilibrated E (and of its parts) up to this fraction of its norm
                count as zero. By default 100 n eps, and a decision without a clear gap is refused; a given tolerance
                decides whatever the gap.

        Raises:
            UnclearStructureError: if the split between finite and infinite eigenvalues is hidden by rounding.
        """
        if tolerance is None:
            return self._form
        return self._decompose(deflate(self.E, self.A, tolerance))

    def slow_state(self, x: ArrayLike) -> Array:
        """Slow part z1 of a state, shape (n,) -> (q,). It depends on E x only: algebraic unknowns may hold anything."""
        form = self.weierstrass()
        return form.S[: form.q] @ (self.E @ matrix(x, "x", (self.n,)))

    def structure(self) -> "Structure":
        """Controllability, observability, conserved quantities: see `plant_sim.structure.structure`; computed once."""
        return self._structure

    @cached_property
    def _structure(self) -> "Structure":
        from .structure import structure

        return structure(self)

    def simulate(
        self,
        u: ArrayLike,
        z10: ArrayLike | None = None,
        *,
        x0: ArrayLike | None = None,
        tolerance: float = 1e-8,
        process_noise: ArrayLike | None = None,
        measurement_noise: ArrayLike | None = None,
        rng: np.random.Generator | None = None,
    ) -> "Trajectory":
        """Trajectory under ``u``: see `plant_sim.simulate.simulate`."""
        from .simulate import simulate

        return simulate(
            self, u, z10, x0=x0, tolerance=tolerance,
            process_noise=process_noise, measurement_noise=measurement_noise, rng=rng,
        )  # fmt: skip
