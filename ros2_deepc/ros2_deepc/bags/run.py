# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""A recorded run as aligned arrays: all of it, or a stretch."""

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
PROPERTIES = ("r_controllability", "c_controllability", "r_observability", "c_observability")
VERDICTS = ("UNDECIDED", "PROVED", "NOT_PROVED", "PRIOR_VIOLATED", "REFUTED", "NOT_DECIDABLE")
MODES = ("IDLE", "COLLECTING", "CONTROLLING", "HOLDING", "FALLBACK", "SHADOW")
NO_MODE = 255
STATE_FIELDS = (
    "mode", "status", "solve_time", "prepare_time", "distance", "window", "rank", "rank_need", "gap", "excitation",
    "excitation_need", "slack", "cost", "iterations", "limited", "deadline_misses", "failures", "refused",
)  # fmt: skip
REPORT_FIELDS = (
    "excitation", "excitation_need", "rank", "rank_need", "window", "depth", "estimated_q", "estimated_s",
    "estimated_lag", "data_age", "compute_time",
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reports:
    """The monitor's reports, one row each, in the order of their samples.

    Attributes:
        epoch, k, t: shape (R,); t in seconds on the clock of ``Run.t``.
        row: shape (R,), the sample of the whole run that it belongs to: the last one up to (epoch, k).
        first, total: reports before these, and in the whole run.
        verdict: shape (R, 4), indices into VERDICTS, columns as PROPERTIES.
        lambda_star: shape (R, 4), complex; NaN where none.
        margin: shape (R, 4) [dB].
        reason: of each property, the last one.
        series: scalar fields of the report by name, each of shape (R,).
    """

    epoch: NDArray[np.int64]
    k: NDArray[np.int64]
    t: Array
    row: NDArray[np.intp]
    first: int
    total: int
    verdict: NDArray[np.uint8]
    lambda_star: NDArray[np.complex128]
    margin: Array
    reason: tuple[str, ...] = ("",) * 4
    series: Mapping[str, Array] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True, eq=False)
class Run:
    """One plant's run, or a stretch of it; row i is the sample with index k[i] of epoch[i].

    Epochs follow one another as they arrived, samples of an epoch by k. What is said of the run as a whole is the same
    in every stretch: names, limits, ``epochs``, ``total``, ``u_ahead``, ``duplicates``, ``metadata``.

    Attributes:
        first, total: samples before this stretch, and in the whole run.
        epochs: how many there are in the whole run.
        plant, variant: names; empty if no PlantInfo was recorded.
        sample_time: Ts [s]; NaN if unknown.
        epoch, k: shape (K,).
        t: shape (K,), seconds since the first sample.
        y: shape (K, p), outputs.
        u: shape (K, m), the input in force (the plant may have held an older one); NaN where not recorded.
        ref: shape (K, p), reference in use; NaN where none.
        mode: shape (K,), index into MODES when the controller had seen this sample; NO_MODE where it said nothing.
        solve_time: shape (K,) [s]; NaN where nothing was solved.
        state: further scalar fields of ControllerState by name, each of shape (K,), NaN where not recorded.
        u_ahead: shape (r, m), inputs already given for samples after the last one.
        reports: what the monitor said.
        input_min, input_max: shape (m,).
        prior: n, q, r, s as the plant gave them; 0 = not given.
        duplicates: outputs or inputs that came more than once for the same sample (the first one counts).
        metadata: the recorder's metadata.
    """

    plant: str
    variant: str
    sample_time: float
    input_names: tuple[str, ...]
    input_units: tuple[str, ...]
    output_names: tuple[str, ...]
    output_units: tuple[str, ...]
    input_min: Array
    input_max: Array
    prior: Mapping[str, Any]
    first: int
    total: int
    epochs: int
    epoch: NDArray[np.int64]
    k: NDArray[np.int64]
    t: Array
    u: Array
    y: Array
    ref: Array
    mode: NDArray[np.uint8]
    solve_time: Array
    state: Mapping[str, Array]
    u_ahead: Array
    reports: Reports
    duplicates: int
    metadata: Mapping[str, str]

    def __len__(self) -> int:
        return len(self.k)

    def stretches(self) -> Iterator[Self]:
        """Itself: a run in memory is one stretch, see ``Recording.stretches``."""
        yield self

    @property
    def x(self) -> Array:
        """Where each sample stands on the axis of a plot, shape (K,): k, or its place if there are several epochs."""
        if self.epochs == 1:
            return self.k.astype(np.float64)
        return np.arange(self.first, self.first + len(self), dtype=np.float64)

    @cached_property
    def loop_hash(self) -> str:
        """See ``loop_hash``."""
        return loop_hash(self.u, self.y)


def loop_hash(u: Array, y: Array) -> str:
    """SHA-256 (hex) of u(0) y(0) u(1) y(1) ... as little-endian float64; rows with a NaN in u are left out.

    Args:
        u: shape (K, m).
        y: shape (K, p).
    """
    return hashlib.sha256(loop_bytes(u, y)).hexdigest()


def loop_bytes(u: Array, y: Array) -> bytes:
    """What ``loop_hash`` is taken over."""
    return np.hstack([u, y]).astype("<f8")[~np.isnan(u).any(axis=1)].tobytes()
