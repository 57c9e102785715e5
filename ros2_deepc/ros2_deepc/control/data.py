# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The data of this run: when they suffice, and the predictor they give."""

from functools import cached_property

import numpy as np

from ros2_deepc.behavior import DataWindow, Record, data_matrix, excitation_order
from ros2_deepc.behavior.hankel import Array

from .predictor import EPS, Blocks, Predictor, channel_scale, fit, triangle, unscale
from .settings import Sized


class Snapshot:
    """What a set of records can do. Everything is worked out on demand and once.

    Args:
        records: unbroken records, u possibly s - 1 samples longer than y.
        sized: settings.
    """

    def __init__(self, records: tuple[Record, ...], sized: Sized) -> None:
        self.records, self.sized = records, sized

    @cached_property
    def scale(self) -> tuple[Array, Array]:
        """Root mean square per channel."""
        if not self.records:
            return np.ones(self.sized.m), np.ones(self.sized.p)
        return channel_scale(np.vstack([r.u for r in self.records]), np.vstack([r.y for r in self.records]))

    @cached_property
    def matrix(self) -> Array:
        """Data matrix [H_{N+L+s-1}(u); H_{N+L}(y)] with channels scaled, shape (rows, columns)."""
        su, sy = self.scale
        scaled = [Record(u / su, y / sy) for u, y in self.records]
        H = data_matrix(scaled, self.sized.rows_u, self.sized.rows_y)
        return H if H.shape[1] else np.zeros((self.sized.m * self.sized.rows_u + self.sized.p * self.sized.rows_y, 0))

    @cached_property
    def triangle(self) -> Array:
        """Triangular factor of the data matrix."""
        return triangle(self.matrix)

    @cached_property
    def noise_floor(self) -> float:
        """Spectral norm that output noise of the given deviation does not exceed in the scaled data matrix.

        1.35 (sqrt(rows) + sqrt(columns)) is the 99.9 % quantile of a random Hankel matrix's norm in practice.
        """
        size = np.sqrt(self.sized.p * self.sized.rows_y) + np.sqrt(self.matrix.shape[1])
        return float(1.35 * size * (self.sized.noise / self.scale[1]).max())

    @cached_property
    def singular_values(self) -> Array:
        """Singular values of the data matrix, falling; shape (min(rows, columns),)."""
        return np.asarray(np.linalg.svd(self.triangle, compute_uv=False))

    @cached_property
    def rank(self) -> int:
        """Singular values above rounding (and above the noise, if there is any)."""
        sv = self.singular_values
        if not sv.size:
            return 0
        return int(np.count_nonzero(sv > max(10 * max(self.matrix.shape) * EPS * sv[0], self.noise_floor)))

    @cached_property
    def gap(self) -> float:
        """Singular value at the rank over the next one."""
        sv, rank = self.singular_values, self.rank
        return float(sv[rank - 1] / sv[rank]) if 0 < rank < sv.size and sv[rank] > 0 else np.inf

    @cached_property
    def excitation_order(self) -> int:
        """Order of excitation of the newest unbroken record, counted up to what is needed."""
        return excitation_order(self.records[-1].u, self.sized.excitation_need) if self.records else 0

    @cached_property
    def rich(self) -> bool:
        """Whether the data describe every continuation of this run.

        Either the inputs excite as Corollary 1 asks (enough even where the plant is not controllable and the rank stays
        below m (N+L+s-1) + q for ever), or the data matrix has that rank.
        """
        if self.excitation_order >= self.sized.excitation_need:
            return True
        return bool(self.sized.base.q) and self.rank >= self.sized.rank_need

    def predictor(self) -> Predictor:
        """The multi-step predictor in the plant's units."""
        sized = self.sized
        N, L, s, m, p = sized.base.N, sized.base.L, sized.base.s, sized.m, sized.p
        blocks = Blocks(known_u=m * (N + s - 1), free_u=m * L, past_y=p * N, future_y=p * L)
        fitted = fit(self.triangle, blocks, self.matrix.shape[1], sized.base.q, self.noise_floor)
        return unscale(fitted, *self.scale, blocks)


class RunData:
    """Data policy "fixed": the first T inputs of the run (or the first T that are rich), then nothing more.

    Args:
        sized: settings.
    """

    def __init__(self, sized: Sized) -> None:
        self._sized = sized
        self._window = DataWindow(sized.m, sized.p, sized.T)
        self._ahead: list[Array] = []
        self._now: Snapshot | None = None
        self._frozen = False

    @property
    def length(self) -> int:
        """Inputs in the window."""
        return min(len(self._window) + len(self._ahead), self._sized.T)

    def observe(self, u: Array, y: Array, ahead: list[Array]) -> None:
        """Takes a sample and the inputs already decided after it."""
        if self._frozen:
            return
        self._window.push(u, y)
        self._ahead, self._now = ahead, None
        self._frozen = self.length >= self._sized.T and self._snapshot.rich

    def cut(self) -> None:
        """The next sample starts a new record."""
        if not self._frozen:
            self._window.cut()
            self._ahead = []

    @property
    def rank(self) -> int:
        """See `Snapshot.rank`."""
        return self._snapshot.rank

    @property
    def gap(self) -> float:
        """See `Snapshot.gap`."""
        return self._snapshot.gap

    @property
    def excitation_order(self) -> int:
        """See `Snapshot.excitation_order`."""
        return self._snapshot.excitation_order

    def predictor(self) -> Predictor:
        """See `Snapshot.predictor`."""
        return self._snapshot.predictor()

    def missing(self) -> str:
        """One line on what the data lack; empty if nothing."""
        if self._frozen:
            return ""
        sized = self._sized
        if self.length < sized.T:
            return f"{sized.T - self.length} more samples: {self.length} of T = {sized.T} inputs are in the window"
        rank = f" and rank {self.rank} is below {sized.rank_need}" if sized.base.q else ""
        return (
            f"richer inputs: they excite of order {self.excitation_order}, needs {sized.excitation_need}{rank}; "
            "the window moves on until either holds"
        )

    @property
    def _snapshot(self) -> Snapshot:
        if self._now is None:
            self._now = Snapshot(self._records(), self._sized)
        return self._now

    def _records(self) -> tuple[Record, ...]:
        """The records with the decided inputs appended, cut to the newest T inputs."""
        records = list(self._window.records())
        if records and self._ahead:
            u, y = records[-1]
            records[-1] = Record(np.vstack([u, self._ahead]), y)
        surplus = sum(len(r.u) for r in records) - self._sized.T
        if surplus > 0 and records:
            records[0] = Record(records[0].u[surplus:], records[0].y[surplus:])
        return tuple(records)
