# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Where is the pencil nearest to losing rank? A quick search for the margin; the proof is in `certify`."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .compress import Array
from .modal import Modal, modal
from .pencil import Complex, Pencil, Points

_RINGS = np.concatenate(
    [[0], 0.6 * np.exp(2j * np.pi * np.arange(5) / 5), np.exp(1j * np.pi * np.arange(13) / 12), [np.inf]]
)
"""Extra starts."""

_STARTS = 5
_STEPS = 12


@dataclass(frozen=True, slots=True)
class Minimum:
    """Where the pencil is nearest to losing rank.

    Attributes:
        lambda_: where.
        sigma: singular values of N there over the weight, largest first, shape (q,).
        modes: of the slow part as the data show them.
        strengths: kappa at those modes, shape (q,).
    """

    lambda_: complex
    sigma: Array
    modes: Modal
    strengths: Array

    @property
    def kappa(self) -> float:
        """The smallest of the singular values."""
        return float(self.sigma[-1])

    def moved(self, pencil: Pencil, lam: complex) -> Minimum:
        """The same search with another lambda found lower."""
        return replace(self, lambda_=lam, sigma=pencil.singular_values(np.array([lam]))[0])


def minimum(pencil: Pencil) -> Minimum:
    """Smallest kappa met in a search over the sphere: modes, rings, then Gauss-Newton from the best of them."""
    modes = modal(pencil)
    starts = np.concatenate([modes.eigenvalues, _RINGS])
    kappa = pencil.singular_values(starts)[:, -1]
    strengths = kappa[: pencil.q]
    once = starts.imag >= 0  # data are real: kappa is the same at conjugate lambda
    lam, sigma = refine(pencil, starts[once][np.argsort(kappa[once])[:_STARTS]])
    lowest = int(np.argmin(sigma[:, -1]))
    return Minimum(complex(lam[lowest]), sigma[lowest], modes, strengths)


def refine(pencil: Pencil, lam: Complex) -> tuple[Complex, Array]:
    """Gauss-Newton descent of kappa from each start: the best lambda met from each, and the singular values there."""
    at, kept = Points.of(lam), lam.copy()
    best = np.full((lam.size, pencil.q), np.inf)
    for _ in range(_STEPS):
        value = pencil.evaluate(at)
        left, sigma, _ = np.linalg.svd(value.N, full_matrices=False)
        sigma = sigma / pencil.weight(at.t)[:, None]
        better = sigma[:, -1] < best[:, -1]
        gained = np.any(sigma[:, -1] < 0.9 * best[:, -1])
        best[better], kept[better] = sigma[better], at.lambda_[better]
        if not gained:
            break
        weakest = left[:, :, -1].conj()[:, None, :]
        r, dr = (weakest @ value.N)[:, 0], (weakest @ value.rate)[:, 0]
        slope = np.sum(abs(dr) ** 2, axis=1)
        shift = np.sum(dr.conj() * r, axis=1) / np.where(slope > 0, slope, 1)
        at = Points.of(Points(at.t - shift, at.outer).lambda_)
    return kept, best
