# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""`analyze`: from one stretch of inputs and outputs to verdicts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ros2_deepc.behavior import excitation_order, hankel
from ros2_deepc.behavior.hankel import as_signal

from .compress import Array, Compression, compress
from .noise import Noise, as_noise
from .printed import PrintedTheorems
from .theorems import WHOLE, Outcome, decide
from .verdict import Finding, Prior, Report, StructureEstimate, Verdict


@dataclass(frozen=True, slots=True)
class Record:
    """One scaled record: each channel divided by its root mean square.

    Attributes:
        u: inputs, shape (K+s-1, m), scaled.
        y: outputs, shape (K, p), scaled.
        u_scale: divisors of the inputs, shape (m,).
        y_scale: divisors of the outputs, shape (p,).
    """

    u: Array
    y: Array
    u_scale: Array
    y_scale: Array

    def window(self, L: int, d: int) -> Compression:
        """Compresses [H_d(u); H_{L+1}(y)] over all columns that both have."""
        columns = min(len(self.u) - d, len(self.y) - L - 1) + 1
        Wu, Wy = hankel(self.u[: columns + d - 1], d), hankel(self.y[: columns + L], L + 1)
        return compress(Wu, Wy, self.u.shape[1], self.y.shape[1], columns)


def as_record(u: ArrayLike, y: ArrayLike, s: int) -> Record:
    """Checks, trims and scales a record; outputs whose last inputs are not known yet are left out.

    Raises:
        ValueError: wrong shapes, a value that is not finite, or fewer than s inputs.
    """
    inputs, outputs = as_signal(u, "u"), as_signal(y, "y")
    if inputs.shape[1] == 0 or outputs.shape[1] == 0:
        raise ValueError(f"u {inputs.shape} and y {outputs.shape} need at least one column each, one per channel")
    K = min(len(outputs), len(inputs) - s + 1)
    inputs, outputs = inputs[: max(K + s - 1, 0)], outputs[: max(K, 0)]
    u_scale, y_scale = rms(inputs), rms(outputs)
    return Record(inputs / u_scale, outputs / y_scale, u_scale, y_scale)


def rms(w: Array) -> Array:
    """Root mean square of each column, 1 where it is zero."""
    if not len(w):
        return np.ones(w.shape[1])
    value = np.sqrt(np.mean(w**2, axis=0))
    return np.where(value > 0, value, 1.0)


def samples_needed(m: int, prior: Prior, L: int) -> int:
    """Fewest outputs with which m (L+s) + q independent columns are possible: (m+1) L + m s + q."""
    return (m + 1) * L + m * prior.s + prior.q


