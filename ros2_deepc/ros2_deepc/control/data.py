# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""What a set of records can do: its ranks, its excitation, the predictor it gives."""

from functools import cached_property

import numpy as np

from ros2_deepc.behavior import Record, collective_excitation_order, data_matrix, excites
from ros2_deepc.behavior.hankel import Array

from .layout import Layout
from .predictor import EPS, PoorDataError, Predictor, Truncation, fit, fit_causal
from .settings import Sized

NOISE_NORM = 1.35  # sqrt(rows) + sqrt(columns) times this bounds the norm of a white Hankel matrix 999 times in 1000


class Snapshot:
    """A set of records. Everything is worked out on demand and once.

    Args:
        records: unbroken records; u holds inputs and disturbances and may be s - 1 samples longer than y.
        sized: settings.
        layout: rows of the data matrix.
        scale: scales of the channels, (m + disturbances,) and (p,); the root mean square of these records if None.
    """

    def __init__(
        self, records: tuple[Record, ...], sized: Sized, layout: Layout, scale: tuple[Array, Array] | None = None
    ) -> None:
        self.records, self.sized, self.layout, self._scale = records, sized, layout, scale

    @cached_property
    def scale(self) -> tuple[Array, Array]:
        """Scales of the channels."""
        if self._scale is not None:
            return self._scale
        if not self.records:
            return np.ones(self.sized.m + self.sized.base.disturbances), np.ones(self.sized.p)
        return _rms([r.u for r in self.records]), _rms([r.y for r in self.records])

    @cached_property
    def matrix(self) -> Array:
        """Data matrix with scaled channels and grouped rows, shape (rows, columns)."""
        su, sy = self.scale
        scaled = [Record(u / su, y / sy) for u, y in self.records]
        if not scaled:
            return np.zeros((self.layout.stacked.size, 0))
        return np.ascontiguousarray(data_matrix(scaled, self.sized.rows_u, self.sized.rows_y)[self.layout.stacked])

    @cached_property
    def singular_values(self) -> Array:
        """Singular values of the data matrix, falling; shape (min(rows, columns),)."""
        return np.asarray(np.linalg.svd(self.matrix, compute_uv=False))

    @cached_property
    def rank(self) -> int:
        """Singular values above rounding (and above the noise, if there is any)."""
        sv = self.singular_values
        if not sv.size:
            return 0
        floor = max(10 * max(self.matrix.shape) * EPS * float(np.linalg.norm(sv)), self.noise_norm)
        return int(np.count_nonzero(sv > floor))

    @cached_property
    def gap(self) -> float:
        """Singular value at the rank over the next one."""
        sv, rank = self.singular_values, self.rank
        return float(sv[rank - 1] / sv[rank]) if 0 < rank < sv.size and sv[rank] > 0 else np.inf

    @cached_property
    def excitation_order(self) -> int:
        """Order of which the inputs of all records excite together, counted up to what is needed."""
        return collective_excitation_order([r.u[:, : self.sized.m] for r in self.records], self.sized.excitation_need)

    @cached_property
    def rich(self) -> bool:
        """Whether the data describe every continuation of this run.

        Either the inputs excite as Corollary 1 asks (enough even where the plant is not controllable and the rank stays
        below m (N+L+s-1) + q for ever), or the data matrix has that rank.
        """
        by_rank = self.sized.base.q > 0 and self.sized.base.disturbances == 0
        if not (
            excites([r.u[:, : self.sized.m] for r in self.records], self.sized.excitation_need)
            or (by_rank and self.rank >= self.sized.rank_need)
        ):
            return False
        try:
            return self.predictor is not None
        except PoorDataError:  # by a hair's breadth, and rounding decides otherwise
            return False

    @cached_property
    def noise_norm(self) -> float:
        """Norm that the outputs' noise does not exceed in the data matrix."""
        return noise_norm(self.sized, self.scale[1], self.matrix.shape[1])

    @cached_property
    def predictor(self) -> Predictor:
        """The predictor for scaled channels; raises PoorDataError if the data determine none."""
        regress = fit_causal if self.sized.base.predictor == "causal" else fit
        return regress(self.matrix, self.layout, self.matrix.shape[1], truncation(self.sized, self.noise_norm))


def noise_norm(sized: Sized, y_scale: Array, columns: int) -> float:
    """Norm that the outputs' noise does not exceed in the scaled data matrix."""
    twice = np.sqrt(2.0) if sized.base.form == "incremental" else 1.0  # differences of noise
    size = np.sqrt(sized.p * sized.rows_y) + np.sqrt(columns)
    return float(NOISE_NORM * size * twice * (sized.noise / y_scale).max())


def truncation(sized: Sized, floor: float) -> Truncation:
    """Which directions of the free response to keep; measured disturbances add theirs to the slow order."""
    order = sized.base.q
    if order and sized.base.disturbances:
        order += sized.base.disturbances * sized.rows_u
    return Truncation(sized.base.cut, order, floor)


def _rms(pieces: list[Array]) -> Array:
    """Root mean square per channel; 1 for a channel that is zero."""
    rms = np.sqrt(np.mean(np.square(np.vstack(pieces)), axis=0))
    return np.asarray(np.where(rms > 0, rms, 1.0))
