# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The corrected theorems 1* to 4* as tests on a compressed window.

With U of L+sb-1 block rows (sb inputs beyond the outputs, sb >= s) and Y of L block rows:
1*  rank(pencil(lambda)) = m (L+sb-1) + q for every lambda  =>  R-controllable.
3*  rank(window)         = m (L+sb-1) + q                    =>  R-observable.
With y - D u for y, sb = 0 and n for q the same tests are 2* (C-controllable, infinity included) and 4* (C-observable).
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import gammaincinv

from .certify import certify
from .compress import Compression
from .noise import gaussian_norm
from .pencil import Pencil, reduce
from .search import Minimum, minimum
from .verdict import Finding, Mode, Verdict


@dataclass(frozen=True, slots=True)
class Names:
    """How a pair of tests speaks: its theorems, the dimension it shows, and how the noise bound is known."""

    control: str
    observe: str
    order: str
    bound: str = "the bound"


ON_CIRCLE = 1e-6
"""Modes this near to the unit circle count as on it, as do those that noise could move there."""

CLEAR = 100
"""When fewer than q directions are seen, all must exceed the noise so many times before a drop of rank means a mode."""

GRACE = 1000
"""Exact data may hold more rounding than the outputs alone explain, for states are larger than outputs: what directions
beyond q show, up to so many rounding bounds, counts as rounding and not against the prior."""

HIDDEN = 1e-3
"""Chance that white noise, declared to be none, shows less of itself than is reckoned with."""

SLOW = Names("1*", "3*", "q")
WHOLE = Names("2*", "4*", "n")


@dataclass(frozen=True, slots=True)
class Outcome:
    """Both findings of one window, with the numbers behind them.

    Attributes:
        controllability: finding of 1* or 2*.
        observability: finding of 3* or 4*.
        modes: weakest first.
        seen: directions of the outputs above the noise bound that the inputs of the window do not explain.
        eps: noise bound used.
        excited: whether the inputs are persistently exciting of the order of the window.
        pencil: on which controllability was decided; None if it came to none.
    """

    controllability: Finding
    observability: Finding
    modes: tuple[Mode, ...]
    seen: int
    eps: float
    excited: bool
    pencil: Pencil | None = None

    @property
    def open(self) -> bool:
        """Whether another window might still say more."""
        settled = (Verdict.PROVED, Verdict.PRIOR_VIOLATED)
        return self.controllability.verdict not in settled or self.observability.verdict not in settled


def nothing(reason: str, required: int = 0, eps: float = float("nan")) -> Outcome:
    """The outcome of data that cannot be asked, with one reason for all."""
    blank = Finding(verdict=Verdict.UNDECIDED, reason=reason, required=required, noise_bound=eps)
    return Outcome(blank, blank, (), 0, eps, False)


def withhold(outcome: Outcome, names: Names, q: int) -> Outcome:
    """The outcome without its proofs: of inputs that could hide what contradicts the prior."""
    reason = (
        f"the inputs repeat themselves too soon, what contradicts {names.order} = {q} could hide in them: "
        "give them a longer period, or none"
    )

    def without(finding: Finding) -> Finding:
        proved = finding.verdict is Verdict.PROVED
        return replace(finding, verdict=Verdict.UNDECIDED, reason=reason) if proved else finding

    return replace(
        outcome, controllability=without(outcome.controllability), observability=without(outcome.observability)
    )


def better(a: Outcome, b: Outcome) -> bool:
    """Whether outcome a says more than b."""
    return _worth(a.controllability) > _worth(b.controllability)


def merge(a: Outcome, b: Outcome) -> Outcome:
    """The best of two looks at the same window; what contradicts the prior in the first stays."""
    if Verdict.PRIOR_VIOLATED in (a.controllability.verdict, a.observability.verdict):
        return a
    first = a if better(a, b) else b
    observe = max(a.observability, b.observability, key=_worth)
    return replace(first, observability=observe, seen=max(a.seen, b.seen), eps=a.eps, excited=a.excited)


