# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The last check before an input leaves."""

from math import isfinite

import numpy as np

from ros2_deepc.behavior.hankel import Array


class Limiter:
    """Keeps inputs inside the box and the rate limits, whatever comes in.

    The box wins over the rate when both cannot hold (the last input was outside the box).

    Args:
        u_min: shape (m,).
        u_max: shape (m,).
        du_max: largest change per sample, shape (m,).
    """

    def __init__(self, u_min: Array, u_max: Array, du_max: Array) -> None:
        self.u_min, self.u_max, self.du_max = u_min, u_max, du_max
        self._slow = bool(np.isfinite(du_max).any())

    def apply(self, u: Array, last: Array | None) -> Array:
        """The admissible input nearest to u in each channel.

        Args:
            u: wanted input, shape (m,); a NaN means "no wish" and holds the last input.
            last: input one sample before, or None if there was none.
        """
        if not all(map(isfinite, u.tolist())):
            held = np.minimum(np.maximum(0.0, self.u_min), self.u_max) if last is None else last
            u = np.where(np.isnan(u), held, u)
        if self._slow and last is not None:
            u = np.minimum(np.maximum(u, last - self.du_max), last + self.du_max)
        limited: Array = np.minimum(np.maximum(u, self.u_min), self.u_max)
        return limited
