# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""From a predictor to plans: the program, its solvers, and what to do when (6.1c) cannot hold."""

from typing import NamedTuple

import numpy as np

from ros2_deepc.behavior.hankel import Array

from .predictor import Predictor
from .problem import Condensed, Template, condense
from .qp import CheckedSolver, Daqp
from .settings import Sized, Terminal
from .transform import Scales

RESTLESS = "no plan within the limits ends at rest: what is missing is priced"
FEASIBLE = 1e-6  # a terminal condition missed by less than this, relative to the signals' size, holds


class Plan(NamedTuple):
    """A checked plan; inputs and outputs are worked out from the solution when they are asked for.

    Attributes:
        program: the program solved; None for a plan that was made otherwise.
        scale: units of inputs, (m,), and outputs, (p,), in that program.
        x: its solution; or the inputs themselves, shape (L, m).
        w: what it started from; or the outputs themselves, shape (L, p).
        second: whether the second solver had to be used.
        solver: name of the solver that answered.
        iterations: its iterations.
        remark: what went wrong on the way, one line; empty if nothing.
        unmet: for "hard" only: smallest possible violation of (6.1c) per output, each taken alone, shape (p,); all zero
            if (6.1c) holds.
    """

    program: Condensed | None
    scale: tuple[Array, Array]
    x: Array
    w: Array
    second: bool
    solver: str
    iterations: int
    remark: str
    unmet: Array

    def first(self, m: int) -> Array:
        """The first planned input, shape (m,)."""
        u: Array = self.x[0] if self.program is None else self.x[:m] * self.scale[0]
        return u

    def u(self, m: int) -> Array:
        """Planned inputs, shape (L, m)."""
        if self.program is None:
            return self.x.copy()
        u: Array = self.program.inputs @ self.x
        return u.reshape(-1, m) * self.scale[0]

    def y(self, p: int) -> Array:
        """Predicted outputs, shape (L, p)."""
        if self.program is None:
            return self.w.copy()
        y: Array = self.program.outputs @ self.x + self.program.outputs_w @ self.w
        return y.reshape(-1, p) * self.scale[1]


class _Branch:
    """One program with its solvers.

    Args:
        template: what the program owes to the settings.
        scales: its units.
    """

    def __init__(self, template: Template, scales: Scales) -> None:
        self.template, self.solver = template, CheckedSolver(template.sized.base.solver)
        self._scale = (scales.u, scales.y)
        self.program: Condensed | None = None
        self._restless = False  # whether the last plan could not end at rest
        self._goal: Array | None = None
        self._f_goal = np.empty(0)

    def load(self, predictor: Predictor) -> Condensed:
        self.program = program = condense(self.template, predictor)
        self.solver.load(program)
        if self._goal is not None:
            self._f_goal = program.f0 + program.f_goal @ self._goal
        return program

    def plan(self, w: Array, r: Array, unmet: Array) -> tuple[Plan | None, str]:
        program = self.program
        assert program is not None  # load comes first
        if self._goal is not r:  # a reference stays for many samples: its share of the program is kept
            self._goal = r
            self._f_goal = program.f0 + program.f_goal @ r
        f: Array = self._f_goal + program.f_w.dot(w)  # dot: half the time of @ at this size
        lower, upper = program.lower, program.upper
        if program.A.shape[0]:
            move = self.template.from_here(w, program.A_w) + program.A_goal @ r
            lower, upper = lower.copy(), upper.copy()
            lower[f.size :] -= move
            upper[f.size :] -= move
        # Where there was no plan at rest, there is hardly one a sample later: only an exact solver is asked for it.
        answer, failed, remark = self.solver.solve(f, lower, upper, exactly=self._restless)
        self._restless = False
        if answer is None and program.rests:
            answer, failed, remark = self.solver.solve(f, *program.eased(lower, upper))
            remark = f"{RESTLESS}; {remark}" if remark else RESTLESS
            self._restless = answer is not None
        if answer is None:
            return None, remark
        return Plan(
            program, self._scale, answer.x, w, failed > 0, answer.solver, answer.iterations, remark, unmet
        ), remark


