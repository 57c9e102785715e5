# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""C-controllability and C-observability: what data and dimensions say about the fast part."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .compress import Array
from .noise import Noise
from .source import Source
from .theorems import WHOLE, Outcome, decide, withhold
from .verdict import Finding, Prior, StructureEstimate, Verdict

Pair = tuple[Finding, Finding]


def whole_state(
    source: Source,
    prior: Prior,
    L: int,
    slow: Outcome,
    estimate: StructureEstimate,
    noise: Noise,
    level: Array | None,
) -> Pair:
    """C-controllability and C-observability.

    Args:
        source: the data.
        prior: what is known of the plant.
        L: output block rows.
        slow: what was found for the slow part.
        estimate: structure that the same window shows.
        noise: kind of noise.
        level: its level in scaled units, shape (p,); None when no window could be looked at.
    """
    if prior.r < 0:
        blank = _blank("the C-properties need the state dimension: give n in the prior")
        return blank, blank
    if prior.r == 0:
        return slow.controllability, slow.observability
    refuted = _by_dimensions(source.m, source.p, prior)
    if refuted:
        return refuted
    if level is None:
        return slow.controllability, slow.observability
    if prior.D is None:
        return _without_feedthrough(prior, slow, estimate, exact=noise.source == "exact")
    return _with_feedthrough(source, prior, L, noise, level)


def _blank(reason: str, verdict: Verdict = Verdict.UNDECIDED) -> Finding:
    return Finding(verdict=verdict, reason=reason)


def _with_feedthrough(source: Source, prior: Prior, L: int, noise: Noise, level: Array) -> Pair:
    """Theorems 2* and 4*: without the feed-through the last input of a window says nothing about its outputs."""
    D = np.asarray(prior.D, dtype=np.float64)
    if D.shape != (source.p, source.m):
        raise ValueError(f"prior D must have shape (p, m) = {(source.p, source.m)}, got {D.shape}")
    L = max(L, prior.q, prior.r, -(-prior.n // source.p))
    need = source.m * L + prior.n + 1
    have = source.columns(L, L)
    if have < need:
        blank = _blank(f"{need - have} more columns needed: {have} cannot show rank {need - 1} at L = {L}")
        return blank, blank
    data = source.without_feedthrough(D).window(L, L)
    names = replace(WHOLE, bound=noise.wording)
    outcome = decide(data, prior.n, noise.hankel_bound(data, level), names)
    if not source.varied(L, prior.n):
        outcome = withhold(outcome, names, prior.n)
    return outcome.controllability, outcome.observability


def _without_feedthrough(prior: Prior, slow: Outcome, estimate: StructureEstimate, *, exact: bool) -> Pair:
    """With D unknown only the responses to later inputs speak of the fast part.

    Every fast part with these responses has r >= 2 rho_1 - rho_2. With equality it is controllable and observable;
    without, another one with the same data, n, q and s is not. Ranks are counts above the noise, hence lower bounds;
    with s = 2 that is enough, for rho_2 = 0.
    """
    difference = "D is unknown and enters only as D - C2 B2"
    if prior.s == 1:
        blank = _blank(f"{difference}: with s = 1 no data tell the fast part from it; give D", Verdict.NOT_DECIDABLE)
        return blank, blank
    if slow.observability.verdict != Verdict.PROVED:
        return slow.controllability, slow.observability
    if not exact and prior.s > 2:
        blank = _blank(f"{difference}: under noise and with s > 2 ranks of the fast part have no upper bound; give D")
        return blank, blank
    rho = (*estimate.rho, 0, 0)
    least = 2 * rho[0] - rho[1] if prior.s > 2 else 2 * rho[0]
    if least > prior.r:
        reason = f"the data need at least {least} fast states and n - q = {prior.r}: n is too small"
        blank = _blank(reason, Verdict.PRIOR_VIOLATED)
        return blank, blank
    if least < prior.r:
        reason = f"{difference}; the data need {least} fast states and r = {prior.r}: give D"
        blank = _blank(reason, Verdict.NOT_DECIDABLE if exact else Verdict.UNDECIDED)
        return blank, blank
    reason = (
        f"all r = {prior.r} fast states are needed to explain the data, so inputs reach and outputs see each of them"
    )
    pair = tuple(
        replace(finding, reason=reason, theorem=f"{finding.theorem}, r = 2 rho1 - rho2")
        if finding.verdict == Verdict.PROVED
        else finding
        for finding in (slow.controllability, slow.observability)
    )
    return pair[0], pair[1]


def _by_dimensions(m: int, p: int, prior: Prior) -> Pair | None:
    """What the dimensions exclude: s m inputs reach and s p outputs see at most that many fast states; None if nothing.

    Where one property is refuted, the other is not a matter of data: fast states that no input reaches never move, and
    those that no output sees show nothing.
    """
    r, s = prior.r, prior.s
    reach = f"{m} inputs reach at most s m = {s * m} of the r = {r} fast states"
    see = f"{p} outputs see at most s p = {s * p} of the r = {r} fast states"
    if r <= s * m and r <= s * p:
        return None
    if r > s * m:
        control = _refuted(f"{reach}, whatever the plant", s * m, r)
    else:
        control = _blank(f"{see}: no data show whether inputs reach the others", Verdict.NOT_DECIDABLE)
    if r > s * p:
        observe = _refuted(f"{see}, whatever the plant", s * p, r)
    else:
        observe = _blank(f"{reach}: the others never move, so no data show them", Verdict.NOT_DECIDABLE)
    return control, observe


def _refuted(reason: str, rank: int, required: int) -> Finding:
    return Finding(verdict=Verdict.REFUTED, reason=reason, theorem="dimensions", rank=rank, required=required)
