# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The window of a run as a factor that follows it sample by sample, and the margins that it shows each time."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ros2_deepc.behavior import SlidingFactor

from .compress import Array, Compression, split
from .increments import Form, change, noise_of_changes
from .indicator import Indicator, margins, too_short
from .noise import Noise
from .verdict import Prior


class Stream:
    """The newest window of [H_{L+s}(u); H_{L+1}(y)], factored; a sample costs the same whatever the window's length.

    It is the `SlidingFactor` of the controller's moving window, here with outputs paired with the newest inputs that
    they depend on, and with the rows of the inputs first, so that its triangle is that of a `Compression`.

    Args:
        m: inputs.
        p: outputs.
        prior: q and s are used.
        L: output block rows of the pencil.
        window: outputs kept.
        form: whether the values themselves are followed, or their changes.
    """

    def __init__(self, m: int, p: int, prior: Prior, L: int, window: int, form: Form = "absolute") -> None:
        self.m, self.p, self.prior, self.L, self.window = m, p, prior, L, window
        d, s = L + prior.s, prior.s
        places = np.arange((m + p) * d).reshape(d, m + p)  # block i holds u(j + i) over y(j + i - s + 1)
        order = np.concatenate([places[:, :m].ravel(), places[s - 1 :, m:].ravel()])
        self._factor = SlidingFactor(m + p, d, max(1, window - d + 1), order=order)
        self._changes = form == "incremental"
        self._last: tuple[Array, Array] | None = None  # of this record
        self._peak = np.zeros(p)
        self._channel = np.concatenate([np.tile(np.arange(m), d), np.tile(np.arange(m, m + p), L + 1)])

    def push(self, u: Array, y: Array) -> None:
        """Takes outputs k, shape (p,), and the newest inputs that they depend on, u(k+s-1), shape (m,)."""
        if not self._changes:
            self._factor.push(np.concatenate([u, y]))
            return
        if self._last is not None:
            self._factor.push(np.concatenate([u - self._last[0], change(self._last[1], y)]))
        self._last, self._peak = (u, y), np.maximum(self._peak, np.abs(y))

    def cut(self) -> None:
        """The next sample starts a record."""
        self._last = None
        self._factor.cut()

    def refill(self, records: Iterable[tuple[Array, Array]]) -> None:
        """Takes records, inputs (K+s-1, m) and outputs (K, p), one after the other."""
        for u, y in records:
            self.cut()
            for sample in zip(u[self.prior.s - 1 :], y, strict=True):
                self.push(*sample)

    def indicate(self, noise: Noise) -> Indicator:
        """Margins of the window at the modes that it shows."""
        need = self.m * (self.L + self.prior.s) + self.prior.q
        missing = need + 1 - self._factor.held
        if missing > 0:
            return too_short(missing, need, self.L)
        if self._changes:
            noise = noise_of_changes(noise, self._peak)
        data, y_scale = self.compression(noise)
        return margins(data, y_scale, self.prior.q, noise)

    def compression(self, noise: Noise) -> tuple[Compression, Array]:
        """The window in scaled units, outputs weighed by their noise; and output units per scaled unit, shape (p,)."""
        R, columns = self._factor.factor().T, self._factor.held
        squares = np.bincount(self._channel, np.einsum("ij,ij->i", R, R)) / np.bincount(self._channel)
        scale = np.where(squares > 0, np.sqrt(squares / columns), 1.0)
        scale[self.m :] *= noise.weights(scale[self.m :])
        R = R / scale[self._channel][:, None]
        a = self.m * (self.L + self.prior.s)
        data = split(
            R[:a, :a], R[a:, :a], R[a:, a:], self.m, self.p, self.L, columns, float(columns), float(np.linalg.norm(R))
        )
        return data, scale[self.m :]
