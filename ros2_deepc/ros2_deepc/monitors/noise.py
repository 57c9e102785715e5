# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Measurement noise, and bounds of the spectral norm of its Hankel matrices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .compress import Array, Compression

RARE = 1.25
"""By how much the norm of a Hankel matrix of unit white noise exceeds the norms of a row and a column together in one
window of a thousand, over sqrt(L+1). That is how far one sample moves the norm at most, which sets the scale by
Gaussian concentration (with 3.7 for certain). At most 8 of 10 000 simulated windows exceeded it, in 72 shapes."""

QUIET = 1e-12
"""Noise below this share of an output counts as this much: rounding is there, too."""

DOUBT = 1.25
"""An estimated level is taken to be so much larger: most estimates are within a quarter of the truth."""


def gaussian_norm(column: float, row: float, L: int) -> float:
    """Norm that a Hankel matrix of unit white noise over L+1 block rows exceeds in one window of a thousand.

    Args:
        column: norm of one of its columns.
        row: norm of one of its rows.
        L: block rows, less one.
    """
    return column + row + RARE * float(np.sqrt(L + 1))


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """White measurement noise on the outputs, in output units; inputs are taken as commanded, hence exact.

    Attributes:
        std: standard deviation, one for all outputs or one each; used when `bound` is None.
        bound: largest absolute value, one for all outputs or one each: proofs are then unconditional.
        estimated: take the level from the data instead; proofs are then as good as that estimate.
    """

    std: ArrayLike = 0.0
    bound: ArrayLike | None = None
    estimated: bool = False

    def __post_init__(self) -> None:
        level = self._level
        if level.ndim > 1 or not np.all(np.isfinite(level)) or np.any(level < 0):
            raise ValueError(f"noise must be finite and not negative, one number or one per output, got {level}")

    @property
    def _level(self) -> Array:
        return np.asarray(self.std if self.bound is None else self.bound, dtype=np.float64)

    @property
    def source(self) -> str:
        """How the level is known: "exact", "given" or "estimated"."""
        if self.estimated:
            return "estimated"
        return "given" if np.any(self._level) else "exact"

    @property
    def wording(self) -> str:
        """What a proof calls the bound."""
        return "the estimated bound" if self.estimated else "the bound"

    @property
    def averages(self) -> bool:
        """Whether keeping fewer directions of the columns lets less noise through."""
        return self.source != "exact" and (self.estimated or self.bound is None)

    def per_output(self, scale: Array) -> Array:
        """The given level of each output over `scale`, shape (p,).

        Raises:
            ValueError: if the noise is given for another number of outputs.
        """
        level = self._level
        if level.ndim and level.shape != scale.shape:
            raise ValueError(f"noise is given for {level.size} outputs, the record has {scale.size}")
        return np.broadcast_to(level, scale.shape) / scale

    def weights(self, scale: Array) -> Array:
        """What to divide the scaled outputs by, so that the quieter ones count for more, shape (p,).

        With equal noise on all of them no bound is spent on outputs that are better than the worst.

        Args:
            scale: output units per scaled unit, shape (p,).
        """
        level = self.per_output(scale)
        if self.source != "given" or not self.averages:
            return np.ones(scale.shape)
        level = np.maximum(level, QUIET)
        return np.asarray(level / level.max())

    def level(self, data: Compression, scale: Array, q: int) -> Array:
        """The level of each output in scaled units, shape (p,); estimated from what lies beyond q directions."""
        return np.full(scale.shape, DOUBT * estimate_std(data, q)) if self.estimated else self.per_output(scale)

    def hankel_bound(self, data: Compression, level: Array) -> float:
        """Bound of the norm of the noise in a compressed window, in scaled units.

        A hard bound vbar gives sqrt((L+1) columns sum vbar^2), attained by constant noise. White Gaussian noise: see
        `gaussian_norm`, with the row norm of what the columns kept let through.

        Args:
            data: the window.
            level: from `level`, shape (p,).
        """
        column = float(np.sqrt((data.L + 1) * np.sum(level**2)))
        if not self.averages:
            return column * float(np.sqrt(data.columns))
        loudest = float(level.max())
        return gaussian_norm(column / loudest, float(np.sqrt(data.spread)), data.L) * loudest if loudest else 0.0


def as_noise(noise: Noise | ArrayLike | None) -> Noise:
    """A `Noise` as it is; None as estimated; a number, or one per output, as standard deviation."""
    if isinstance(noise, Noise):
        return noise
    return Noise(estimated=True) if noise is None else Noise(std=noise)


def estimate_std(data: Compression, q: int) -> float:
    """Standard deviation of white noise in scaled units, from the median singular value beyond the q strongest.

    The rest of the window is then a noise matrix, whose median singular value follows the Marchenko-Pastur law
    (Gavish and Donoho, The optimal hard threshold for singular values is 4/sqrt(3), 2014). The noise is taken to be
    equal on all scaled outputs: a level for each would let the few directions that a wrong prior or a nonlinear plant
    leaves pass for noise of one output.

    Raises:
        ValueError: if fewer than three singular values are left.
    """
    rows, columns = len(data.directions) - q, data.columns - len(data.R11) - q
    tail = data.sigma[q:]
    if min(rows, columns) < 3:
        need = 3 - min(rows, columns)
        raise ValueError(
            f"too few directions are left to estimate the noise from: give {need} more samples, or its level"
        )
    small, large = min(rows, columns), max(rows, columns)
    return float(np.median(tail[:small])) / float(np.sqrt(large * marchenko_pastur_median(small / large)))


def marchenko_pastur_median(beta: float) -> float:
    """Median of the Marchenko-Pastur law of aspect ratio beta in (0, 1], unit variance."""
    low, high = (1 - np.sqrt(beta)) ** 2, (1 + np.sqrt(beta)) ** 2
    angle = (np.arange(2000) + 0.5) * np.pi / 2000  # x = middle + half cos(angle) smooths both edges
    x = (low + high) / 2 - (high - low) / 2 * np.cos(angle)
    weight = np.sin(angle) ** 2 / x
    share = (np.cumsum(weight) - weight / 2) / np.sum(weight)
    return float(np.interp(0.5, share, x))
