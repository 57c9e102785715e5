# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""What the monitors say: verdicts, findings, reports. Types only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .pencil import Pencil

Array = NDArray[np.float64]


class Verdict(IntEnum):
    """What the data say about one property; see the reason beside it."""

    UNDECIDED = 0
    """The data cannot answer yet: too short, too little excitation, or too noisy."""
    PROVED = 1
    """Holds for every data set within the noise bound, given the prior."""
    NOT_PROVED = 2
    """The data are rich and consistent with the property failing; failure itself is never provable from noisy data."""
    PRIOR_VIOLATED = 3
    """The data contradict the prior or the noise bound: a structure number is too small, or the plant is not linear."""
    REFUTED = 4
    """Impossible for the dimensions given in the prior."""
    NOT_DECIDABLE = 5
    """No input-output data can decide it under this prior."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Prior:
    """What is known about the plant besides its data (paper, section 2).

    Attributes:
        q: dimension of the slow part. An upper bound is safe: the verdict then stays UNDECIDED, never wrongly PROVED.
            Too small by one is always noticed in exact data, but not always under noise (docs/theory.md).
        s: index of nilpotency, at least 1. An upper bound is safe; too small by one as for q.
        n: state dimension, q plus that of the fast part; 0 = unknown. Only the C-properties need it.
        D: feed-through, shape (p, m); None = unknown. Only the C-properties need it.

    Raises:
        ValueError: if the numbers contradict each other.
    """

    q: int
    s: int = 1
    n: int = 0
    D: ArrayLike | None = None

    def __post_init__(self) -> None:
        if self.q < 0:
            raise ValueError(f"prior q = {self.q} must not be negative: give an upper bound of the slow dimension")
        if self.s < 1:
            raise ValueError(f"prior s = {self.s} must be at least 1 (1 also for a plant without algebraic part)")
        if self.n and self.n < self.q:
            raise ValueError(f"prior n = {self.n} is smaller than q = {self.q}: n counts slow and fast states")
        if self.n and self.s > max(1, self.n - self.q):
            raise ValueError(f"prior s = {self.s} exceeds the fast dimension r = n - q = {self.n - self.q}")

    @property
    def r(self) -> int:
        """Dimension of the fast part, n - q; -1 = unknown."""
        return self.n - self.q if self.n else -1


@dataclass(frozen=True, slots=True)
class Mode:
    """A mode of the slow part as the data show it.

    Attributes:
        lambda_: eigenvalue.
        strength: how far the inputs move it, in the units of `Finding.noise_bound`.
        place: "inside", "on" or "outside" the unit circle; "on" also when noise could have moved it from there.
        at_fault: whether its strength is within the noise bound: consistent with an uncontrollable mode.
    """

    lambda_: complex
    strength: float
    place: str
    at_fault: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """The answer for one property.

    Attributes:
        verdict: see `Verdict`.
        reason: one sentence that says what was found and what to do.
        theorem: which theorem spoke ("1*" to "4*", or "dimensions"); empty when none could.
        rank: singular values above the noise bound in the matrix of the theorem, at its worst lambda.
        required: rank that the theorem asks for.
        margin: 20 log10 of the deciding singular value over the noise bound [dB]; nan when not computed.
        noise_bound: bound of the noise Hankel matrix in scaled units; the proof holds for any noise within it.
        lambda_star: lambda at which the pencil is nearest to losing rank; nan when not computed.
        gap: ratio of the deciding singular value to the next one; inf when there is none, nan when not computed.
    """

    verdict: Verdict
    reason: str
    theorem: str = ""
    rank: int = 0
    required: int = 0
    margin: float = float("nan")
    noise_bound: float = float("nan")
    lambda_star: complex = complex("nan")
    gap: float = float("nan")


@dataclass(frozen=True, slots=True, kw_only=True)
class Printed:
    """A theorem of the paper exactly as printed.

    Attributes:
        holds: whether its rank condition holds on the data.
        rank: rank found, at its worst lambda.
        required: rank that the theorem asks for.
        lambda_star: that lambda; nan for the theorems without one.
        reason: what is missing; empty when it holds.
    """

    holds: bool
    rank: int
    required: int
    lambda_star: complex = complex("nan")
    reason: str = ""


@dataclass(frozen=True, slots=True)
class StructureEstimate:
    """Structure that the data show; every number is a lower bound that holds for any noise within the bound.

    Attributes:
        q: slow directions seen (visible and excited); 0 = nothing seen.
        s: index of nilpotency seen; 0 = unknown.
        lag: observability index seen; 0 = unknown.
        rho: ranks of the fast part seen from the j-th input beyond the window on, j = 1, 2, ...
    """

    q: int = 0
    s: int = 0
    lag: int = 0
    rho: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """All answers of one analysis.

    Attributes:
        r_controllability: of the slow part (paper, definition 1).
        c_controllability: of the whole state (paper, definition 3).
        r_observability: of the slow part (paper, definition 2).
        c_observability: of the whole state (paper, definition 4).
        printed: the paper's Theorems 1 to 4 exactly as printed, by number; computed when asked for.
        modes: modes of the slow part, weakest first.
        excitation_order: order of persistency of excitation of the inputs.
        excitation_need: order that guarantees rich data whatever the initial state (Theorem 5 of the paper).
        rank: of the data matrix [H(u); H(y)] over the window.
        rank_need: rank of that matrix for rich data of an observable plant.
        L: output block rows of the pencils.
        samples: outputs used.
        columns: columns of the data matrix.
        estimate: structure that the data show.
        noise_source: "exact", "given" or "estimated".
        pencil: the matrix function of lambda that R-controllability was decided on; None if it came to none.
    """

    r_controllability: Finding
    c_controllability: Finding
    r_observability: Finding
    c_observability: Finding
    printed: Mapping[int, Printed]
    modes: tuple[Mode, ...]
    excitation_order: int
    excitation_need: int
    rank: int
    rank_need: int
    L: int
    samples: int
    columns: int
    estimate: StructureEstimate
    noise_source: str
    pencil: Pencil | None = None

    def margins(self, lam: ArrayLike) -> Array:
        """Margin of the rank that R-controllability needs, at each lambda [dB]; `Finding.margin` is the least of all.

        Args:
            lam: complex numbers (inf allowed), any shape.

        Returns:
            20 log10(kappa(lambda) / noise bound), same shape; nan everywhere if the data did not come to a pencil.
        """
        points = np.asarray(lam, dtype=np.complex128)
        if self.pencil is None:
            return np.full(points.shape, np.nan)
        kappa = self.pencil.singular_values(points.ravel())[:, -1]
        with np.errstate(divide="ignore"):
            return np.asarray(20 * np.log10(kappa / self.r_controllability.noise_bound)).reshape(points.shape)
