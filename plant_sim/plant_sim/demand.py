# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""What the consumers of a water network draw over time."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .arrays import Array
from .errors import PlantError

DAY = 86_400.0
KINDS = "constant, diurnal, file (the network's own patterns), or the path of a text file of factors, one a sample"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Demand:
    """Factors on the mean demand, sample by sample.

    Attributes:
        own: follow the patterns of the network's file instead.
        multiplier: on all of it.
        swing: amplitude of a daily sine on top of one.
        day: samples a day.
        series: factors of one's own, repeated when they end; shape (any,), empty = none.
    """

    own: bool
    multiplier: float
    swing: float
    day: float
    series: Array

    def factor(self, k: int) -> float:
        """Factor of sample k on the mean demand (1 with the network's own patterns, which EPANET applies itself)."""
        if self.own:
            return 1.0
        if len(self.series):
            return float(self.series[k % len(self.series)])
        return 1.0 + self.swing * float(np.sin(2 * np.pi * k / self.day))


def parse_demand(kind: str, multiplier: float, swing: float, dt: float) -> Demand:
    """The demand that an option names.

    Args:
        kind: "constant", "diurnal", "file", or the path of a text file of factors.
        multiplier: on all of it, positive.
        swing: amplitude of the daily sine of "diurnal", in [0, 1).
        dt: sample time, s.

    Raises:
        PlantError: if the option is not understood or a number cannot work.
    """
    if not (multiplier > 0 and 0 <= swing < 1):
        raise PlantError(f"the multiplier {multiplier} must be positive, the swing {swing} must lie in [0, 1)")
    series = np.empty(0)
    if kind not in ("constant", "diurnal", "file"):
        series = _read(Path(kind))
    return Demand(
        own=kind == "file",
        multiplier=float(multiplier),
        swing=float(swing) if kind == "diurnal" else 0.0,
        day=DAY / dt,
        series=series,
    )


def _read(path: Path) -> Array:
    if not path.is_file():
        raise PlantError(f"demand {str(path)!r} is neither known nor a file: choose {KINDS}")
    try:
        series = np.loadtxt(path, delimiter=",", ndmin=1)
    except ValueError as error:
        raise PlantError(f"{path}: factors must be numbers, one a line: {error}") from None
    if series.ndim != 1 or not len(series) or not (np.isfinite(series) & (series > 0)).all():
        raise PlantError(f"{path}: factors must be positive and finite, one a line")
    return series