def _worth(finding: Finding) -> tuple[int, float]:
    """Order of findings: a contradiction or a proof, then a drop of rank found, then the larger margin."""
    ranking = {Verdict.PRIOR_VIOLATED: 3, Verdict.PROVED: 2, Verdict.NOT_PROVED: 1}
    return ranking.get(finding.verdict, 0), -np.inf if np.isnan(finding.margin) else finding.margin


def decibel(value: float, bound: float) -> float:
    """20 log10(value/bound), -inf for a zero value."""
    return float(20 * np.log10(value / bound)) if value > 0 else -np.inf


def place(lam: complex, tolerance: float) -> str:
    """Where a mode lies against the unit circle: "on" within the tolerance."""
    distance = abs(lam) - 1
    if abs(distance) <= tolerance:
        return "on"
    return "inside" if distance < 0 else "outside"


def threshold(data: Compression, q: int, eps_noise: float) -> float:
    """Bound of noise and rounding together, when no more than q directions are expected."""
    eps = eps_noise + data.floor
    beyond = float(data.sigma[q]) if q < data.sigma.size else 0.0
    return max(eps, hidden(data, q) * beyond) if eps_noise == 0 and 0 < beyond <= GRACE * eps else eps


def hidden(data: Compression, q: int) -> float:
    """How many times the singular value beyond q the norm of the noise in data that should be exact may be.

    Of white noise of any level, what q directions and the inputs leave is a matrix of r x c independent entries, (r, c)
    from `Compression.spare`: its norm is at least the chi-square quantile of r c degrees of freedom over min(r, c), all
    under a root, but for a chance of `HIDDEN`. One spare row and column show little of it; a few are enough.
    """
    r, c = data.spare(q)
    if min(r, c) < 1:
        return np.inf
    whole = gaussian_norm(float(np.sqrt(len(data.directions))), float(np.sqrt(data.columns)), data.L)
    return max(10.0, float(whole / np.sqrt(2 * gammaincinv(r * c / 2, HIDDEN) / min(r, c))))


def decide(data: Compression, q: int, eps_noise: float, names: Names = SLOW, *, search: bool = True) -> Outcome:
    """Runs both tests of a family on one window.

    Args:
        data: compressed window with d = L + sb input block rows.
        q: dimension to be shown (q, or n for the C-properties).
        eps_noise: bound of the Hankel matrix of the noise on Y, scaled units; the rounding floor is added.
        names: family of theorems.
        search: whether to look for the weakest lambda, the dear part; without it controllability stays open unless the
            prior is contradicted.
    """
    eps = threshold(data, q, eps_noise)
    if data.inverse is None:
        return nothing(f"the inputs are not persistently exciting of order {data.d}", data.m * data.d + q, eps)
    if data.spare(q)[1] < 1:
        return nothing(f"every column is needed for the rank: none could contradict {names.order} = {q}", eps=eps)
    seen = int(np.count_nonzero(data.sigma > eps))
    observe = _observability(data, seen, q, eps, names)
    if seen == 0 or q == 0:
        return Outcome(_nothing_to_control(data, seen, q, eps, names), observe, (), seen, eps, True)
    if seen <= q and not search:
        return replace(nothing("", data.m * (data.d - 1) + q, eps), observability=observe, seen=seen, excited=True)
    pencil = reduce(data, min(seen, q))
    low = minimum(pencil)
    eps += pencil.floor
    control = observe if seen > q else _controllability(data, pencil, low, q, eps, names)
    return Outcome(control, observe, find_modes(low, eps), seen, eps, True, pencil)


