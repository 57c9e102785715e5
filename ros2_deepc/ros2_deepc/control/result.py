# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""What a control step answers."""

from dataclasses import dataclass
from enum import IntEnum

from ros2_deepc.behavior.hankel import Array


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


@dataclass(frozen=True, slots=True, kw_only=True)
class StepResult:
    """One control step.

    Attributes:
        u: input to apply at the first instant that is still free, shape (m,); respects the box and the rate limits.
        status: how ``u`` came about.
        reason: one line for people; empty if all is well.
        u_plan: planned inputs from ``u`` on, shape (L, m).
        y_plan: predicted outputs from the next instant on, shape (L, p); NaN in status FALLBACK.
        u_steady: steady input aimed at, shape (m,); NaN unless terminal is "equilibrium".
        y_steady: steady output aimed at, shape (p,); NaN unless terminal is "equilibrium".
        distance: largest |y_ref - y_steady| over the outputs that count (mask > 0), in output units: how far the
            reference is from the nearest steady state in reach; NaN unless terminal is "equilibrium".
        feasible: whether the terminal condition and the output limits hold for the plan.
        violation: how far the plan misses the terminal condition, per output, shape (p,), output units; for "hard" the
            least that any admissible plan misses (6.1c) by, zero where it can hold.
        slack: largest violation of the output limits per output, shape (p,), output units.
        cost: value of (6.1a) at the plan, the sum of |y - y_ref|_Q^2 + |u|_R^2 with the mask applied to Q.
        limited: whether the limiter had to change the solver's input by more than rounding.
        iterations: iterations of the solver that answered.
        solver: its name; "" if none did.
        prepare_time: wall time of the last preparation [s].
        solve_time: wall time of this step, from call to answer [s].
    """

    u: Array
    status: Status
    reason: str
    u_plan: Array
    y_plan: Array
    u_steady: Array
    y_steady: Array
    distance: float
    feasible: bool
    violation: Array
    slack: Array
    cost: float
    limited: bool
    iterations: int
    solver: str
    prepare_time: float
    solve_time: float
