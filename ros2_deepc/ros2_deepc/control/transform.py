# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Predictors in other coordinates: the units of the plant, and absolute values from increments."""

from dataclasses import dataclass, replace

import numpy as np

from ros2_deepc.behavior.hankel import Array

from .predictor import Predictor
from .settings import Sized


@dataclass(frozen=True, slots=True)
class Units:
    """Scales of the rows and columns of a predictor.

    Attributes:
        future: of the predicted outputs, shape (p L, 1).
        free: of the planned inputs, shape (m L,).
        known: of what a step knows, shape (size of w,).
    """

    future: Array
    free: Array
    known: Array

    @staticmethod
    def of(u_scale: Array, y_scale: Array, sized: Sized) -> "Units":
        """From the scales of inputs and disturbances (m + disturbances,) and of outputs (p,)."""
        base, m = sized.base, sized.m
        known = (
            np.tile(u_scale[:m], base.N + base.s - 1),
            np.tile(u_scale[m:], sized.rows_u),
            np.tile(y_scale, base.N),
        )
        return Units(np.tile(y_scale, base.L)[:, None], np.tile(u_scale[:m], base.L), np.concatenate(known))


def unscale(predictor: Predictor, units: Units) -> Predictor:
    """The predictor in the units of the channels, from one for channels divided by their scales."""
    return replace(
        predictor,
        G=units.future * predictor.G / units.free,
        F=units.future * predictor.F / units.known,
        noise=units.future * predictor.noise,
        state=units.future * predictor.state,
    )


class Scales:
    """Units in which a program is well scaled: each channel by the power of two nearest its size in the data.

    Powers of two, so that nothing is rounded. Costs are scaled so that the larger of the mean weights is about one.

    Args:
        u_scale: sizes of inputs and disturbances, shape (m + disturbances,).
        y_scale: sizes of outputs, shape (p,).
        sized: settings.
    """

    def __init__(self, u_scale: Array, y_scale: Array, sized: Sized) -> None:
        base, m, p = sized.base, sized.m, sized.p
        u, self.y = _power_of_two(u_scale), _power_of_two(y_scale)
        self.u, d = u[:m], u[m:]
        known = base.past + base.s - 1
        self._w = np.concatenate([np.tile(self.u, known), np.tile(d, known + base.L), np.tile(self.y, base.past)])
        self._future, self._free = np.tile(self.y, base.L), np.tile(self.u, base.L)
        Q, R = self.y[:, None] * sized.Q * self.y, self.u[:, None] * sized.R * self.u
        price = max(float(np.trace(Q)) / p, float(np.trace(R)) / m)
        cost = float(_power_of_two(np.array(price))) if price > 0 else 1.0
        limits = {name: getattr(sized, name) / self.u for name in ("u_min", "u_max", "du_max")}
        limits |= {name: getattr(sized, name) / self.y for name in ("y_min", "y_max")}
        self.sized = replace(sized, Q=Q / cost, R=R / cost, **limits)

    def predictor(self, predictor: Predictor) -> Predictor:
        """The predictor in these units, from one in the units of the plant."""
        return unscale(predictor, Units((1.0 / self._future)[:, None], 1.0 / self._free, 1.0 / self._w))

    def known(self, w: Array) -> Array:
        """What a step knows in these units."""
        return np.asarray(w / self._w)

    def goal(self, r: Array) -> Array:
        """A reference trajectory, (pL,), in these units."""
        return np.asarray(r / self._future)


def _power_of_two(a: Array) -> Array:
    return np.asarray(np.exp2(np.round(np.log2(a))))


def accumulate(predictor: Predictor, sized: Sized) -> Predictor:
    """Absolute predictions from a predictor of increments: offset-free under constant disturbances.

    The increments du(k) = u(k) - u(k-1), dy likewise, follow the same linear dynamics as u and y without any constant.
    With w over N + 1 instead of N past samples, y_f = y(k) + sums of predicted increments.

    Args:
        predictor: of increments, in the units of the channels.
        sized: settings.
    """
    base, m, nd, p = sized.base, sized.m, sized.base.disturbances, sized.p
    N, L, s, rows_u = base.N, base.L, base.s, sized.rows_u
    sums = np.kron(np.tril(np.ones((L, L))), np.eye(p))
    known, all_d = N + s, rows_u + 1  # instants of absolute inputs and disturbances that a step knows
    steps = np.kron(np.eye(L) - np.eye(L, k=-1), np.eye(m))  # plan to increments, but for the first one's reference
    differences = np.zeros((predictor.F.shape[1], m * known + nd * all_d + p * (N + 1)))
    row = column = 0
    for count, width in ((known, m), (all_d, nd), (N + 1, p)):
        block = np.kron(np.eye(count - 1, count, k=1) - np.eye(count - 1, count), np.eye(width))
        differences[row : row + block.shape[0], column : column + block.shape[1]] = block
        row, column = row + block.shape[0], column + block.shape[1]
    F = predictor.F @ differences
    F[:, m * (known - 1) : m * known] -= predictor.G[:, :m]
    F = sums @ F
    F[:, -p:] += np.tile(np.eye(p), (L, 1))
    return replace(
        predictor, G=sums @ predictor.G @ steps, F=F, noise=sums @ predictor.noise, state=sums @ predictor.state
    )