def _observability(data: Compression, seen: int, q: int, eps: float, names: Names) -> Finding:
    """Theorem 3* or 4* over the whole window."""
    base = data.m * data.d
    sigma = data.sigma
    deciding = float(sigma[q - 1]) if 0 < q <= sigma.size else 0.0
    following = float(sigma[q]) if q < sigma.size else 0.0
    if seen > q:
        verdict = Verdict.PRIOR_VIOLATED
        reason = (
            f"the outputs show {seen} autonomous directions above the noise bound, {names.order} = {q} allows {q}: "
            f"{names.order} or s is too small, the noise bound too small, or the plant not linear"
        )
    elif (q == 0 or deciding > eps) and data.spare(q)[0] > 0:
        verdict = Verdict.PROVED
        reason = (
            f"the window has rank {base + q}, all that {names.order} = {q} allows, for any noise within {names.bound}"
        )
    elif seen == q:
        verdict = Verdict.UNDECIDED
        reason = f"{data.L + 1} outputs have no row more than {names.order} = {q} fills, to contradict it: larger L"
    else:
        verdict = Verdict.NOT_PROVED
        reason = (
            f"only {seen} of {names.order} = {q} directions rise above the noise bound: the others are unobservable, "
            f"never excited, or the window of {data.L + 1} outputs is shorter than the lag"
        )
    return Finding(
        verdict=verdict,
        reason=reason,
        theorem=names.observe,
        rank=base + seen,
        required=base + q,
        margin=decibel(deciding, eps) if q else np.inf,
        noise_bound=eps,
        gap=deciding / following if following > 0 else np.inf,
    )


def _nothing_to_control(data: Compression, seen: int, q: int, eps: float, names: Names) -> Finding:
    """When no direction is above the noise, or none is expected."""
    base = data.m * (data.d - 1)
    if seen > q:
        verdict = Verdict.PRIOR_VIOLATED
        reason = f"the outputs show {seen} autonomous directions, {names.order} = 0 allows none"
    elif q == 0:
        verdict, reason = Verdict.PROVED, f"{names.order} = 0: there is nothing to control"
    else:
        verdict, reason = Verdict.UNDECIDED, f"no direction rises above the noise bound, {names.order} = {q}"
    return Finding(verdict=verdict, reason=reason, theorem=names.control, rank=base, required=base + q, noise_bound=eps)


def _text(number: complex) -> str:
    """Real where only rounding says otherwise."""
    real = abs(number.imag) <= 1e-9 * max(1.0, abs(number))
    return f"{number.real:.6g}" if real else f"{number:.6g}"


def _controllability(data: Compression, pencil: Pencil, low: Minimum, q: int, eps: float, names: Names) -> Finding:
    """Theorem 1* or 2* on the visible directions."""
    base = data.m * (data.d - 1)
    if low.kappa > eps and pencil.q == q:
        proof = certify(pencil, eps, low.modes)
        if proof.counterexample is not None:
            low = low.moved(pencil, proof.counterexample)
    at = f"lambda = {_text(low.lambda_)}"
    clear = pencil.q == q or data.sigma[pencil.q - 1] > CLEAR * eps
    if low.kappa <= eps and clear:
        verdict = Verdict.NOT_PROVED
        reason = f"the pencil is within the noise bound of losing rank at {at}: consistent with an uncontrollable mode"
    elif pencil.q < q:
        verdict = Verdict.UNDECIDED
        reason = (
            f"only {pencil.q} of the {names.order} = {q} directions are seen: "
            "the others are unobservable, never excited, or below the noise"
        )
    elif not proof.complete:
        verdict = Verdict.UNDECIDED
        reason = (
            f"no lambda loses rank in a search, nearest {at}, but the margin is too thin to prove it for all of them"
        )
    else:
        verdict = Verdict.PROVED
        reason = (
            f"the pencil keeps its rank at every lambda for any noise within {names.bound}; nearest to a loss: {at}"
        )
    sigma = low.sigma
    return Finding(
        verdict=verdict,
        reason=reason,
        theorem=names.control,
        rank=base + int(np.count_nonzero(sigma > eps)),
        required=base + q,
        margin=decibel(low.kappa, eps),
        noise_bound=eps,
        lambda_star=low.lambda_,
        gap=float(sigma[-2] / sigma[-1]) if sigma.size > 1 and sigma[-1] > 0 else np.inf,
    )


def find_modes(low: Minimum, eps: float) -> tuple[Mode, ...]:
    """Modes of the visible directions with the strength by which the inputs move them, weakest first."""
    spread = low.modes.radius(eps)
    return tuple(
        Mode(lam, strength, place(lam, max(ON_CIRCLE, float(spread[i]))), strength <= eps)
        for i in np.argsort(low.strengths)
        for lam, strength in [(complex(low.modes.eigenvalues[i]), float(low.strengths[i]))]
    )
