# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The corrected theorems 1* to 4* as tests on a compressed window.

With U of L+sb-1 block rows (sb inputs beyond the outputs, sb >= s) and Y of L block rows:
1*  rank(pencil(lambda)) = m (L+sb-1) + q for every lambda  =>  R-controllable.
3*  rank(window)         = m (L+sb-1) + q                    =>  R-observable.
With y - D u for y, sb = 0 and n for q the same tests are 2* (C-controllable, infinity included) and 4* (C-observable).
"""

from dataclasses import dataclass

import numpy as np

from .compress import Array, Compression
from .pencil import Minimum, Pencil, reduce
from .verdict import Finding, Mode, Verdict


@dataclass(frozen=True, slots=True)
class Names:
    """How a pair of tests speaks."""

    control: str
    observe: str
    order: str


SLOW = Names("1*", "3*", "q")
WHOLE = Names("2*", "4*", "n")


@dataclass(frozen=True, slots=True)
class Outcome:
    """Both findings of one window, with the numbers behind them.

    Attributes:
        controllability: finding of 1* or 2*.
        observability: finding of 3* or 4*.
        modes: weakest first.
        autonomous: singular values of the outputs without the inputs' share, scaled units.
        eps: noise bound used.
        excited: whether the inputs are persistently exciting of the order of the window.
    """

    controllability: Finding
    observability: Finding
    modes: tuple[Mode, ...]
    autonomous: Array
    eps: float
    excited: bool


def decibel(value: float, bound: float) -> float:
    """20 log10(value/bound), -inf for a zero value."""
    return float(20 * np.log10(value / bound)) if value > 0 else -np.inf


def place(lam: complex, tolerance: float = 1e-6) -> str:
    """Where a mode lies against the unit circle."""
    distance = abs(lam) - 1
    if abs(distance) <= tolerance:
        return "on"
    return "inside" if distance < 0 else "outside"


def decide(data: Compression, q: int, eps_noise: float, names: Names = SLOW) -> Outcome:
    """Runs both tests of a family on one window.

    Args:
        data: compressed window with d = L + sb input block rows.
        q: dimension to be shown (q, or n for the C-properties).
        eps_noise: bound of the Hankel matrix of the noise on Y, scaled units; the rounding floor is added.
        names: family of theorems.
    """
    eps = eps_noise + data.floor
    inverse = data.inverse()
    if inverse is None:
        reason = (
            f"the inputs are not persistently exciting of order {data.d}: vary every input independently for a while"
        )
        blank = Finding(verdict=Verdict.UNDECIDED, reason=reason, noise_bound=eps)
        return Outcome(blank, blank, (), np.zeros(0), eps, False)
    sigma: Array = np.linalg.svd(data.R22, compute_uv=False).astype(np.float64, copy=False)
    seen = int(np.count_nonzero(sigma > eps))
    visible = min(seen, q)
    pencil = reduce(data, inverse, visible)
    modes = find_modes(pencil, eps) if visible else ()
    observe = _observability(data, sigma, seen, q, eps, names)
    if seen > q:
        control = observe
    else:
        control = _controllability(data, pencil.minimum() if visible else None, visible, q, eps, names)
    return Outcome(control, observe, modes, sigma, eps, True)


def _observability(data: Compression, sigma: Array, seen: int, q: int, eps: float, names: Names) -> Finding:
    """Theorem 3* or 4* over the whole window."""
    base = data.m * data.d
    deciding = float(sigma[q - 1]) if 0 < q <= sigma.size else 0.0
    following = float(sigma[q]) if q < sigma.size else 0.0
    if seen > q:
        verdict = Verdict.PRIOR_VIOLATED
        reason = (
            f"the outputs show {seen} autonomous directions above the noise bound, {names.order} = {q} allows {q}: "
            f"{names.order} or s is too small, the noise bound too small, or the plant not linear"
        )
    elif q == 0 or deciding > eps:
        verdict = Verdict.PROVED
        reason = f"the window has rank {base + q}, all that {names.order} = {q} allows, for any noise within the bound"
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


def _controllability(data: Compression, low: Minimum | None, visible: int, q: int, eps: float, names: Names) -> Finding:
    """Theorem 1* or 2* on the visible directions."""
    base = data.m * (data.d - 1)
    if low is None:
        verdict = Verdict.PROVED if q == 0 else Verdict.UNDECIDED
        reason = (
            "there is no slow part to control"
            if q == 0
            else f"no direction rises above the noise bound, {names.order} = {q}"
        )
        return Finding(
            verdict=verdict, reason=reason, theorem=names.control, rank=base, required=base + q, noise_bound=eps
        )
    at = f"lambda = {low.lambda_:.6g}"
    if low.kappa <= eps:
        verdict = Verdict.NOT_PROVED
        reason = (
            f"the pencil is within the noise bound of losing rank at {at}: consistent with an uncontrollable mode there"
        )
    elif visible < q:
        verdict = Verdict.UNDECIDED
        reason = (
            f"the {visible} directions seen are controllable, but {names.order} = {q} are needed: "
            "the others are unobservable, never excited, or below the noise"
        )
    else:
        verdict = Verdict.PROVED
        reason = (
            f"the pencil keeps full rank at every lambda for any noise within the bound; nearest to losing it at {at}"
        )
    sigma = low.singular_values
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


def find_modes(pencil: Pencil, eps: float) -> tuple[Mode, ...]:
    """Modes of the visible directions with the strength by which the inputs move them, weakest first."""
    lam = pencil.eigenvalues()
    strength = pencil.kappa(lam)
    order = np.argsort(strength)
    return tuple(
        Mode(complex(lam[i]), float(strength[i]), place(complex(lam[i])), bool(strength[i] <= eps)) for i in order
    )
