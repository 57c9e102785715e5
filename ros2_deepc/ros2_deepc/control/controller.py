# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The online DeePC controller: observe, step, prepare."""

from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike

from ros2_deepc.behavior import DataWindow
from ros2_deepc.behavior.hankel import Array
from ros2_deepc.behavior.window import as_sample

from .data import RunData
from .limiter import Limiter
from .problem import Condensed, condense, masked
from .qp import CheckedSolver
from .result import NotReadyError, Status, StepResult
from .settings import DeepcSettings, size


class DeepcController:
    """Data-enabled predictive control from the data of this very run (paper, section 6).

    One sample is one `observe`, then one `step` for the next input that is still free:

        controller.observe(u, y)            # (u(k), y(k))
        if controller.ready:
            result = controller.step(y_ref) # result.u is u(k+s)

    With index s >= 2 the outputs y(k) exist only once u(k+s-1) is known, so u(k+1), ..., u(k+s-1) are already decided:
    the controller takes its own answers for them, or what `commit` tells it.

    Args:
        m: number of inputs.
        p: number of outputs.
        settings: see `DeepcSettings`.

    Raises:
        ValueError: if the settings cannot work; the message names the number that would.
    """

    def __init__(self, m: int, p: int, settings: DeepcSettings) -> None:
        self._sized = size(settings, m, p)
        self._limiter = Limiter(self._sized.u_min, self._sized.u_max, self._sized.du_max)
        self.reset()

    @property
    def settings(self) -> DeepcSettings:
        """The settings in force."""
        return self._sized.base

    def reset(self) -> None:
        """Forgets all data: a new run begins."""
        self._data = RunData(self._sized)
        self._recent = DataWindow(self._sized.m, self._sized.p, self._sized.base.N)
        self._ahead: list[Array] = []  # known inputs after the last observed sample
        self._answer: Array | None = None  # step's own answer, taken as committed unless something else is
        self._last: Array | None = None  # the input one sample before the next free one
        self._program: Condensed | None = None
        self._solver = CheckedSolver(self._sized.base.solver)
        self._plan: tuple[int, Array, Array] | None = None  # instant, inputs and outputs of the last checked plan
        self._instant = 0
        self._prepare_time = 0.0

    # What the data can do

    @property
    def ready(self) -> bool:
        """Whether `step` will answer: the data are rich and the past is known."""
        return not self.missing()

    @property
    def rank(self) -> int:
        """Numerical rank of the data matrix [H_{N+L+s-1}(u); H_{N+L}(y)]."""
        return self._data.rank

    @property
    def rank_need(self) -> int:
        """Rank of rich data, m (N+L+s-1) + q; with q unknown, for the largest q that N allows."""
        return self._sized.rank_need

    @property
    def gap(self) -> float:
        """Singular value of the data matrix at its rank over the next one; infinity if there is none."""
        return self._data.gap

    @property
    def excitation_order(self) -> int:
        """Order of persistency of excitation of the inputs in the window; counted up to what is needed."""
        return self._data.excitation_order

    @property
    def excitation_need(self) -> int:
        """Order of excitation that Corollary 1 asks for, N + L + q + s - 1."""
        return self._sized.excitation_need

    @property
    def window_length(self) -> int:
        """Inputs in the data window."""
        return self._data.length

    def missing(self) -> str:
        """One line on what `step` still waits for; empty when ready."""
        if lacking := self._data.missing():
            return lacking
        past = len(self._recent.newest().u)
        if past < self._sized.base.N:
            return f"{past} of the N = {self._sized.base.N} unbroken samples that fix the initial condition"
        return ""

    # One sample

    def observe(self, u: ArrayLike, y: ArrayLike) -> None:
        """Takes one sample, in time order.

        Args:
            u: input that was applied, u(k), shape (m,).
            y: output, y(k), shape (p,).

        Raises:
            ValueError: on wrong shapes, NaN or infinity; nothing is then taken. Call `cut` if the sample is lost.
        """
        u, y = as_sample(u, self._sized.m, "u"), as_sample(y, self._sized.p, "y")
        if self._answer is not None:
            self.commit(self._answer)
        self._ahead = self._ahead[1:]
        self._recent.push(u, y)
        self._last = self._ahead[self._sized.base.s - 2] if len(self._ahead) >= self._sized.base.s - 1 > 0 else u
        self._data.observe(u, y, self._ahead[: self._sized.base.s - 1])
        self._instant += 1

    def commit(self, u: ArrayLike) -> None:
        """Says which input follows the last known one, in place of the answer of the last `step`.

        Needed for s >= 2 only, where inputs are decided before the outputs that they shape are seen.

        Raises:
            ValueError: on a wrong shape, NaN or infinity.
        """
        self._ahead = [*self._ahead, as_sample(u, self._sized.m, "u")]
        self._answer = None

    def cut(self) -> None:
        """Samples were lost: the next one starts a new record of the same run. No column of the data spans the gap."""
        self._data.cut()
        self._recent.cut()
        self._ahead, self._answer, self._plan = [], None, None

    def prepare(self) -> None:
        """Does the work of the next step that does not need its sample; best called once the command is out."""
        if self._program is not None or self._data.missing():
            return
        begin = perf_counter()
        s, m = self._sized.base, self._sized.m
        last = slice(m * (s.N + s.s - 2), m * (s.N + s.s - 1))
        self._program = condense(self._data.predictor(), self._sized, last, s.terminal)
        self._solver.load(self._program.H, self._program.A)
        self._prepare_time = perf_counter() - begin

    def step(self, y_ref: ArrayLike) -> StepResult:
        """Plans from the newest sample and answers with the first input that is still free.

        Args:
            y_ref: reference, shape (p,), or its trajectory over the plan, shape (L, p), row 0 for y(k+1).

        Returns:
            The step's result; ``u`` is u(k+s) if y(k) was the last output observed. Always an admissible input.

        Raises:
            NotReadyError: if the data do not suffice yet.
            ValueError: if the reference has a wrong size or is not finite.
        """
        begin = perf_counter()
        goal = self._reference(y_ref)
        if lacking := self.missing():
            raise NotReadyError(f"not ready: {lacking}")
        w = self._known()
        self.prepare()
        program = self._program
        assert program is not None  # missing() was empty, so prepare built it
        theta = np.concatenate([w, goal.ravel()])
        f = program.f0 + program.f_theta @ theta
        move = np.concatenate([np.zeros(f.size), program.shift @ theta])
        answer, which, complaint = self._solver.solve(f, program.lower - move, program.upper - move)
        if answer is None:
            return self._without_solution(goal, complaint, begin)
        u_plan = (program.inputs @ answer.x).reshape(-1, self._sized.m)
        y_plan = (program.outputs @ answer.x + program.outputs_theta @ theta).reshape(-1, self._sized.p)
        self._plan = (self._instant, u_plan, y_plan)
        status = Status.SOLVED if which == 0 else Status.SECOND_SOLVER
        return self._result(
            status, complaint, u_plan, y_plan, goal, answer.iterations, self._solver.solvers[which].name, begin
        )

    # Inside

    def _reference(self, y_ref: ArrayLike) -> Array:
        """The reference over the plan, shape (L, p)."""
        L, p = self._sized.base.L, self._sized.p
        a = np.asarray(y_ref, dtype=np.float64)
        if a.shape == () and p == 1:
            a = a.reshape(1)
        if a.shape not in ((p,), (L, p)):
            raise ValueError(f"y_ref has shape {a.shape}: give ({p},), or ({L}, {p}) for a trajectory over the plan")
        if not np.isfinite(a).all():
            raise ValueError("y_ref must be finite")
        return np.array(np.broadcast_to(a, (L, p)))

    def _known(self) -> Array:
        """What the plan starts from: [past and committed inputs; past outputs]."""
        ahead = self._sized.base.s - 1
        if len(self._ahead) < ahead:
            lacking = ahead - len(self._ahead)
            raise NotReadyError(
                f"not ready: with s = {ahead + 1}, commit() the {lacking} input(s) after the last sample"
            )
        past = self._recent.newest()
        return np.concatenate([past.u.ravel(), *self._ahead[:ahead], past.y.ravel()])

    def _without_solution(self, goal: Array, complaint: str, begin: float) -> StepResult:
        """The last checked plan shifted to now, or the fallback."""
        L, m, p = self._sized.base.L, self._sized.m, self._sized.p
        age = self._instant - self._plan[0] if self._plan else L
        if self._plan and age < L:
            u_plan, y_plan = self._plan[1], self._plan[2]
            u_plan = np.vstack([u_plan[age:], np.tile(u_plan[-1], (age, 1))])
            y_plan = np.vstack([y_plan[age:], np.full((age, p), np.nan)])
            return self._result(Status.SHIFTED_PLAN, complaint, u_plan, y_plan, goal, 0, "", begin)
        held = self._last if self._last is not None else np.zeros(m)
        u = held if self._sized.base.fallback == "hold" else self._sized.u_safe
        nothing = np.full((L, p), np.nan)
        return self._result(Status.FALLBACK, complaint, np.tile(u, (L, 1)), nothing, goal, 0, "", begin)

    def _result(
        self,
        status: Status,
        complaint: str,
        u_plan: Array,
        y_plan: Array,
        goal: Array,
        iterations: int,
        solver: str,
        begin: float,
    ) -> StepResult:
        """Limits the first input and says all there is to say."""
        sized = self._sized
        u = self._limiter.apply(u_plan[0], self._last)
        self._answer = u
        scale = float(np.abs(u_plan).max(initial=1.0))
        limited = bool(np.abs(u - u_plan[0]).max() > 1e-4 * scale)
        seeks = sized.base.terminal == "equilibrium" and status.solved
        y_s = y_plan[-1].copy() if seeks else np.full(sized.p, np.nan)
        u_s = u_plan[-1].copy() if seeks else np.full(sized.m, np.nan)
        counts = sized.mask > 0
        distance = float(np.abs(goal[-1] - y_s)[counts].max(initial=0.0)) if seeks else np.nan
        violation = self._terminal_violation(y_plan, y_s if seeks else goal[-1])
        slack = np.maximum(np.maximum(sized.y_min - y_plan, y_plan - sized.y_max).max(axis=0), 0.0)
        tolerance = 1e-4 * np.maximum(1.0, np.abs(y_plan).max(axis=0))
        e = y_plan - goal
        cost = float(np.einsum("ki,ij,kj", e, masked(sized), e) + np.einsum("ki,ij,kj", u_plan, sized.R, u_plan))
        return StepResult(
            u=u.copy(),
            status=status,
            reason=complaint,
            u_plan=u_plan.copy(),
            y_plan=y_plan.copy(),
            u_steady=u_s,
            y_steady=y_s,
            distance=distance,
            feasible=bool((violation <= tolerance).all() and (slack <= tolerance).all()),
            violation=violation,
            slack=slack,
            cost=cost,
            limited=limited,
            iterations=iterations,
            solver=solver,
            prepare_time=self._prepare_time,
            solve_time=perf_counter() - begin,
        )

    def _terminal_violation(self, y_plan: Array, target: Array) -> Array:
        """Largest |y - target| over the terminal steps per output that counts."""
        sized = self._sized
        if sized.base.terminal == "none":
            return np.zeros(sized.p)
        off = np.abs(y_plan[-sized.base.tail :] - target).max(axis=0)
        return np.where(sized.mask > 0, off, 0.0)
