# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The online DeePC controller: observe, step, prepare."""

from collections.abc import Iterable
from dataclasses import replace
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ros2_deepc.behavior import DataWindow
from ros2_deepc.behavior.hankel import Array
from ros2_deepc.behavior.window import as_sample

from .limiter import Limiter
from .planner import Plan, Planner
from .policy import RunData
from .reach import unholdable
from .result import NotReadyError, Status, StepResult
from .settings import LIVE, DeepcSettings, Sized, size

DITHER_STREAM = 2  # of the seed; 0 and 1 belong to plants and excitation


class DeepcController:
    """Data-enabled predictive control from the data of this very run (paper, section 6).

    One sample is one `observe`, then one `step` for the next input that is still free:

        controller.observe(u, y)            # (u(k), y(k))
        if controller.ready:
            result = controller.step(y_ref) # result.u is u(k+s)

    With index s >= 2 the outputs y(k) exist only once u(k+s-1) is known, so u(k+1), ..., u(k+s-1) are already decided:
    the controller takes its own answers for them, or what `commit` tells it.

    The same samples give the same answers to the last bit, whenever `prepare` is called.

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
        self._dithers = bool(self._sized.dither.any())
        self.reset()

    @property
    def settings(self) -> DeepcSettings:
        """The settings in force."""
        return self._sized.base

    def reset(self) -> None:
        """Forgets all data: a new run begins."""
        base = self._sized.base
        self._dropped = np.zeros(self._sized.p, dtype=bool)
        self._sized = self._with_mask(self._sized)
        self._data = RunData(self._sized)
        self._recent = DataWindow(self._sized.m + base.disturbances, self._sized.p, base.past)
        rows = np.arange(base.past * (self._sized.m + base.disturbances + self._sized.p)).reshape(base.past, -1)
        ends = np.cumsum([self._sized.m, base.disturbances])
        # places of [u; d; y] over the past samples in a record of whole samples
        self._by_channel = np.concatenate([part.ravel() for part in np.split(rows, ends, axis=1)])
        self._planner = Planner(self._sized)
        self._rng = np.random.Generator(np.random.PCG64([base.seed, DITHER_STREAM]))
        self._ahead: list[Array] = []  # known inputs after the last observed sample
        self._answer: Array | None = None  # step's own answer, taken as committed unless something else is
        self._last: Array | None = None  # the input one sample before the next free one
        self._plan: tuple[int, Plan] | None = None  # the last checked plan and when it was made
        self._goal = np.empty((0, self._sized.p))  # the reference over the plan
        self._goal_vector = np.empty(0)
        self._goal_key: tuple[tuple[int, ...], bytes] | None = None
        self._instant = 0
        self._due = False  # the window has moved since the last preparation
        self._prepare_time = 0.0

    def tune(self, **changes: Any) -> None:
        """Changes settings that need no new data, from the next sample on: weights, limits, mask, terminal, solver, ...

        Raises:
            ValueError: if a setting is not among those, or does not fit the others; nothing is then changed.
        """
        if wrong := sorted(set(changes) - LIVE):
            raise ValueError(f"{', '.join(wrong)} cannot change while running; these can: {', '.join(sorted(LIVE))}")
        self._adopt(size(replace(self._sized.base, **changes), self._sized.m, self._sized.p))

    def drop(self, outputs: ArrayLike) -> None:
        """Outputs that are not chased from the next sample on, whatever the settings' mask says; until told otherwise.

        Args:
            outputs: booleans, shape (p,).

        Raises:
            ValueError: for a wrong size.
        """
        dropped = np.array(outputs, dtype=bool)
        if dropped.shape != (self._sized.p,):
            raise ValueError(f"outputs has shape {dropped.shape}: give ({self._sized.p},) booleans")
        if (dropped != self._dropped).any():
            self._dropped = dropped
            self._adopt(self._sized)

    def unholdable(self, modes: Iterable[complex]) -> Array:
        """Outputs that cannot be held if the inputs do not reach these modes, by the data in use; booleans, shape (p,).

        None while the data do not suffice yet. See `reach.unholdable`.
        """
        if self._data.missing():
            return np.zeros(self._sized.p, dtype=bool)
        return unholdable(self._data.predictor(), modes, self._sized, self._data.scale)

    # What the data can do

    @property
    def ready(self) -> bool:
        """Whether `step` will answer: the data are rich and the past is known."""
        return not self.missing()

    @property
    def rank(self) -> int:
        """Numerical rank of the window's data matrix [H_{N+L+s-1}(u); H_{N+L}(y)].

        Like `gap` and `excitation_order` counted anew at most once in T/100 samples, once in T/20 under control.
        """
        return self._data.display.rank

    @property
    def rank_need(self) -> int:
        """Rank of rich data, m (N+L+s-1) + q; with q unknown, for the largest q that N allows."""
        return self._sized.rank_need

    @property
    def gap(self) -> float:
        """Singular value of the window's data matrix at its rank over the next one; infinity if there is none."""
        return self._data.display.gap

    @property
    def excitation_order(self) -> int:
        """Order of persistency of excitation of the inputs in the window; counted up to what is needed."""
        return self._data.display.excitation_order

    @property
    def excitation_need(self) -> int:
        """Order of excitation that Corollary 1 asks for, N + L + q + s - 1."""
        return self._sized.excitation_need

    @property
    def window_length(self) -> int:
        """Inputs in the data window."""
        return self._data.length

    @property
    def mask(self) -> Array:
        """Weight of each output in force, shape (p,): the settings' mask, zero for outputs that were dropped."""
        return self._sized.mask.copy()

    @property
    def weak(self) -> str:
        """One line on why the newest window is too weak, if it is; empty if not, or if the policy is "fixed"."""
        return self._data.weak

    def missing(self) -> str:
        """One line on what `step` still waits for; empty when ready."""
        if lacking := self._data.missing():
            return lacking
        past = self._recent.unbroken
        if past < self._sized.base.past:
            return f"{past} of the {self._sized.base.past} unbroken samples that fix the initial condition"
        return ""

    # One sample

    def observe(self, u: ArrayLike, y: ArrayLike, d: ArrayLike | None = None) -> None:
        """Takes one sample, in time order.

        Args:
            u: input that was applied, u(k), shape (m,).
            y: output, y(k), shape (p,).
            d: measured disturbances d(k), shape (disturbances,), if the settings have any.

        Raises:
            ValueError: on wrong shapes, NaN or infinity; nothing is then taken. Call `cut` if the sample is lost.
        """
        base = self._sized.base
        u, y = as_sample(u, self._sized.m, "u"), as_sample(y, self._sized.p, "y")
        parts = [u, as_sample([] if d is None else d, base.disturbances, "d"), y] if base.disturbances else [u, y]
        w = np.concatenate(parts)
        self.prepare()
        if self._answer is not None:
            self._ahead.append(self._answer)
            self._answer = None
        if self._ahead:
            del self._ahead[0]
        self._recent.append(w)
        known = self._ahead[: base.s - 1]
        self._last = known[-1] if len(known) == base.s - 1 > 0 else u
        self._data.observe(w, [] if base.disturbances else known)
        self._instant += 1

    def commit(self, u: ArrayLike) -> None:
        """Says which input follows the last known one, in place of the answer of the last `step`.

        Raises:
            ValueError: on a wrong shape, NaN or infinity.
        """
        self._ahead.append(as_sample(u, self._sized.m, "u"))
        self._answer = None

    def cut(self) -> None:
        """Samples were lost: the next one starts a new record of the same run. No column of the data spans the gap."""
        self._data.cut()
        self._recent.cut()
        self._ahead, self._answer, self._plan = [], None, None

    def prepare(self) -> None:
        """Does the work of the next step that does not need its sample; best called once the command is out.

        If it is not called, the next `observe` does it first.
        """
        if self._due:
            self._load()
        self._planner.settle()

    def step(self, y_ref: ArrayLike, forecast: ArrayLike | None = None) -> StepResult:
        """Plans from the newest sample and answers with the first input that is still free.

        Args:
            y_ref: reference, shape (p,), or its trajectory over the plan, shape (L, p), row 0 for y(k+1).
            forecast: measured disturbances to come, shape (L+s-1, disturbances), row 0 for d(k+1); the last one
                measured if None.

        Returns:
            The step's result; ``u`` is u(k+s) if y(k) was the last output observed. Always an admissible input.

        Raises:
            NotReadyError: if the data do not suffice yet.
            ValueError: if the reference or the forecast has a wrong size or is not finite.
        """
        begin = perf_counter()
        self._follow(y_ref)
        if lacking := self.missing():
            raise NotReadyError(f"not ready: {lacking}")
        w = self._known(forecast)
        if not self._planner.loaded:
            self._load()
        if not self._due:  # in case there was no sample in between
            self._planner.settle()
        plan, remark = self._planner.plan(w, self._goal_vector)
        if plan is None:
            status, plan = self._without_solution(remark)
        else:
            self._plan = (self._instant, plan)
            status = Status.SECOND_SOLVER if plan.second else Status.SOLVED
        wanted = plan.first(self._sized.m) + self._dither()
        u = self._limiter.apply(wanted, self._last)
        self._answer, self._due = u, self._data.moves
        return StepResult(
            u=u.copy(),
            status=status,
            wanted=wanted,
            goal=self._goal,
            plan=plan,
            sized=self._sized,
            prepare_time=self._prepare_time,
            solve_time=perf_counter() - begin,
        )

    # Inside

    def _with_mask(self, sized: Sized) -> Sized:
        """The settings with the mask that they give, less the outputs that were dropped."""
        mask = size(sized.base, sized.m, sized.p).mask
        return replace(sized, mask=np.where(self._dropped, 0.0, mask))

    def _adopt(self, sized: Sized) -> None:
        """Takes settings that need no new data; the program follows in the next preparation."""
        self._sized = sized = self._with_mask(sized)
        self._limiter = Limiter(sized.u_min, sized.u_max, sized.du_max)
        self._dithers = bool(sized.dither.any())
        self._due = self._planner.loaded
        self._planner = Planner(sized)
        self._data.adjust(sized)
        self._goal_key = None

    def _load(self) -> None:
        """Brings the program up to date with the window."""
        begin = perf_counter()
        self._planner.load(self._data.predictor(), self._data.scale)
        self._due = False
        self._prepare_time = perf_counter() - begin

    def _dither(self) -> Array | float:
        """White noise that keeps the data rich, where it is wanted."""
        if not self._data.moves or (self._sized.base.data_policy == "guarded" and not self._data.weak):
            return 0.0
        amplitude = self._sized.dither
        return amplitude * (2.0 * self._rng.random(amplitude.size) - 1.0) if self._dithers else 0.0

    def _follow(self, y_ref: ArrayLike) -> None:
        """Takes the reference, if it is another one than before."""
        L, p = self._sized.base.L, self._sized.p
        a = np.asarray(y_ref, dtype=np.float64)
        key = (a.shape, a.tobytes())
        if key == self._goal_key:
            return
        if a.shape == () and p == 1:
            a = a.reshape(1)
        if a.shape not in ((p,), (L, p)):
            raise ValueError(f"y_ref has shape {a.shape}: give ({p},), or ({L}, {p}) for a trajectory over the plan")
        if not np.isfinite(a).all():
            raise ValueError("y_ref must be finite")
        self._goal = np.array(np.broadcast_to(a, (L, p)))
        self._goal.flags.writeable = False
        self._goal_key, self._goal_vector = key, self._goal.ravel()

    def _known(self, forecast: ArrayLike | None) -> Array:
        """What the plan starts from: [past and committed inputs; disturbances; past outputs]."""
        base, m = self._sized.base, self._sized.m
        ahead = base.s - 1
        if len(self._ahead) < ahead:
            lacking = ahead - len(self._ahead)
            raise NotReadyError(f"not ready: with s = {base.s}, commit() the {lacking} input(s) after the last sample")
        past = self._recent.last(base.past)
        by_channel: Array = past.ravel()[self._by_channel]
        if not ahead and not base.disturbances:
            return by_channel
        u, d_past, y = np.split(by_channel, [base.past * m, base.past * (m + base.disturbances)])
        nd, rows = base.disturbances, base.L + ahead
        d = np.asarray(past[-1, m : m + nd] if forecast is None else forecast, dtype=np.float64)
        if d.shape not in ((nd,), (rows, nd)):
            raise ValueError(f"forecast has shape {d.shape}: give ({nd},) or ({rows}, {nd})")
        if not np.isfinite(d).all():
            raise ValueError("forecast must be finite")
        d = np.broadcast_to(d, (rows, nd))
        return np.concatenate([u, *self._ahead[:ahead], d_past, d.ravel(), y])

    def _without_solution(self, remark: str) -> tuple[Status, Plan]:
        """The last checked plan shifted to now, or the fallback."""
        L, m, p = self._sized.base.L, self._sized.m, self._sized.p
        made, last = self._plan or (self._instant - L, None)
        age = self._instant - made
        if last is not None and age < L:
            u, y = last.u(m), last.y(p)
            u = np.vstack([u[age:], np.tile(u[-1], (age, 1))])
            y = np.vstack([y[age:], np.full((age, p), np.nan)])
            return Status.SHIFTED_PLAN, Plan(None, last.scale, u, y, False, "", 0, remark, last.unmet)
        held = self._last if self._last is not None else np.zeros(m)
        u = np.tile(held if self._sized.base.fallback == "hold" else self._sized.u_safe, (L, 1))
        nan = np.full((L, p), np.nan)
        return Status.FALLBACK, Plan(None, (np.ones(m), np.ones(p)), u, nan, False, "", 0, remark, nan[0])
