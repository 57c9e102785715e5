# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Measured disturbances and forecasts of them, by sample."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


class DisturbanceRecord:
    """What is known of the disturbances: measured up to now, forecast beyond; what came last for a sample counts.

    Args:
        size: number of disturbances; 0 if the settings have none.
    """

    def __init__(self, size: int) -> None:
        self._size = size
        self._values: dict[int, Array] = {}

    def set(self, k: int, values: ArrayLike) -> None:
        """Takes the disturbances of sample k, shape (size,), or those of k, k + 1, ..., shape (any, size).

        Raises:
            ValueError: for a wrong size or a value that is not finite; nothing is then taken.
        """
        d = np.array(values, dtype=np.float64)
        if d.ndim not in (1, 2) or d.shape[-1] != self._size:
            raise ValueError(f"disturbances have shape {d.shape}: give ({self._size},) or (samples, {self._size})")
        if not np.isfinite(d).all():
            raise ValueError(f"the disturbances from sample {k} on are not finite")
        self._values.update(enumerate(np.atleast_2d(d), start=k))

    def at(self, k: int) -> Array | None:
        """The disturbances of sample k, shape (size,); None if nobody has told."""
        return self._values.get(k)

    def forecast(self, k: int, rows: int) -> Array:
        """The disturbances of samples k, ..., k + rows - 1 as far as they are known, then the last known value.

        Sample k - 1 must be known. Everything before it is forgotten.

        Returns:
            Shape (rows, size).
        """
        for old in [j for j in self._values if j < k - 1]:
            del self._values[old]
        known = self._values[k - 1]
        ahead = np.empty((rows, self._size))
        for i in range(rows):
            known = ahead[i] = self._values.get(k + i, known)
        return ahead
