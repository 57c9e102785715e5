# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Inputs that make data rich while nothing is known yet, inside the input and rate limits."""

from collections.abc import Callable, Iterator
from itertools import count
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from ros2_deepc.behavior.hankel import Array, as_signal

from .limiter import Limiter

Signal = Literal["uniform", "prbs", "multisine"]


class Excitation:
    """An endless input signal that respects the box and the rate limits.

    Kinds: "uniform": white, uniform over the range (over what the rate limit leaves of it). "prbs": each channel sits
        at
    either end of its range and may switch every `hold` samples. "multisine": random-phase sines with period `period`;
    each channel has its own frequencies, so channels are orthogonal over a period; excites of order 2 * (tones per
    channel). A record of one's own, shape (T, m), is played and repeated, limited where it must be.

    Args:
        kind: one of the names, or the record.
        u_min: lower limits, shape (m,), finite.
        u_max: upper limits, shape (m,), finite.
        rng: source of all randomness.
        du_max: largest change per sample, shape (m,); None for no limit.
        amplitude: share of the range to use around its middle, in (0, 1].
        hold: samples between switches of "prbs".
        period: samples of a period of "multisine".

    Raises:
        ValueError: if the limits are not finite or empty, or a number is out of range.
    """

    def __init__(
        self,
        kind: Signal | ArrayLike,
        u_min: ArrayLike,
        u_max: ArrayLike,
        rng: np.random.Generator,
        *,
        du_max: ArrayLike | None = None,
        amplitude: float = 1.0,
        hold: int = 1,
        period: int = 128,
    ) -> None:
        low, high = np.atleast_1d(np.array(u_min, dtype=np.float64)), np.atleast_1d(np.array(u_max, dtype=np.float64))
        if low.shape != high.shape or low.ndim != 1:
            raise ValueError(f"u_min {low.shape} and u_max {high.shape} must be vectors of the same size")
        if not (np.isfinite(low).all() and np.isfinite(high).all() and (low <= high).all()):
            raise ValueError("excitation needs finite input limits with u_min <= u_max")
        if not 0 < amplitude <= 1:
            raise ValueError(f"amplitude = {amplitude}: must lie in (0, 1]")
        if hold < 1 or period < 2:
            raise ValueError(f"hold = {hold} must be at least 1 and period = {period} at least 2")
        du = np.full(low.size, np.inf) if du_max is None else np.broadcast_to(np.asarray(du_max, float), low.shape)
        if not (du > 0).all():
            raise ValueError(f"du_max = {du.min():g}: a rate limit must be positive")
        middle, half = (low + high) / 2, amplitude * (high - low) / 2
        self._limiter, self._rng, self._du = Limiter(low, high, du), rng, du
        # the whole range as it stands, so that rounding does not move its ends
        self._low, self._high = (low, high) if amplitude == 1 else (middle - half, middle + half)
        self._last: Array | None = None
        if isinstance(kind, str):
            makers: dict[str, Callable[[], Iterator[Array]]] = {
                "uniform": self._uniform,
                "prbs": lambda: self._prbs(hold),
                "multisine": lambda: self._multisine(period),
            }
            if kind not in makers:
                raise ValueError(f"excitation = {kind!r}: must be one of {', '.join(makers)}, or a record")
            self._source = makers[kind]()
        else:
            self._source = self._record(as_signal(kind, "excitation"))

    def next(self, last: Array | None = None) -> Array:
        """The next input, shape (m,).

        Args:
            last: the input really applied one sample before, if it was another one than this signal's own.
        """
        self._last = self._limiter.apply(next(self._source), self._last if last is None else last)
        return self._last.copy()

    def _uniform(self) -> Iterator[Array]:
        while True:
            low, high = self._low, self._high
            if self._last is not None and np.isfinite(self._du).any():
                low = np.minimum(np.maximum(low, self._last - self._du), high)
                high = np.maximum(np.minimum(high, self._last + self._du), low)
            yield self._rng.uniform(low, high)

    def _prbs(self, hold: int) -> Iterator[Array]:
        while True:
            level = np.where(self._rng.random(self._low.size) < 0.5, self._low, self._high)
            for _ in range(hold):
                yield level

    def _multisine(self, period: int) -> Iterator[Array]:
        m = self._low.size
        tones = np.arange(1, (period - 1) // 2 + 1)
        if tones.size < m:
            raise ValueError(f"period = {period} has {tones.size} frequencies for {m} channels: needs {2 * m + 1}")
        k = np.arange(period)
        wave = np.empty((period, m))
        for i in range(m):
            own = tones[i::m]
            phases = self._rng.uniform(0, 2 * np.pi, own.size)
            wave[:, i] = np.cos(2 * np.pi * np.outer(k, own) / period + phases).sum(axis=1)
        wave = (wave - wave.min(axis=0)) / np.ptp(wave, axis=0)
        return self._record(self._low + wave * (self._high - self._low))

    def _record(self, record: Array) -> Iterator[Array]:
        if record.shape[1] != self._low.size or not len(record):
            raise ValueError(f"the record has shape {record.shape}, needs (T, {self._low.size})")
        return (record[k % len(record)] for k in count())
