# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""References over time."""

from bisect import bisect_right, insort

import numpy as np
from numpy.typing import ArrayLike, NDArray


class ReferenceSchedule:
    """References by the first sample from which they hold."""

    def __init__(self, p: int) -> None:
        self._p = p
        self._steps: dict[int, NDArray[np.float64]] = {}
        self._starts: list[int] = []  # in order: a reference that moves at every sample has many

    def set(self, k: int, values: ArrayLike) -> None:
        """Sets the reference that holds from sample k on, shape (p,).

        Raises:
            ValueError: for a wrong size or a value that is not finite.
        """
        y = np.array(values, dtype=np.float64)
        if y.shape != (self._p,):
            raise ValueError(f"a reference for {self._p} outputs has shape ({self._p},), got {y.shape}")
        if not np.isfinite(y).all():
            raise ValueError(f"the reference {y.tolist()} from sample {k} on is not finite")
        y.setflags(write=False)
        if k not in self._steps:
            insort(self._starts, k)
        self._steps[k] = y

    def at(self, k: int) -> NDArray[np.float64] | None:
        """The reference at sample k, shape (p,); None before the first one."""
        past = bisect_right(self._starts, k)
        return self._steps[self._starts[past - 1]] if past else None

    def forget(self, k: int) -> None:
        """Drops what no longer holds at sample k, so that a reference that moves for ever takes no more room."""
        over = bisect_right(self._starts, k) - 1
        if over > 0:
            for start in self._starts[:over]:
                del self._steps[start]
            del self._starts[:over]

    def __len__(self) -> int:
        return len(self._starts)
