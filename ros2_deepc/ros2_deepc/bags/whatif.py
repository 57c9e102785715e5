# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""What another controller would have done on the data of a recorded run."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ros2_deepc.control import DeepcController

from .errors import BagError
from .run import Run

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WhatIf:
    """The answers of a controller that watched a run and moved nothing.

    Attributes:
        u: inputs it would have given, shape (K, m), in the rows of the samples they are for; NaN where it had none.
        solved: number of optimisations that were solved.
        failed: number that were not.
        first: row of its first answer, or -1.
        furthest: largest distance from the recorded input per input, shape (m,); NaN without an answer.
        missing: why it never answered; empty if it did.
    """

    u: Array
    solved: int
    failed: int
    first: int
    furthest: Array
    missing: str


def what_if(
    run: Run,
    controller: DeepcController,
    *,
    progress: Callable[[int, int], None] = lambda done, total: None,  # noqa: ARG005
) -> WhatIf:
    """Lets a controller watch the recorded inputs and outputs, and asks it for an input at every sample.

    It sees what the real controller saw, with the references that were in use; what it answers is not applied, so that
    every answer is a first move from the recorded state.

    Args:
        run: the recorded run.
        controller: a fresh one with the settings to try.
        progress: called now and then with rows done and in all.

    Raises:
        BagError: if the run has no inputs, or the controller is for another number of channels.
    """
    if not run.u.shape[1]:
        raise BagError("this run has no inputs: nothing can be asked")
    s = max(controller.settings.s, 1)
    answers = np.full_like(run.u, np.nan)
    inputs = np.vstack([run.u, run.u_ahead])
    counts = {True: 0, False: 0}
    fresh = True
    for row in range(len(run)):
        if row % 1000 == 0:
            progress(row, len(run))
        gap = row and (run.epoch[row] != run.epoch[row - 1] or run.k[row] != run.k[row - 1] + 1)
        known = len(inputs) >= row + s and np.isfinite(inputs[row : row + s]).all()
        if (gap or not known) and not fresh:
            controller.cut()
            fresh = True
        if not known:
            continue
        for decided in inputs[row : row + s] if fresh else inputs[row + s - 1 : row + s]:
            controller.commit(decided)  # with s > 1, inputs after k are decided before y(k) is seen
        controller.observe(inputs[row], run.y[row])
        fresh = False
        target = run.ref[min(row + 1, len(run) - 1)]
        if row + s < len(run) and controller.ready and np.isfinite(target).all():
            result = controller.step(target)
            counts[result.status.solved] += 1
            answers[row + s] = result.u
    progress(len(run), len(run))
    answered = np.flatnonzero(np.isfinite(answers).all(axis=1))
    apart = np.abs(answers - run.u)[answered]
    return WhatIf(
        u=answers,
        solved=counts[True],
        failed=counts[False],
        first=int(answered[0]) if len(answered) else -1,
        furthest=np.nanmax(apart, axis=0) if len(answered) else np.full(run.u.shape[1], np.nan),
        missing="" if len(answered) else controller.missing() or "no reference was recorded",
    )
