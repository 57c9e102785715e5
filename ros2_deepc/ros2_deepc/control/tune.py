# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Choice of N, L, T, q and form from a recorded run, by prediction error on stretches that were held out."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from itertools import pairwise, product

import numpy as np
from numpy.typing import ArrayLike

from ros2_deepc.behavior import Record, data_matrix
from ros2_deepc.behavior.hankel import Array, as_signal

from .data import Snapshot
from .layout import lay_out
from .predictor import PoorDataError
from .settings import DeepcSettings, Form, Sized, size
from .transform import Units, accumulate, unscale

SIMPLER = 1.02  # a simpler choice is taken if its error is at most this much larger
EXACT = 1e-9  # errors below it, in standard deviations, are rounding: all as good


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """One combination of settings and how well it predicts what it has not seen.

    Attributes:
        N: past samples.
        q: slow order kept; 0 for all directions above rounding.
        T: inputs in the window.
        form: "absolute" or "incremental".
        error: mean over steps, outputs and stretches of the root mean square error, in standard deviations of the
            outputs; infinity if the data cannot serve this combination.
        by_step: the same per step ahead, shape (L,), up to the longest horizon tried; empty if the data cannot serve.
        first: root mean square error one step ahead, per output, output units, shape (p,).
        remark: why the data cannot serve; empty if they can.
    """

    N: int
    q: int
    T: int
    form: Form
    error: float
    by_step: tuple[float, ...]
    first: tuple[float, ...]
    remark: str = ""

    @property
    def effort(self) -> tuple[int, int, int]:
        """What makes a choice simple: few past samples, few directions, little data."""
        return (self.N, self.q or 10**6, self.T)


@dataclass(frozen=True, slots=True, kw_only=True)
class Tuning:
    """The outcome.

    Attributes:
        settings: the settings given, with the choices made.
        best: the trial chosen.
        trials: all of them, best first.
        spread: standard deviation of each output over the record, shape (p,): the unit of the errors.
        naive: error by step of holding the last output, in the same unit, shape (L,).
    """

    settings: DeepcSettings
    best: Trial
    trials: tuple[Trial, ...]
    spread: tuple[float, ...]
    naive: tuple[float, ...]


def tune(
    u: ArrayLike,
    y: ArrayLike,
    base: DeepcSettings,
    *,
    N: Sequence[int] = (3, 4, 6, 8, 12),
    L: Sequence[int] = (8, 12, 16, 24),
    q: Sequence[int] = (0, 2, 4, 6, 8, 12),
    T: Sequence[int] = (0,),
    form: Sequence[Form] = ("absolute", "incremental"),
    tolerance: float = 0.2,
    folds: int = 4,
    jobs: int = 1,
    progress: Callable[[int, int, Trial], None] | None = None,
) -> Tuning:
    """Tries all combinations by rolling-origin evaluation and picks the simplest of the best.

    The record is cut into ``folds + 1`` stretches. Each but the first is predicted, window by window, from the T
    samples before it. Of all combinations within 2 % of the smallest error the one with the fewest past samples,
    directions and data is chosen. Then the horizon: the longest one at whose end the error stays below ``tolerance``,
    the shortest if none does.

    Args:
        u: inputs of a run, shape (K, m).
        y: outputs of the same samples, shape (K, p).
        base: all other settings; its N, L, q, T and form are replaced.
        N: candidates for the past samples.
        L: candidates for the horizon.
        q: candidates for the slow order, to which the free response is cut (the regularisation of the predictor); 0
            keeps all directions.
        T: candidates for the window; 0 takes the least that Corollary 1 asks for, in white inputs.
        form: candidates for the form.
        tolerance: acceptable error at the end of the horizon, in standard deviations of the outputs.
        folds: stretches to predict.
        jobs: processes; more than one needs joblib, and uses whatever backend it is set to (Dask on a cluster).
        progress: called after each trial with how many are done, how many there are, and the trial.

    Raises:
        ValueError: if the record is not finite, too short, or serves no combination (the message says why).
    """
    record = Record(as_signal(u, "u"), as_signal(y, "y"))
    if len(record.u) != len(record.y):
        raise ValueError(f"u has {len(record.u)} samples and y {len(record.y)}: they must cover the same instants")
    if min(len(N), len(L), len(q), len(T), len(form), folds) < 1:
        raise ValueError("give at least one candidate for each of N, L, q, T and form, and one fold")
    spread = record.y.std(axis=0)
    spread = np.where(spread > 0, spread, 1.0)
    longest = max(L)
    combinations = list(product(N, q, T, form))
    trials: list[Trial] = []
    for trial in _run(record, base, combinations, longest, folds, spread, jobs):
        trials.append(trial)
        if progress is not None:
            progress(len(trials), len(combinations), trial)
    trials.sort(key=lambda trial: (trial.error, trial.effort))
    if not np.isfinite(trials[0].error):
        raise ValueError(f"the record of {len(record.u)} samples serves no combination: {trials[0].remark}")
    good = [trial for trial in trials if trial.error <= max(SIMPLER * trials[0].error, EXACT)]
    best = min(good, key=lambda trial: trial.effort)
    lasting = [horizon for horizon in L if best.by_step[horizon - 1] <= tolerance]
    horizon = max(lasting) if lasting else min(L)
    tail = base.terminal_steps or best.N
    choice = {"N": best.N, "L": max(horizon, tail + 1), "q": best.q, "T": best.T, "form": best.form}
    return Tuning(
        settings=replace(base, **choice),  # type: ignore[arg-type]
        best=best,
        trials=tuple(trials),
        spread=tuple(spread.tolist()),
        naive=_naive(record, longest, spread),
    )