def analyze(
    u: ArrayLike,
    y: ArrayLike,
    *,
    prior: Prior,
    L: int | None = None,
    noise: Noise | ArrayLike = 0.0,
) -> Report:
    """Says what one stretch of data proves about controllability and observability.

    Args:
        u: inputs, shape (K+s-1 or more, m), starting with the outputs.
        y: outputs, shape (K, p). Outputs that lack the s-1 inputs after them are left out.
        prior: what is known of the plant.
        L: output block rows of the pencils; None looks for a good one.
        noise: on the outputs, in their units: a standard deviation (one or one per output), or a `Noise`.

    Returns:
        The report; never raises for poor data, only for wrong ones.

    Raises:
        ValueError: wrong shapes, values that are not finite, or L < 1.
    """
    record = as_record(u, y, prior.s)
    m, p = record.u.shape[1], record.y.shape[1]
    level = as_noise(noise)
    if L is not None and L < 1:
        raise ValueError(f"L = {L} must be at least 1")
    shortest = max(1, -(-prior.q // p))
    lengths = [L] if L is not None else candidate_lengths(record, prior, shortest)
    lengths = [k for k in lengths if len(record.y) >= samples_needed(m, prior, k)]
    if not lengths:
        return _too_short(record, prior, L or shortest, level)
    outcome, best = None, lengths[0]
    for k in lengths:
        data = record.window(k, k + prior.s)
        trial = decide(data, prior.q, level.hankel_bound(k + 1, data.columns, record.y_scale))
        if outcome is None or _better(trial, outcome):
            outcome, best = trial, k
        if _settled(outcome, level):
            break
    assert outcome is not None
    whole = _whole(record, prior, best, level, outcome)
    return _report(record, prior, best, level, outcome, whole)


def candidate_lengths(record: Record, prior: Prior, shortest: int) -> list[int]:
    """Window lengths worth trying, best guess first; all must fit the record."""
    m = record.u.shape[1]
    longest = (len(record.y) - m * prior.s - prior.q) // (m + 1)
    wanted = (max(prior.q, shortest), 2 * max(prior.q, shortest), longest, shortest + 1)
    lengths = [min(k, longest) for k in wanted]
    return [k for k in dict.fromkeys(lengths) if k >= shortest]


def _settled(outcome: Outcome, level: Noise) -> bool:
    """Whether another window length can change nothing: without noise any length from the lag on is as good."""
    if outcome.controllability.verdict in (Verdict.PROVED, Verdict.PRIOR_VIOLATED):
        return True
    return level.source == "exact" and outcome.observability.verdict == Verdict.PROVED


def _better(a: Outcome, b: Outcome) -> bool:
    """Whether outcome a says more than b: first by observability, then by margin."""

    def worth(o: Outcome) -> tuple[bool, bool, float]:
        f = o.controllability
        return o.excited, o.observability.verdict == Verdict.PROVED, -np.inf if np.isnan(f.margin) else f.margin

    return worth(a) > worth(b)


def _too_short(record: Record, prior: Prior, L: int, level: Noise) -> Report:
    """The report of a record that cannot hold the rank yet."""
    m, p = record.u.shape[1], record.y.shape[1]
    missing = samples_needed(m, prior, L) - len(record.y)
    required = m * (L + prior.s) + prior.q
    reason = f"{missing} more samples needed: {len(record.y)} outputs cannot hold rank {required} at L = {L}"
    blank = Finding(verdict=Verdict.UNDECIDED, reason=reason, required=required)
    outcome = Outcome(blank, blank, (), np.zeros(0), float("nan"), False)
    return _report(record, prior, L, level, outcome, _by_dimensions(m, p, prior, blank, blank))


def _by_dimensions(m: int, p: int, prior: Prior, control: Finding, observe: Finding) -> tuple[Finding, Finding]:
    """C-findings that need no data: refutation by dimensions; otherwise the given ones."""
    r, s = prior.r, prior.s
    if r > s * m:
        reason = f"{m} inputs reach at most s m = {s * m} of the r = {r} fast states, whatever the plant"
        control = Finding(verdict=Verdict.REFUTED, reason=reason, theorem="dimensions", rank=s * m, required=r)
    if r > s * p:
        reason = f"{p} outputs see at most s p = {s * p} of the r = {r} fast states, whatever the plant"
        observe = Finding(verdict=Verdict.REFUTED, reason=reason, theorem="dimensions", rank=s * p, required=r)
    return control, observe


def _whole(record: Record, prior: Prior, L: int, level: Noise, slow: Outcome) -> tuple[Finding, Finding]:
    """C-controllability and C-observability."""
    m, p = record.u.shape[1], record.y.shape[1]
    if prior.r < 0:
        blank = Finding(
            verdict=Verdict.UNDECIDED, reason="the C-properties need the state dimension: give n in the prior"
        )
        return blank, blank
    if prior.r == 0:
        return slow.controllability, slow.observability
    if prior.D is None:
        reason = "no input-output data decide it with D unknown, since D and C2 B2 enter as a difference: give D"
        blank = Finding(verdict=Verdict.NOT_DECIDABLE, reason=reason)
        return _by_dimensions(m, p, prior, blank, blank)
    D = np.asarray(prior.D, dtype=np.float64)
    if D.shape != (p, m):
        raise ValueError(f"prior D must have shape (p, m) = {(p, m)}, got {D.shape}")
    D = D * record.u_scale / record.y_scale[:, None]
    clean = Record(record.u, record.y - record.u[: len(record.y)] @ D.T, record.u_scale, record.y_scale)
    data = clean.window(L, L)
    outcome = decide(data, prior.n, level.hankel_bound(L + 1, data.columns, record.y_scale), WHOLE)
    return _by_dimensions(m, p, prior, outcome.controllability, outcome.observability)


def _report(
    record: Record, prior: Prior, L: int, level: Noise, slow: Outcome, whole: tuple[Finding, Finding]
) -> Report:
    def window(rows: int, d: int) -> tuple[Compression, float]:
        data = record.window(rows, d)
        return data, level.hankel_bound(rows + 1, data.columns, record.y_scale)

    m = record.u.shape[1]
    base = m * (L + prior.s)
    seen = int(np.count_nonzero(slow.autonomous > slow.eps))
    return Report(
        r_controllability=slow.controllability,
        r_observability=slow.observability,
        c_controllability=whole[0],
        c_observability=whole[1],
        printed=PrintedTheorems(window, prior, L),
        modes=slow.modes,
        excitation_order=excitation_order(record.u, at_most=L + prior.s + prior.q),
        excitation_need=L + prior.s + prior.q,
        rank=base + seen if slow.excited else 0,
        rank_need=base + prior.q,
        L=L,
        samples=len(record.y),
        columns=max(len(record.y) - L, 0),
        estimate=StructureEstimate(q=seen),
        noise_source=level.source,
    )
