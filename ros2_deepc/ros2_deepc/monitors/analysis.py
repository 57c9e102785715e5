# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""`analyze`: from stretches of inputs and outputs to verdicts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from numpy.typing import ArrayLike

from .compress import Array, Compression
from .estimate import excitation, first, rho, visible_index, visible_lag, visible_ranks
from .fast import whole_state
from .noise import Noise, as_noise
from .printed import PrintedTheorems
from .source import Factor, Source, from_factor, from_records
from .theorems import SLOW, Outcome, better, decide, merge, nothing, withhold
from .verdict import Prior, Report, StructureEstimate, Verdict

ROWS = 700
"""Rows of data matrices beyond which no longer window is tried unasked."""


FAR = 3
"""How many times more inputs before the window are tried as instruments when few do not settle it: slow modes."""

REACH = -6.0
"""Margin [dB] from which that may help, or all columns of the window without instruments."""


class Tried(NamedTuple):
    """One window length: what it showed, and from which data at which noise level (p,), None if that is not known."""

    outcome: Outcome
    data: Compression
    level: Array | None


def analyze(
    u: ArrayLike, y: ArrayLike, *, prior: Prior, L: int | None = None, noise: Noise | ArrayLike | None = 0.0
) -> Report:
    """Says what one stretch of data proves about controllability and observability.

    Args:
        u: inputs, shape (K+s-1 or more, m), starting with the outputs.
        y: outputs, shape (K, p). Outputs that lack the s-1 inputs after them are left out.
        prior: what is known of the plant.
        L: output block rows of the pencils; None looks for a good one.
        noise: white noise on the outputs, in their units: a standard deviation (one, or one per output), a `Noise`,
            or None to estimate it from the data. 0 = exact up to rounding.

    Returns:
        The report; poor data give UNDECIDED with a reason, only wrong ones raise.

    Raises:
        ValueError: wrong shapes, values that are not finite, noise for another number of outputs, or L < 1.
    """
    return analyze_records([(u, y)], prior=prior, L=L, noise=noise)


def analyze_records(
    records: Sequence[tuple[ArrayLike, ArrayLike]],
    *,
    prior: Prior,
    L: int | None = None,
    noise: Noise | ArrayLike | None = 0.0,
) -> Report:
    """The same for several records of one plant side by side (mosaic Hankel matrix): a gap costs columns, no more.

    Args:
        records: pairs (u, y) as in `analyze`; those too short for a column are left out.
        prior: as in `analyze`.
        L: as in `analyze`.
        noise: as in `analyze`.

    Raises:
        ValueError: as in `analyze`, or no record.
    """
    return _analyze(from_records(records, prior.s), prior, L, as_noise(noise))


def analyze_factor(
    factor: ArrayLike,
    m: int,
    p: int,
    columns: int,
    *,
    prior: Prior,
    L: int | None = None,
    noise: Noise | ArrayLike | None = 0.0,
) -> Report:
    """The same from a matrix with the Gram matrix of a time-major Hankel matrix, such as a sliding factor.

    Args:
        factor: block row i holds u(k+i) over y(k+i), shape ((m+p) depth, c); depth at least L + s.
        m: inputs.
        p: outputs.
        columns: columns of the Hankel matrix that was compressed.
        prior: as in `analyze`.
        L: as in `analyze`; at most depth - s.
        noise: as in `analyze`. Averaging over the record needs the record itself: bounds are larger here.

    Raises:
        ValueError: as in `analyze`.
    """
    return _analyze(from_factor(factor, m, p, columns), prior, L, as_noise(noise))


def _analyze(source: Source, prior: Prior, L: int | None, noise: Noise) -> Report:
    """The common path of all entries."""
    if L is not None and L < 1:
        raise ValueError(f"L = {L} must be at least 1")
    source = source.weighted(noise.weights(source.y_scale))
    exact = noise.source == "exact"
    lengths = _lengths(source, prior, L, exact=exact)
    best: Tried | None = None
    for length in lengths:
        trial = _at(source, prior, length, noise)
        seen = trial.outcome.observability.verdict == Verdict.PROVED
        if best is None or (better(trial.outcome, best.outcome) and (seen or not exact)):
            best = trial
        if not trial.outcome.open or (seen and exact):
            break
    if best is None:
        return _too_short(source, prior, L or _shortest(source, prior), noise)
    return _report(source, prior, best.data.L, noise, best.outcome, best)