def _run(
    record: Record,
    base: DeepcSettings,
    combinations: list[tuple[int, int, int, Form]],
    longest: int,
    folds: int,
    spread: Array,
    jobs: int,
) -> Iterator[Trial]:
    """The trials, in order, one process or many."""
    tasks = [(record, base, combination, longest, folds, spread) for combination in combinations]
    if jobs == 1:
        yield from (_try(*task) for task in tasks)
        return
    try:
        joblib = import_module("joblib")
    except ImportError:
        raise ValueError(f"jobs = {jobs} needs joblib: pip install joblib") from None
    yield from joblib.Parallel(n_jobs=jobs, return_as="generator")(joblib.delayed(_try)(*task) for task in tasks)


def _try(
    record: Record,
    base: DeepcSettings,
    combination: tuple[int, int, int, Form],
    longest: int,
    folds: int,
    spread: Array,
) -> Trial:
    """One combination."""
    N, q, T, form = combination
    m, p = record.u.shape[1], record.y.shape[1]
    try:
        settings = replace(
            base, N=N, L=longest, q=q, T=T, form=form, terminal="none", disturbances=0, predictor="joint"
        )
        sized = size(settings, m, p)
        squares = [_squares(stretch, before, sized) for before, stretch in _stretches(record, sized, folds)]
    except (ValueError, PoorDataError) as error:
        return Trial(N=N, q=q, T=T, form=form, error=np.inf, by_step=(), first=(), remark=str(error))
    rms = np.sqrt(np.mean(squares, axis=0))  # (L, p)
    by_step = (rms / spread).mean(axis=1)
    return Trial(
        N=N,
        q=q,
        T=sized.T,
        form=form,
        error=float(by_step.mean()),
        by_step=tuple(by_step.tolist()),
        first=tuple(rms[0].tolist()),
    )


def _stretches(record: Record, sized: Sized, folds: int) -> Iterator[tuple[Record, Record]]:
    """Pairs of a window of T inputs and the stretch after it that is to be predicted, with the past it starts from."""
    K, T, s = len(record.u), sized.T, sized.base.s
    edges = np.linspace(0, K, folds + 2).astype(int)
    pairs = [(start, stop) for start, stop in pairwise(edges[1:]) if start >= T]
    enough = sized.rows_u + sized.base.past
    pairs = [(start, stop) for start, stop in pairs if stop - start >= enough]
    if not pairs:
        wanted = (folds + 1) * max(enough, -(-T // folds))
        raise ValueError(f"T = {T} and stretches of {enough} need a record of about {wanted} samples, got {K}")
    for start, stop in pairs:
        window = Record(record.u[start - T : start], record.y[start - T : start - s + 1])
        yield window, Record(record.u[start:stop], record.y[start:stop])


def _squares(stretch: Record, window: Record, sized: Sized) -> Array:
    """Mean square prediction error over all windows of a stretch, shape (L, p)."""
    layout = lay_out(sized)
    incremental = sized.base.form == "incremental"
    data = Record(np.diff(window.u, axis=0), np.diff(window.y, axis=0)) if incremental else window
    snapshot = Snapshot((data,), sized, layout)
    predictor = unscale(snapshot.predictor, Units.of(*snapshot.scale, sized))
    if incremental:
        predictor = accumulate(predictor, sized)
    absolute = size(replace(sized.base, N=sized.base.past, form="absolute", T=0), sized.m, sized.p)
    rows = lay_out(absolute)
    W = data_matrix([stretch], absolute.rows_u, absolute.rows_y)[rows.stacked]
    known = np.vstack([W[: rows.known_u], W[rows.inputs : rows.inputs + rows.context]])
    predicted = predictor.G @ W[rows.known_u : rows.inputs] + predictor.F @ known
    error = predicted - W[rows.inputs + rows.context :]
    return np.asarray(np.mean(error**2, axis=1).reshape(sized.base.L, sized.p))


def _naive(record: Record, longest: int, spread: Array) -> tuple[float, ...]:
    """Error by step of holding the last output."""
    y = record.y
    steps = range(1, longest + 1)
    return tuple(float(np.mean(np.sqrt(np.mean((y[k:] - y[:-k]) ** 2, axis=0)) / spread)) for k in steps)
