# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The numbers of a run that fit on one line each."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .run import MODES, PROPERTIES, VERDICTS, Array, Run

TAIL = 20  # samples at the end of a phase that its RMSE is taken over


def summarize(run: Run, *, seed: int | None = None) -> dict[str, Any]:
    """Sums a run up, ready for JSON.

    Args:
        run: the run.
        seed: of the run; default: the one in the bag's metadata, else None.

    Returns:
        Keys: plant, seed, steps; outputs.<name>.rmse (over the last 20 samples of each stretch with one reference,
        after collecting), outputs.<name>.peak_to_peak (after collecting); verdicts.<name> (at the end);
        controller.failures, controller.solve_time_ms.median and .p99; loop_hash. What does not exist is None.
    """
    phases = reference_phases(run)
    controlled = run.mode != MODES.index("COLLECTING")
    if seed is None and run.metadata.get("seed", "").lstrip("-").isdigit():
        seed = int(run.metadata["seed"])
    failures = run.state["failures"]
    return {
        "plant": run.plant,
        "seed": seed,
        "steps": len(run),
        "outputs": {
            name: {
                "rmse": [_rmse(run.y[rows, i] - run.ref[rows, i]) for rows in phases],
                "peak_to_peak": _number(np.ptp(run.y[controlled, i])) if controlled.any() else None,
            }
            for i, name in enumerate(run.output_names)
        },
        "verdicts": {
            name: VERDICTS[run.reports.verdict[-1, j]] if len(run.reports.k) else None
            for j, name in enumerate(PROPERTIES)
        },
        "controller": {
            "failures": int(np.nanmax(failures)) if np.isfinite(failures).any() else None,
            "solve_time_ms": {"median": _quantile(run.solve_time, 0.5), "p99": _quantile(run.solve_time, 0.99)},
        },
        "loop_hash": run.loop_hash,
    }


def reference_phases(run: Run) -> list[NDArray[np.intp]]:
    """Rows of the last 20 samples of each stretch with one reference, in order; collecting samples do not count."""
    usable = ~np.isnan(run.ref).any(axis=1) & (run.mode != MODES.index("COLLECTING"))
    rows = np.flatnonzero(usable)
    if not len(rows):
        return []
    change = np.any(np.diff(run.ref[rows], axis=0) != 0, axis=1)
    return [stretch[-TAIL:] for stretch in np.split(rows, np.flatnonzero(change) + 1)]


def _rmse(error: Array) -> float | None:
    return _number(np.sqrt(np.mean(error**2)))


def _quantile(seconds: Array, q: float) -> float | None:
    known = seconds[np.isfinite(seconds)]
    return _number(1e3 * np.quantile(known, q)) if len(known) else None


def _number(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None