def _shortest(source: Source, prior: Prior) -> int:
    """Fewest output block rows that can show q directions."""
    return max(1, -(-prior.q // source.p))


def _need(source: Source, prior: Prior, L: int) -> int:
    """Columns asked for: the rank of a rich window, and one more, without which no data could contradict the prior."""
    return source.m * (L + prior.s) + prior.q + 1


def _lengths(source: Source, prior: Prior, L: int | None, *, exact: bool) -> list[int]:
    """Window lengths to try, best guess first; all fit the data.

    q rows are never less than the lag: enough without noise, but for rounding. With noise the best length depends on
    the plant.
    """

    def too_long(length: int) -> bool:
        return source.columns(length, length + prior.s) < _need(source, prior, length)

    shortest = _shortest(source, prior)
    if L is not None:
        return [] if too_long(L) else [L]
    longest = first(too_long, source.samples + 1) - 1
    start = max(prior.q, shortest)
    affordable = max(start, ROWS // (source.m + source.p))
    wanted = (start, 2 * start) if exact else (shortest + 1, start, 2 * start, 4 * start, 8 * start)
    lengths = [min(length, longest, affordable) for length in wanted]
    return [length for length in dict.fromkeys(lengths) if length >= shortest]


def _at(source: Source, prior: Prior, L: int, noise: Noise) -> Tried:
    """Both tests of the slow part at one window length, with instruments where these help."""
    d, q = L + prior.s, prior.q
    data = source.window(L, d)
    try:
        level = noise.level(data, source.y_scale, q)
    except ValueError as error:
        return Tried(nothing(str(error)), data, None)
    names = replace(SLOW, bound=noise.wording)
    past = -(-q // source.m) + 1

    def look(before: int = 0, *, search: bool = True) -> Outcome:
        window = source.window(L, d, before) if before else data
        return decide(window, q, noise.hankel_bound(window, level), names, search=search)

    def fits(before: int) -> bool:
        return noise.averages and source.columns(L, d, before) > source.m * (d + before)

    if not source.varied(d, q):
        return Tried(withhold(look(), names, q), data, level)
    if not fits(past):
        return Tried(look(), data, level)
    outcome = merge(look(search=False), look(past))
    near = outcome.controllability.margin >= REACH
    hidden = outcome.controllability.verdict is Verdict.UNDECIDED and outcome.seen >= q  # instruments hide directions
    if outcome.open and (near or hidden):
        outcome = merge(outcome, look())
    if outcome.open and near and fits(FAR * past):
        outcome = merge(outcome, look(FAR * past))
    return Tried(outcome, data, level)


def _too_short(source: Source, prior: Prior, L: int, noise: Noise) -> Report:
    """The report of data that cannot hold the rank yet."""
    need = _need(source, prior, L)
    have = source.columns(L, L + prior.s)
    missing = need - have if have else need + L - source.samples
    reason = f"{missing} more samples needed: {source.samples} outputs cannot show rank {need - 1} at L = {L}"
    if isinstance(source, Factor):
        reason = f"a factor of depth {len(source.F)} and {have} columns cannot show rank {need - 1} at L = {L}"
    return _report(source, prior, L, noise, nothing(reason, need - 1), None)


def _report(source: Source, prior: Prior, L: int, noise: Noise, slow: Outcome, tried: Tried | None) -> Report:
    """Everything beside the slow part: C-properties, printed theorems, excitation, structure."""
    data = tried.data if tried else None
    order = excitation(source, L + prior.s + prior.q)
    if data is not None and data.inverse is None:
        slow = nothing(
            f"the inputs are persistently exciting of order {order} only, this window needs {L + prior.s}: "
            "vary every input independently for a while",
            slow.controllability.required,
            slow.eps,
        )
    base = source.m * (L + prior.s)
    need = L + prior.s + prior.q
    estimate = StructureEstimate()
    if data is not None and slow.seen:
        ranks = visible_ranks(data, slow.eps)
        estimate = StructureEstimate(
            q=slow.seen, s=visible_index(ranks), lag=visible_lag(data, slow.eps, slow.seen), rho=rho(ranks)
        )
    whole = whole_state(source, prior, L, slow, estimate, noise, tried.level if tried else None)
    return Report(
        r_controllability=slow.controllability,
        r_observability=slow.observability,
        c_controllability=whole[0],
        c_observability=whole[1],
        printed=PrintedTheorems(source, prior, L, noise),
        modes=slow.modes,
        excitation_order=order,
        excitation_need=need,
        rank=base + slow.seen if slow.excited else 0,
        rank_need=base + prior.q,
        L=L,
        samples=source.samples,
        columns=source.columns(L, L + prior.s),
        estimate=estimate,
        noise_source=noise.source,
        pencil=slow.pencil,
    )
