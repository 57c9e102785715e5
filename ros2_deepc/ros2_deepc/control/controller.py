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
from .planner import Plan, Planner
from .problem import masked
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
        self._planner = Planner(self._sized)
        self._plan: tuple[int, Plan] | None = None  # the last checked plan and when it was made
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
        if self._planner.loaded or self._data.missing():
            return
        begin = perf_counter()
        self._planner.load(self._data.predictor())
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
        plan, remark = self._planner.plan(w, goal)
        if plan is None:
            status, plan = self._without_solution(remark)
        else:
            self._plan = (self._instant, plan)
            status = Status.SECOND_SOLVER if plan.second else Status.SOLVED
        return self._result(status, plan, goal, begin)

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

    def _without_solution(self, remark: str) -> tuple[Status, Plan]:
        """The last checked plan shifted to now, or the fallback."""
        L, m, p = self._sized.base.L, self._sized.m, self._sized.p
        made, last = self._plan or (self._instant - L, None)
        age = self._instant - made
        if last is not None and age < L:
            u = np.vstack([last.u[age:], np.tile(last.u[-1], (age, 1))])
            y = np.vstack([last.y[age:], np.full((age, p), np.nan)])
            return Status.SHIFTED_PLAN, Plan(u, y, False, "", 0, remark, last.unmet)
        held = self._last if self._last is not None else np.zeros(m)
        u = held if self._sized.base.fallback == "hold" else self._sized.u_safe
        return Status.FALLBACK, Plan(
            np.tile(u, (L, 1)), np.full((L, p), np.nan), False, "", 0, remark, np.full(p, np.nan)
        )

    def _result(self, status: Status, plan: Plan, goal: Array, begin: float) -> StepResult:
        """Limits the first input and says all there is to say."""
        sized = self._sized
        u = self._limiter.apply(plan.u[0], self._last)
        self._answer = u
        seeks = sized.base.terminal == "equilibrium" and status.solved
        y_s = plan.y[-1].copy() if seeks else np.full(sized.p, np.nan)
        u_s = plan.u[-1].copy() if seeks else np.full(sized.m, np.nan)
        violation = self._violation(plan, y_s if seeks else goal[-1])
        slack = np.maximum(np.maximum(sized.y_min - plan.y, plan.y - sized.y_max).max(axis=0), 0.0)
        tolerance = 1e-4 * np.maximum(1.0, np.abs(plan.y).max(axis=0))
        e = plan.y - goal
        return StepResult(
            u=u.copy(),
            status=status,
            reason=plan.remark,
            u_plan=plan.u.copy(),
            y_plan=plan.y.copy(),
            u_steady=u_s,
            y_steady=y_s,
            distance=float(np.abs(goal[-1] - y_s)[sized.mask > 0].max(initial=0.0)) if seeks else np.nan,
            feasible=bool((violation <= tolerance).all() and (slack <= tolerance).all()),
            violation=violation,
            slack=slack,
            cost=float(np.einsum("ki,ij,kj", e, masked(sized), e) + np.einsum("ki,ij,kj", plan.u, sized.R, plan.u)),
            limited=bool(np.abs(u - plan.u[0]).max() > 1e-4 * np.abs(plan.u).max(initial=1.0)),
            iterations=plan.iterations,
            solver=plan.solver,
            prepare_time=self._prepare_time,
            solve_time=perf_counter() - begin,
        )

    def _violation(self, plan: Plan, target: Array) -> Array:
        """How far the plan misses its terminal condition, per output; for "hard" the least it could."""
        sized = self._sized
        if sized.base.terminal == "none":
            return np.zeros(sized.p)
        if sized.base.terminal == "hard":
            return plan.unmet.copy()
        off = np.abs(plan.y[-sized.base.tail :] - target).max(axis=0)
        return np.where(sized.mask > 0, off, 0.0)
