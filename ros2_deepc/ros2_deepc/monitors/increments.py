# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Changes from sample to sample: for plants that move around an operating point nobody knows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from ros2_deepc.behavior.hankel import as_signal

from .compress import Array
from .noise import Noise

Form = Literal["absolute", "incremental"]
_ROUNDING = 8 * np.finfo(np.float64).eps  # of a difference, relative to the larger value: both are rounded


def increments(records: Sequence[tuple[ArrayLike, ArrayLike]], noise: Noise) -> tuple[list[tuple[Array, Array]], Noise]:
    """Records of du(k) = u(k+1) - u(k), dy(k) = y(k+1) - y(k), and what is known of the noise on dy.

    With E x(k+1) = A x(k) + B u(k) + f and y(k) = C x(k) + D u(k) + g, constant f and g of any size, the increments
    satisfy the same equations with f = g = 0: what the tests prove of them holds for (E, A, B, C, D). A constant that
    the inputs do not reach (an uncontrollable mode at 1) has no increments. It is then a direction never excited, and
    the prior q, which counts it, keeps the tests from proving anything.

    Noise v(k+1) - v(k) is no longer white, but its Hankel matrix is a difference of two of white noise: at most twice
    their bound. What is noise-free still has the rounding of the values that were subtracted. An output that changes
    by no more than that is taken to be constant.

    Args:
        records: pairs (u, y), shapes (K+s-1 or more, m) and (K, p); those with fewer than two outputs are left out.
        noise: on y.

    Returns:
        The records, one sample shorter each, and the noise on them.

    Raises:
        ValueError: wrong shapes, noise for another number of outputs, noise to be estimated, or no two outputs.
    """
    if noise.estimated:
        raise ValueError("noise on increments is not white and cannot be estimated from them: give its level")
    pairs = [(as_signal(u, "u"), as_signal(y, "y")) for u, y in records if len(np.asarray(y)) > 1]
    if not pairs:
        raise ValueError("increments need a record with at least two outputs")
    rounding = _ROUNDING * np.max([np.abs(y).max(axis=0) for _, y in pairs], axis=0)
    changes = [(np.diff(u, axis=0), np.diff(y, axis=0)) for u, y in pairs]
    moves = np.max([np.abs(dy).max(axis=0) for _, dy in changes], axis=0) > rounding
    level = 2.0 * noise.per_output(np.ones(len(rounding))) + rounding
    white = noise.bound is None and noise.source == "given"
    return [(du, dy * moves) for du, dy in changes], Noise(std=level) if white else Noise(bound=level)
