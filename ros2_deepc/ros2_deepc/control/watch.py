# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Notices that the loop runs away: outputs beyond their bounds, or predictions that have stopped being any good."""

from collections import deque
from dataclasses import dataclass, fields
from statistics import median

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounds:
    """What a healthy loop keeps to.

    Attributes:
        trip_min: lowest output that is still trusted to the controller, one for all or one an output.
        trip_max: highest one.
        trip_error: largest median prediction error over ``trip_window`` samples, relative to what "nothing changes"
            would have got wrong on the data; 1 = the predictor is no better than that. A disturbance from outside is a
            surprise for a few samples only, and leaves the median alone.
        trip_window: samples of that median.

    Raises:
        ValueError: for a number that cannot work.
    """

    trip_min: float | tuple[float, ...] = -np.inf
    trip_max: float | tuple[float, ...] = np.inf
    trip_error: float = np.inf
    trip_window: int = 10

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, (list, np.ndarray)):
                object.__setattr__(self, field.name, tuple(float(v) for v in value))
        low, high = np.broadcast_arrays(np.asarray(self.trip_min, float), np.asarray(self.trip_max, float))
        if not (low < high).all():
            raise ValueError(f"trip_min = {self.trip_min} must lie below trip_max = {self.trip_max}")
        if not self.trip_error > 0:
            raise ValueError(f"trip_error = {self.trip_error}: must be positive (1 = as bad as no prediction)")
        if self.trip_window < 1:
            raise ValueError(f"trip_window = {self.trip_window}: must be at least 1")


class Watch:
    """Compares each sample with the bounds and with the prediction made for it.

    Args:
        p: number of outputs.
        bounds: what to keep to.

    Raises:
        ValueError: if a bound is given for another number of outputs.
    """

    def __init__(self, p: int, bounds: Bounds) -> None:
        for name in ("trip_min", "trip_max"):
            if np.size(getattr(bounds, name)) not in (1, p):
                raise ValueError(f"{name} has {np.size(getattr(bounds, name))} entries: give one number or {p}")
        self.bounds = bounds
        self._p = p
        self.reset()

    def reset(self) -> None:
        """Forgets everything: new data are being collected."""
        self._last: Array | None = None
        self._changes = np.zeros(self._p)  # sum of squares
        self._count = 0
        self.clear()

    def clear(self) -> None:
        """Forgets the recent errors: a new spell of control begins."""
        self._errors: deque[float] = deque(maxlen=self.bounds.trip_window)

    def learn(self, y: ArrayLike) -> None:
        """Takes a sample of the data on which the predictor will rest, shape (p,)."""
        y = np.array(y, dtype=np.float64)
        if self._last is not None:
            self._changes += (y - self._last) ** 2
            self._count += 1
        self._last = y

    def look(self, y: ArrayLike, predicted: ArrayLike | None) -> str:
        """Judges a sample under control.

        Args:
            y: outputs, shape (p,).
            predicted: what had been predicted for them, shape (p,); None or NaN where nothing was.

        Returns:
            What is wrong, in one line; empty if nothing.
        """
        y, bounds = np.asarray(y, dtype=np.float64), self.bounds
        out = np.flatnonzero(~((y >= bounds.trip_min) & (y <= bounds.trip_max)))
        if out.size:
            i = int(out[0])
            return f"output {i} is {y[i]:.6g}, beyond its bounds"
        if predicted is None or not self._count or bounds.trip_error == np.inf:
            return ""
        scale = np.sqrt(self._changes / self._count)
        error = np.abs(y - np.asarray(predicted, dtype=np.float64))
        told = (scale > 0) & ~np.isnan(error)
        self._errors.append(float((error[told] / scale[told]).max(initial=0.0)))
        typical = median(self._errors)
        if len(self._errors) == bounds.trip_window and typical > bounds.trip_error:
            return (
                f"predictions were off by {typical:.3g} times the changes seen in the data over the last "
                f"{bounds.trip_window} samples: more data, more regularisation or a smaller N is needed"
            )
        return ""
