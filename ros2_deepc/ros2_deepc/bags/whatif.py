# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""What another controller would have done on the data of a recorded run."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ros2_deepc.control import DeepcController

from .errors import BagError
from .progress import Progress, no_progress
from .recording import Recording
from .run import Run

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WhatIf:
    """The answers of a controller that watched a run and moved nothing.

    Attributes:
        u: inputs it would have given, shape (K, m), in the rows of the samples they are for; NaN where it had none.
        solved: number of optimisations that were solved.
        failed: number that were not.
        first, first_k: row and index k of the sample that its first answer is for, or -1.
        furthest: largest distance from the recorded input per input, shape (m,); NaN without an answer.
        missing: why it never answered; empty if it did.
    """

    u: Array
    solved: int
    failed: int
    first: int
    first_k: int
    furthest: Array
    missing: str


def what_if(run: Run | Recording, controller: DeepcController, *, progress: Progress = no_progress) -> WhatIf:
    """Lets a controller watch the recorded inputs and outputs, and asks it for an input at every sample.

    It sees what the real controller saw, with the references that were in use; what it answers is not applied, so that
    every answer is a first move from the recorded state.

    Args:
        run: the recorded run; of a ``Recording``, only the answers are in memory as a whole.
        controller: a fresh one with the settings to try.
        progress: called now and then with rows done and in all.

    Raises:
        BagError: if the run has no inputs, or the controller is for another number of channels.
    """
    s, total = max(controller.settings.s, 1), len(run)
    m = next(iter(run.stretches())).u.shape[1]
    if not m:
        raise BagError("this run has no inputs: nothing can be asked")
    answers, furthest, first = np.full((total, m), np.nan), np.full(m, np.nan), (-1, -1)
    counts = {True: 0, False: 0}
    fresh = True
    for row, seen in enumerate(_rows(run, s)):
        if row % 1000 == 0:
            progress(row, total)
        known = len(seen.inputs) >= s and np.isfinite(seen.inputs[:s]).all()
        if (seen.gap or not known) and not fresh:
            controller.cut()
            fresh = True
        if not known:
            continue
        for decided in seen.inputs[0 if fresh else s - 1 : s]:
            controller.commit(decided)  # with s > 1, inputs after k are decided before y(k) is seen
        controller.observe(seen.inputs[0], seen.y)
        fresh = False
        if row + s < total and controller.ready and np.isfinite(seen.target).all():
            result = controller.step(seen.target)
            counts[result.status.solved] += 1
            answers[row + s] = result.u
            furthest = np.fmax(furthest, np.abs(result.u - seen.inputs[s]))
            first = (row + s, seen.k_after) if first[0] < 0 else first
    progress(total, total)
    return WhatIf(
        u=answers,
        solved=counts[True],
        failed=counts[False],
        first=first[0],
        first_k=first[1],
        furthest=furthest,
        missing="" if first[0] >= 0 else controller.missing() or "no reference was recorded",
    )


class _Row(NamedTuple):
    """A sample as a controller sees it.

    Attributes:
        gap: whether samples are missing before it.
        inputs: from this sample on, s + 1 of them; fewer where the recording ends.
        y: outputs.
        target: reference of the next sample.
        k_after: index of the sample s later, -1 if there is none.
    """

    gap: bool
    inputs: Array
    y: Array
    target: Array
    k_after: int


def _rows(run: Run | Recording, s: int) -> Iterator[_Row]:
    """All samples, in order; those at the end of a stretch wait for the next one."""
    kept: list[NDArray[Any]] = []  # epoch, k, u, y, ref of the row before, if any, and of those that wait
    begin = 0
    for stretch in run.stretches():
        new = [stretch.epoch, stretch.k, stretch.u, stretch.y, stretch.ref]
        epoch, k, u, y, ref = (np.concatenate(pair) for pair in zip(kept, new, strict=True)) if kept else new
        last = stretch.first + len(stretch) == stretch.total
        inputs, end = (np.vstack([u, stretch.u_ahead]), len(k)) if last else (u, len(k) - s)
        gaps = np.r_[False, (np.diff(epoch) != 0) | (np.diff(k) != 1)]
        for i in range(begin, end):
            after = int(k[i + s]) if i + s < len(k) else -1
            yield _Row(bool(gaps[i]), inputs[i : i + s + 1], y[i], ref[min(i + 1, len(k) - 1)], after)
        done = max(begin, end)
        before = max(done - 1, 0)
        begin, kept = done - before, [values[before:] for values in (epoch, k, u, y, ref)]
