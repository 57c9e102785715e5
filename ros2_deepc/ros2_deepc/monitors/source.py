# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Where data windows come from: records side by side, or a factor that someone else keeps up to date."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ros2_deepc.behavior import Record, data_matrix, hankel
from ros2_deepc.behavior.hankel import as_signal

from .compress import Array, Compression, compress, excites, triangle


@dataclass(frozen=True, slots=True, kw_only=True)
class Source(ABC):
    """Data in scaled units, from which windows of any length can be cut.

    Attributes:
        u_scale: input units per scaled unit, shape (m,).
        y_scale: output units per scaled unit, shape (p,).
    """

    u_scale: Array
    y_scale: Array

    @property
    def m(self) -> int:
        """Inputs."""
        return self.u_scale.size

    @property
    def p(self) -> int:
        """Outputs."""
        return self.y_scale.size

    @property
    @abstractmethod
    def samples(self) -> int:
        """Outputs held."""

    @abstractmethod
    def columns(self, L: int, d: int, past: int = 0) -> int:
        """Columns of the window (L, d, past)."""

    @abstractmethod
    def window(self, L: int, d: int, past: int = 0) -> Compression:
        """Compresses [H_d(u); H_{L+1}(y)], with `past` block rows of inputs before them as instruments if positive."""

    @abstractmethod
    def wide(self, order: int) -> bool:
        """Whether there are as many columns of inputs as rows at that order: the first need of excitation."""

    @abstractmethod
    def inputs(self, order: int) -> Array:
        """A matrix with the Gram matrix of the inputs' Hankel matrix of that order, shape (m order, c)."""

    def exciting(self, order: int) -> bool:
        """Whether the inputs are persistently exciting of that order, all records together."""
        return order < 1 or (self.wide(order) and excites(triangle(self.inputs(order))))

    def varied(self, d: int, q: int) -> bool:
        """Whether the inputs differ enough for what q directions do not fill to show, as far as the length can tell.

        Inputs that repeat after P samples have P different columns. With m d + q of them the inputs and q directions
        span everything that repeats likewise, an offset of the outputs too: it would then pass for a response.
        """
        order = next((k for k in range(d + q // self.m + 1, d, -1) if self.wide(k)), d)
        return order == d or self.exciting(order)

    @abstractmethod
    def weighted(self, weights: Array) -> Source:
        """The same data with outputs divided by weights, shape (p,)."""

    def without_feedthrough(self, D: Array) -> Source:
        """The same data with y - D u for y; D in the units of the data, shape (p, m)."""
        return self.subtract(D * self.u_scale / self.y_scale[:, None])

    @abstractmethod
    def subtract(self, D: Array) -> Source:
        """The same data with y - D u for y; D in scaled units, shape (p, m)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Records(Source):
    """Unbroken records, each channel divided by its root mean square over all of them.

    Attributes:
        records: scaled; every record holds as many inputs beyond its outputs as were given.
    """

    records: tuple[Record, ...]

    @property
    def samples(self) -> int:
        """Outputs held, all records together."""
        return sum(len(r.y) for r in self.records)

    def columns(self, L: int, d: int, past: int = 0) -> int:
        """Columns of the window (L, d, past), all records together."""
        return sum(max(0, min(len(r.u) - d, len(r.y) - L - 1) - past + 1) for r in self.records)

    def window(self, L: int, d: int, past: int = 0) -> Compression:
        """Compresses [H_d(u); H_{L+1}(y)], with instruments if `past` is positive."""
        if not past:
            W = data_matrix(self.records, d, L + 1)
            return compress(W, self.m, self.p, L, W.shape[1])
        W = data_matrix([Record(r.u, r.y[past:]) for r in self.records], past + d, L + 1)
        rows = self.m * past
        W[: self.m * (past + d)] = np.roll(W[: self.m * (past + d)], -rows, axis=0)
        pieces = [replace(self, records=(r,)).columns(L, d, past) for r in self.records]
        return compress(W, self.m, self.p, L, W.shape[1], rows, pieces)

    def wide(self, order: int) -> bool:
        """Whether there are as many columns of inputs as rows at that order."""
        return sum(max(0, len(r.u) - order + 1) for r in self.records) >= self.m * order

    def inputs(self, order: int) -> Array:
        """The inputs' Hankel matrix, records side by side."""
        return np.hstack([hankel(r.u, order) for r in self.records if len(r.u) >= order])

    def weighted(self, weights: Array) -> Records:
        """The same data with outputs divided by weights, shape (p,)."""
        records = tuple(Record(r.u, r.y / weights) for r in self.records)
        return replace(self, records=records, y_scale=self.y_scale * weights)

    def subtract(self, D: Array) -> Records:
        """The same data with y - D u for y."""
        return replace(self, records=tuple(Record(r.u, r.y - r.u[: len(r.y)] @ D.T) for r in self.records))


@dataclass(frozen=True, slots=True, kw_only=True)
class Factor(Source):
    """A matrix with the Gram matrix of a time-major Hankel matrix of w = (u, y), scaled like `Records`.

    Attributes:
        F: shape (depth, m+p, c).
        held: columns of the Hankel matrix before its compression.
    """

    F: Array
    held: int

    @property
    def samples(self) -> int:
        """Outputs that one record of as many columns holds."""
        return self.held + len(self.F) - 1

    def columns(self, L: int, d: int, past: int = 0) -> int:
        """Columns of the window; none if it is deeper than the factor or asks for instruments."""
        return self.held if max(d, L + 1) <= len(self.F) and not past else 0

    def window(self, L: int, d: int, past: int = 0) -> Compression:
        """Compresses [H_d(u); H_{L+1}(y)]; instruments need the records themselves."""
        if past or not self.columns(L, d):
            raise ValueError(f"a factor of depth {len(self.F)} has no window of L = {L}, d = {d}, past = {past}")
        W = np.concatenate([self.inputs(d), self.F[: L + 1, self.m :].reshape((L + 1) * self.p, -1)])
        return compress(W, self.m, self.p, L, self.held)

    def wide(self, order: int) -> bool:
        """Whether there are as many columns of inputs as rows at that order; never beyond the depth of the factor."""
        return order <= len(self.F) and self.F.shape[2] >= order * self.m

    def inputs(self, order: int) -> Array:
        """The rows of the inputs."""
        return self.F[:order, : self.m].reshape(order * self.m, -1)

    def weighted(self, weights: Array) -> Factor:
        """The same data with outputs divided by weights, shape (p,)."""
        rows = np.concatenate([np.ones(self.m), weights])
        return replace(self, F=self.F / rows[:, None], y_scale=self.y_scale * weights)

    def subtract(self, D: Array) -> Factor:
        """The same data with y - D u for y."""
        F = self.F.copy()
        F[:, self.m :] -= np.einsum("pm,tmc->tpc", D, F[:, : self.m])
        return replace(self, F=F)


def from_records(records: Sequence[tuple[ArrayLike, ArrayLike]], s: int) -> Records:
    """Checks, trims and scales records; outputs whose s-1 next inputs are not known are left out.

    Raises:
        ValueError: no record, wrong or differing shapes, or a value that is not finite.
    """
    if not records:
        raise ValueError("no record: give at least one pair (u, y)")
    checked = []
    for u, y in records:
        a, b = as_signal(u, "u"), as_signal(y, "y")
        K = max(0, min(len(b), len(a) - s + 1))
        checked.append(Record(a[: K + s - 1], b[:K]))
    shapes = {(r.u.shape[1], r.y.shape[1]) for r in checked}
    if len(shapes) != 1 or 0 in next(iter(shapes)):
        raise ValueError(f"all records need the same (m, p), both at least 1, got {sorted(shapes)}")
    u_scale, y_scale = _rms([r.u for r in checked]), _rms([r.y for r in checked])
    scaled = tuple(Record(r.u / u_scale, r.y / y_scale) for r in checked)
    return Records(records=scaled, u_scale=u_scale, y_scale=y_scale)


def from_factor(factor: ArrayLike, m: int, p: int, columns: int) -> Factor:
    """Checks and scales a time-major factor.

    Args:
        factor: block row i holds u(k+i) over y(k+i), shape ((m+p) depth, c).
        m: inputs.
        p: outputs.
        columns: columns of the Hankel matrix that was compressed.

    Raises:
        ValueError: if the rows are not a multiple of m + p, or a value is not finite.
    """
    F = np.asarray(factor, dtype=np.float64)
    if m < 1 or p < 1 or F.ndim != 2 or F.shape[0] % (m + p) or not F.shape[0]:
        raise ValueError(f"factor must have a multiple of m + p = {m + p} rows, got shape {F.shape}")
    if not np.isfinite(F).all():
        raise ValueError("factor holds values that are not finite")
    blocks = F.reshape(-1, m + p, F.shape[1])
    scale = np.sqrt(np.sum(blocks**2, axis=(0, 2)) / (max(columns, 1) * len(blocks)))
    scale = np.where(scale > 0, scale, 1.0)
    return Factor(F=blocks / scale[:, None], held=columns, u_scale=scale[:m], y_scale=scale[m:])


def _rms(parts: list[Array]) -> Array:
    """Root mean square of each column over all parts, 1 where it is zero; of any size, hence by the peak."""
    peak = np.max([np.abs(w).max(axis=0, initial=0.0) for w in parts], axis=0)
    peak = np.where(peak > 0, peak, 1.0)
    count = max(1, sum(len(w) for w in parts))
    value = np.sqrt(sum(np.sum((w / peak) ** 2, axis=0) for w in parts) / count)
    return np.where(value > 0, peak * value, 1.0)