class Planner:
    """Solves the program of one predictor after another, in units of its own.

    Args:
        sized: settings.
    """

    def __init__(self, sized: Sized) -> None:
        self._sized = sized
        self._scales: Scales | None = None
        self._main: _Branch | None = None
        self._relaxed: _Branch | None = None
        self._tests: list[_Reach] = []
        self._predictor: Predictor | None = None
        self._goal: tuple[Array, Array] | None = None  # a reference, and the same in the program's units
        self._nothing = np.zeros(sized.p)

    @property
    def loaded(self) -> bool:
        """Whether there is a predictor to plan with."""
        return self._main is not None

    def load(self, predictor: Predictor, scale: tuple[Array, Array]) -> None:
        """Takes a predictor; everything that does not need the newest sample is worked out here, unless it is known.

        Args:
            predictor: in the units of the plant.
            scale: sizes of inputs and disturbances, (m + disturbances,), and of outputs, (p,); the same at every call.
        """
        if predictor is self._predictor:
            return
        self._predictor = predictor
        if self._scales is None or self._main is None:
            self._scales = Scales(*scale, self._sized)
            self._main = self._branch(self._scales, self._sized.base.terminal)
            if self._sized.base.terminal == "hard":
                self._relaxed = self._branch(self._scales, "soft")
        scaled = self._scales.predictor(predictor)
        program = self._main.load(scaled)
        if self._relaxed is not None:
            self._relaxed.load(scaled)
            p = self._sized.p
            every = [np.arange(p)] + [np.array([i]) for i in range(p)]
            self._tests = [_Reach(self._main.template, program, outputs) for outputs in every]

    def _branch(self, scales: Scales, terminal: Terminal) -> _Branch:
        base, m = self._sized.base, self._sized.m
        known = base.past + base.s - 1
        last_input = slice(m * (known - 1), m * known)
        size = m * known + base.disturbances * (known + base.L) + self._sized.p * base.past
        return _Branch(Template(scales.sized, size, last_input, terminal), scales)

    def settle(self) -> None:
        """Work for the next step that the last answer allows for."""
        if self._main is not None:
            self._main.solver.settle()
        if self._relaxed is not None:
            self._relaxed.solver.settle()

    def plan(self, w: Array, r: Array) -> tuple[Plan | None, str]:
        """Plans from w = [known inputs; disturbances; past outputs] towards the reference trajectory r, shape (pL,).

        Hand over the same r as long as the reference stays the same.

        Returns:
            The plan, and a remark; no plan if no solver found one that passes the check.
        """
        assert self._main is not None  # load comes first
        assert self._scales is not None
        if self._goal is None or self._goal[0] is not r:
            self._goal = (r, self._scales.goal(r))
        w, r = self._scales.known(w), self._goal[1]
        if self._relaxed is None:
            return self._main.plan(w, r, self._nothing)
        unmet = self._unmet(w, r, self._scales.y)
        if not unmet.any():
            return self._main.plan(w, r, unmet)
        plan, remark = self._relaxed.plan(w, r, unmet)
        shares = ", ".join(f"{v:.3g}" for v in unmet)
        said = f"(6.1c) cannot hold: missed by at least ({shares}); planned with a penalty instead"
        said = f"{said}; {remark}" if remark else said
        if plan is None:
            return None, said
        return plan._replace(remark=said), said

    def _unmet(self, w: Array, r: Array, y_scale: Array) -> Array:
        """Zero if (6.1c) can hold, else the least each output must miss it by."""
        tolerance = FEASIBLE * max(1.0, float(np.abs(w).max()), float(np.abs(r).max()))
        together = self._tests[0].smallest(w, r)
        if together <= tolerance:
            return self._nothing
        alone = np.array([test.smallest(w, r) for test in self._tests[1:]])
        alone[alone <= tolerance] = 0.0
        if not alone.any():  # each can hold, but not all together
            alone[:] = together
        return np.where(self._sized.mask > 0, alone * y_scale, 0.0)


class _Reach:
    """Smallest t with |y - y_ref| <= t over the terminal steps, for some of the outputs, inputs within their limits.

    Args:
        template: input limits of "hard".
        program: maps of "hard".
        outputs: which outputs, indices.
    """

    RIDGE = 1e-9

    def __init__(self, template: Template, program: Condensed, outputs: Array) -> None:
        sized, self._template = template.sized, template
        p, L, n = sized.p, sized.base.L, program.inputs.shape[1]
        steps = np.arange(L - sized.base.tail, L)
        part = (steps[:, None] * p + outputs[sized.mask[outputs] > 0]).ravel()
        C, D, E = program.outputs[part], program.outputs_w[part], -np.eye(p * L)[part]
        limits, limits_w, limits_goal, low, high = template.rows.stacked()
        one, none = np.ones((part.size, 1)), np.zeros((limits.shape[0], 1))
        A = np.vstack([np.hstack([limits, none]), np.hstack([C, one]), np.hstack([C, -one])])
        self._A_w = np.vstack([limits_w, D, D])
        self._A_goal = np.vstack([limits_goal, E, E])
        far, zero = np.full(part.size, np.inf), np.zeros(part.size)
        self._lower = np.concatenate([template.lower, [0.0], low, zero, -far])
        self._upper = np.concatenate([template.upper, [np.inf], high, far, zero])
        self._n = n + 1
        self._solver = Daqp()
        H = np.diag(np.append(np.full(n, self.RIDGE), 1.0))
        self._solver.load(H, A, self._lower, self._upper)

    def smallest(self, w: Array, r: Array) -> float:
        """The smallest t; infinity if the limits themselves cannot be met."""
        move = np.concatenate([np.zeros(self._n), self._template.from_here(w, self._A_w) + self._A_goal @ r])
        answer = self._solver.solve(np.zeros(self._n), self._lower - move, self._upper - move)
        return float(answer.x[-1]) if answer.solved else np.inf
