# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""What a control step answers."""

from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np

from ros2_deepc.behavior.hankel import Array

from .planner import Plan
from .settings import Sized


class NotReadyError(RuntimeError):
    """The data do not yet determine the plant's behaviour; the message says what is missing."""


class Status(IntEnum):
    """How the input of a step came about."""

    SOLVED = 0
    """The first solver's solution, checked."""
    SECOND_SOLVER = 1
    """The first solver failed; the second one's solution, checked."""
    SHIFTED_PLAN = 2
    """Both failed; the next input of the last checked plan."""
    FALLBACK = 3
    """No plan left; the fallback input."""

    @property
    def solved(self) -> bool:
        """Whether a solver found and proved the optimum."""
        return self <= Status.SECOND_SOLVER


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StepResult:
    """One control step. What follows from the plan is worked out when it is asked for, after the input has left.

    Attributes:
        u: input to apply at the first instant that is still free, shape (m,); respects the box and the rate limits.
        status: how ``u`` came about.
        wanted: the input before the limiter, shape (m,).
        prepare_time: wall time of the last preparation [s].
        solve_time: wall time of this step, from call to answer [s].
        goal: reference over the plan, shape (L, p).
        plan: the plan behind ``u``.
        sized: settings in force.
    """

    u: Array
    status: Status
    wanted: Array
    prepare_time: float
    solve_time: float
    goal: Array = field(repr=False)
    plan: Plan = field(repr=False)
    sized: Sized = field(repr=False)

    @property
    def reason(self) -> str:
        """One line for people; empty if all is well."""
        return self.plan.remark

    @property
    def u_plan(self) -> Array:
        """Planned inputs from ``u`` on, shape (L, m)."""
        return self.plan.u(self.sized.m)

    @property
    def y_plan(self) -> Array:
        """Predicted outputs from the next instant on, shape (L, p); NaN where nothing is predicted."""
        return self.plan.y(self.sized.p)

    @property
    def limited(self) -> bool:
        """Whether the limiter had to change the wanted input by more than rounding."""
        size = np.maximum(self.plan.scale[0], np.abs(self.wanted))
        return bool((np.abs(self.u - self.wanted) > 1e-4 * size).any())

    @property
    def iterations(self) -> int:
        """Iterations of the solver that answered."""
        return self.plan.iterations

    @property
    def solver(self) -> str:
        """What answered: "osqp", "daqp", or "active set" (the exact law while the same bounds hold); "" if none did."""
        return self.plan.solver

    @property
    def _seeks(self) -> bool:
        return self.sized.base.terminal == "equilibrium" and self.status.solved

    @property
    def u_steady(self) -> Array:
        """Steady input aimed at, shape (m,); NaN unless terminal is "equilibrium" and a solver answered."""
        return self.u_plan[-1].copy() if self._seeks else np.full(self.sized.m, np.nan)

    @property
    def y_steady(self) -> Array:
        """Steady output aimed at, shape (p,); NaN unless terminal is "equilibrium" and a solver answered."""
        return self.y_plan[-1].copy() if self._seeks else np.full(self.sized.p, np.nan)

    @property
    def distance(self) -> float:
        """How far the reference is from the nearest steady state in reach, largest over the outputs that count.

        In output units; NaN unless terminal is "equilibrium" and a solver answered.
        """
        if not self._seeks:
            return np.nan
        return float(np.abs(self.goal[-1] - self.y_steady)[self.sized.mask > 0].max(initial=0.0))

    @property
    def violation(self) -> Array:
        """How far the plan misses the terminal condition, per output, shape (p,).

        For "hard" the least that any admissible plan misses (6.1c) by, each output taken alone; zero where it can hold.
        """
        terminal, tail = self.sized.base.terminal, self.sized.base.tail
        if terminal == "none":
            return np.zeros(self.sized.p)
        if terminal == "hard":
            return self.plan.unmet.copy()
        y = self.y_plan
        target = y[-1] if terminal == "equilibrium" else self.goal[-tail:]
        off = np.abs(y[-tail:] - target).max(axis=0)
        return np.asarray(np.where(self.sized.mask > 0, off, 0.0))

    @property
    def slack(self) -> Array:
        """Largest violation of the output limits per output, shape (p,)."""
        y = self.y_plan
        over = np.maximum(self.sized.y_min - y, y - self.sized.y_max)
        return np.asarray(np.maximum(over.max(axis=0), 0.0))

    @property
    def feasible(self) -> bool:
        """Whether the terminal condition and the output limits hold for the plan, to 1e-4 of the outputs' size."""
        tolerance = 1e-4 * np.maximum(self.plan.scale[1], np.abs(self.y_plan).max(axis=0))
        return bool((self.violation <= tolerance).all() and (self.slack <= tolerance).all())

    @property
    def cost(self) -> float:
        """Value of (6.1a) at the plan: the sum of |y - y_ref|_Q^2 + |u|_R^2, the mask applied to Q."""
        e = (self.y_plan - self.goal) * np.sqrt(self.sized.mask)
        u = self.u_plan
        return float(np.sum((e @ self.sized.Q) * e) + np.sum((u @ self.sized.R) * u))
