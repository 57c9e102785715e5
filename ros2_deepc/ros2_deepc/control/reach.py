# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Which outputs cannot be held because of modes that the inputs do not reach."""

from collections.abc import Iterable

import numpy as np

from ros2_deepc.behavior.hankel import Array

from .predictor import Predictor
from .settings import Sized

NEAR = 0.05  # a mode of the data this near to one reported is that one
TOUCHED = 1e-2  # an output takes part in a mode with more than this share of the output that takes part most
LASTING = 1e-3  # modes inside the unit circle by more than this decay by themselves
ROUNDING = 1e-6  # of the outputs' size: moves below it are rounding
DOUBT = 3.0  # standard deviations of what noise makes of an output that the inputs do not move


def unholdable(predictor: Predictor, modes: Iterable[complex], sized: Sized, scale: tuple[Array, Array]) -> Array:
    """Outputs that no steady state can hold, given modes that the inputs do not reach.

    A mode inside the unit circle decays and hinders nothing. Any other one that shows in an output leaves it without a
    steady state, but for lambda = 1: that one is a constant, which inputs can make up for wherever they move the output
    at all.

    Args:
        predictor: in the units of the channels.
        modes: uncontrollable modes, as the monitors report them.
        sized: settings.
        scale: root mean square of inputs and disturbances, (m + disturbances,), and of outputs, (p,), in the data.

    Returns:
        Shape (p,), booleans.
    """
    lasting = [mode for mode in modes if abs(mode) >= 1 - LASTING]
    held_back = np.zeros(sized.p, dtype=bool)
    if not lasting:
        return held_back
    still = np.logical_not(moved(predictor, sized, scale[0][: sized.m], scale[1]))
    seen, shares = _shapes(predictor, sized, scale[1])
    for mode in lasting:
        away = np.abs(seen - mode)
        same = (away < NEAR) & (away <= max(LASTING, 2 * away.min(initial=np.inf)))
        touched = (shares[same] > TOUCHED).any(axis=0)
        held_back |= touched & still if abs(mode - 1) < LASTING else touched
    return held_back


def moved(predictor: Predictor, sized: Sized, u_scale: Array, y_scale: Array) -> Array:
    """Outputs that inputs like those in the data move by more than noise and rounding feign, booleans, shape (p,)."""
    p, columns = sized.p, sized.T - sized.rows_u + 1
    per_step = np.linalg.norm(predictor.G * np.tile(u_scale, sized.base.L), axis=1).reshape(-1, p)
    feigned = DOUBT * sized.noise * np.sqrt(predictor.G.shape[1] / columns)
    return np.asarray(per_step.max(axis=0) > feigned + ROUNDING * y_scale)


def _shapes(predictor: Predictor, sized: Sized, y_scale: Array) -> tuple[Array, Array]:
    """Modes of the free response, shape (i,), and the share that each scaled output takes in them, at most 1, (i, p).

    The free response to past outputs spans the range of [C; C A; ...], which moves on by A from one step to the next.
    """
    p = sized.p
    response = predictor.F[:, -p * sized.base.past :] * np.tile(y_scale, sized.base.past)
    U, sv, _ = np.linalg.svd(response / np.tile(y_scale, sized.base.L)[:, None], full_matrices=False)
    order = min(int(np.count_nonzero(sv > ROUNDING * sv[0])), response.shape[0] - p)
    A = np.linalg.lstsq(U[:-p, :order], U[p:, :order], rcond=None)[0]
    modes, vectors = np.linalg.eig(A)
    shares = np.abs(U[:p, :order] @ vectors)
    return modes, (shares / np.maximum(shares.max(axis=0), ROUNDING)).T
