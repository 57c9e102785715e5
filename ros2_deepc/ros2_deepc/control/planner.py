# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""From a predictor to plans: the program, its solvers, and what to do when (6.1c) cannot hold."""

from dataclasses import dataclass

import numpy as np

from ros2_deepc.behavior.hankel import Array

from .predictor import Predictor
from .problem import Condensed, condense
from .qp import CheckedSolver, Daqp
from .settings import Sized

FEASIBLE = 1e-6  # a terminal condition missed by less than this, relative to the outputs' size, holds


@dataclass(frozen=True, slots=True)
class Plan:
    """A checked plan.

    Attributes:
        u: planned inputs, shape (L, m).
        y: predicted outputs, shape (L, p).
        second: whether the second solver had to be used.
        solver: name of the solver that answered.
        iterations: its iterations.
        remark: what went wrong on the way, one line; empty if nothing.
        unmet: for "hard" only: smallest possible violation of (6.1c) per output, each taken alone, shape (p,); all zero
            if (6.1c) holds.
    """

    u: Array
    y: Array
    second: bool
    solver: str
    iterations: int
    remark: str
    unmet: Array


class Planner:
    """Solves the program of one predictor after another.

    Args:
        sized: settings.
    """

    def __init__(self, sized: Sized) -> None:
        self._sized = sized
        base, m = sized.base, sized.m
        known = base.past + base.s - 1
        self._last_input = slice(m * (known - 1), m * known)
        self._solver = CheckedSolver(base.solver)
        self._relaxed_solver = CheckedSolver(base.solver)
        self._program: Condensed | None = None
        self._relaxed: Condensed | None = None
        self._tests: list[_Reach] = []

    @property
    def loaded(self) -> bool:
        """Whether there is a predictor to plan with."""
        return self._program is not None

    def load(self, predictor: Predictor) -> None:
        """Takes a new predictor; everything that does not need the newest sample is worked out here."""
        terminal = self._sized.base.terminal
        self._program = condense(predictor, self._sized, self._last_input, terminal)
        self._solver.load(self._program.H, self._program.A)
        if terminal == "hard":
            self._relaxed = condense(predictor, self._sized, self._last_input, terminal, relaxed=True)
            self._relaxed_solver.load(self._relaxed.H, self._relaxed.A)
            every = [np.arange(self._sized.p)] + [np.array([i]) for i in range(self._sized.p)]
            self._tests = [_Reach(self._relaxed, self._sized, outputs) for outputs in every]

    def plan(self, w: Array, goal: Array) -> tuple[Plan | None, str]:
        """Plans from w = [known inputs; past outputs] towards the reference trajectory goal (L, p).

        Returns:
            The plan, and a remark; no plan if no solver found one that passes the check.
        """
        program, solver = self._program, self._solver
        assert program is not None  # load comes first
        theta = np.concatenate([w, goal.ravel()])
        unmet = np.zeros(self._sized.p)
        if self._sized.base.terminal == "hard":
            unmet = self._unmet(theta)
            if unmet.any() and self._relaxed is not None:
                program, solver = self._relaxed, self._relaxed_solver
        f = program.f0 + program.f_theta @ theta
        move = np.concatenate([np.zeros(f.size), program.shift @ theta])
        answer, which, remark = solver.solve(f, program.lower - move, program.upper - move)
        if answer is None:
            return None, remark
        u = (program.inputs @ answer.x).reshape(-1, self._sized.m)
        y = (program.outputs @ answer.x + program.outputs_theta @ theta).reshape(-1, self._sized.p)
        if unmet.any():
            shares = ", ".join(f"{v:.3g}" for v in unmet)
            said = f"(6.1c) cannot hold: missed by at least ({shares}); planned with a penalty instead"
            remark = f"{said}; {remark}" if remark else said
        return Plan(u, y, which > 0, solver.solvers[which].name, answer.iterations, remark, unmet), remark

    def _unmet(self, theta: Array) -> Array:
        """Zero if (6.1c) can hold, else the least each output must miss it by."""
        tolerance = FEASIBLE * max(1.0, float(np.abs(theta).max()))
        if self._tests[0].smallest(theta) <= tolerance:
            return np.zeros(self._sized.p)
        alone = np.array([test.smallest(theta) for test in self._tests[1:]])
        alone[alone <= tolerance] = 0.0
        if not alone.any():  # each can hold, but not all together
            alone[:] = self._tests[0].smallest(theta)
        return np.where(self._sized.mask > 0, alone, 0.0)


class _Reach:
    """Smallest t with |y - y_ref| <= t over the terminal steps, for some of the outputs, inputs within their limits.

    Args:
        program: the relaxed program, for its maps and its box.
        sized: settings.
        outputs: which outputs, indices.
    """

    RIDGE = 1e-9

    def __init__(self, program: Condensed, sized: Sized, outputs: Array) -> None:
        p, L, free = sized.p, sized.base.L, program.inputs.shape[1]
        n = program.inputs.shape[1]
        steps = np.arange(L - sized.base.tail, L)
        part = (steps[:, None] * p + outputs[sized.mask[outputs] > 0]).ravel()
        C, D = program.outputs[part], program.outputs_theta[part].copy()
        known = D.shape[1] - p * L
        D[np.arange(part.size), known + part] -= 1.0
        one = np.ones((part.size, 1))
        self._limits = program.A.shape[0]
        t = np.zeros((self._limits, 1))
        self._A = np.vstack([np.hstack([program.A, t]), np.hstack([C, one]), np.hstack([C, -one])])
        self._shift = np.vstack([program.shift, D, D])
        far, zero = np.full(part.size, np.inf), np.zeros(part.size)
        self._lower = np.concatenate([program.lower[:n], [0.0], program.lower[n:], zero, -far])
        self._upper = np.concatenate([program.upper[:n], [np.inf], program.upper[n:], far, zero])
        self._n = free + 1
        self._solver = Daqp()
        self._solver.load(np.diag(np.append(np.full(free, self.RIDGE), 1.0)), self._A)

    def smallest(self, theta: Array) -> float:
        """The smallest t; infinity if the limits themselves cannot be met."""
        move = np.concatenate([np.zeros(self._n), self._shift @ theta])
        answer = self._solver.solve(np.zeros(self._n), self._lower - move, self._upper - move)
        return float(answer.x[-1]) if answer.solved else np.inf
