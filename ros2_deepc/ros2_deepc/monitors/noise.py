# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Bounds of the spectral norm of a Hankel matrix of measurement noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .compress import Array

_GAUSS = 1.35
"""Factor over the sum of the largest row and column norms; the 99.9 % quantile of Hankel matrices of white noise was
1.05 to 1.33 of that sum in simulations."""


@dataclass(frozen=True, slots=True)
class Noise:
    """Measurement noise on the outputs, in output units.

    Attributes:
        std: standard deviation per output, or one for all; used when `bound` is None.
        bound: largest absolute value per output, or one for all: the proof is then unconditional.
        estimated: whether the numbers were estimated from the data rather than known.
    """

    std: ArrayLike = 0.0
    bound: ArrayLike | None = None
    estimated: bool = False

    def __post_init__(self) -> None:
        level = np.asarray(self.std if self.bound is None else self.bound, dtype=np.float64)
        if level.ndim > 1 or not np.all(np.isfinite(level)) or np.any(level < 0):
            raise ValueError(f"noise must be finite and not negative, one number or one per output, got {level}")

    @property
    def source(self) -> str:
        """How the noise is known: "exact", "given" or "estimated"."""
        if self.estimated:
            return "estimated"
        return "given" if np.any(np.asarray(self.std if self.bound is None else self.bound)) else "exact"

    def hankel_bound(self, L: int, columns: int, scale: Array) -> float:
        """Bound of ||H_L(v)||_2 for L block rows and the given columns, outputs over `scale` (p,).

        Hard bounds give sqrt(L columns sum vbar^2), attained by constant noise. White Gaussian noise: the largest row
        norm plus the largest column norm, times a constant from simulation; exceeded in one of a thousand windows.

        Raises:
            ValueError: if the noise is given per output for another number of outputs.
        """
        level = np.asarray(self.std if self.bound is None else self.bound, dtype=np.float64)
        if level.ndim and level.shape != scale.shape:
            raise ValueError(f"noise is given for {level.size} outputs, the record has {scale.size}")
        v = np.broadcast_to(level, scale.shape) / scale
        column = float(np.sqrt(L * np.sum(v**2)))
        if self.bound is not None:
            return column * float(np.sqrt(columns))
        return _GAUSS * (column + float(np.sqrt(columns) * v.max(initial=0.0)))


def as_noise(noise: Noise | ArrayLike) -> Noise:
    """A `Noise` as it is; a number or one number per output as standard deviation."""
    return noise if isinstance(noise, Noise) else Noise(std=noise)
