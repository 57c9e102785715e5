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
_ROUNDING = (
    8 * np.finfo(np.float64).eps
)  # of a difference over the larger value, taken to be none: both values are rounded


def increments(records: Sequence[tuple[ArrayLike, ArrayLike]], noise: Noise) -> tuple[list[tuple[Array, Array]], Noise]:
    """Records of du(k) = u(k+1) - u(k), dy(k) = y(k+1) - y(k), and what is known of the noise on dy.

    With E x(k+1) = A x(k) + B u(k) + f and y(k) = C x(k) + D u(k) + g, constant f and g of any size, the increments
    satisfy the same equations with f = g = 0: what the tests prove of them holds for (E, A, B, C, D). A constant that
    the inputs do not reach (an uncontrollable mode at 1) has no increments. It is then a direction never excited, and
    the prior q, which counts it, keeps the tests from proving anything.

    Noise v(k+1) - v(k) is no longer white, but its Hankel matrix is a difference of two of white noise: at most twice
    their bound. What is noise-free still has the rounding of the values that were subtracted; changes within it are
    taken to be none.

    Args:
        records: pairs (u, y), shapes (K+s-1 or more, m) and (K, p).
        noise: on y.

    Returns:
        The records, one sample shorter each, and the noise on them.

    Raises:
        ValueError: wrong shapes, noise for another number of outputs, or noise to be estimated.
    """
    pairs = [(as_signal(u, "u"), as_signal(y, "y")) for u, y in records]
    peak = np.max([np.abs(y).max(axis=0, initial=0.0) for _, y in pairs], axis=0)
    return [(np.diff(u, axis=0), change(y[:-1], y[1:])) for u, y in pairs], noise_of_changes(noise, peak)


def change(before: Array, after: Array) -> Array:
    """The increments of outputs, 0 where they are no more than rounding; both shape (..., p)."""
    difference = after - before
    return np.where(np.abs(difference) > _ROUNDING * np.maximum(np.abs(after), np.abs(before)), difference, 0.0)


def noise_of_changes(noise: Noise, peak: Array) -> Noise:
    """The noise on increments of outputs that are no larger than ``peak``, shape (p,).

    Raises:
        ValueError: if it is given for another number of outputs, or to be estimated.
    """
    require_level(noise)
    level = 2.0 * noise.per_output(np.ones(len(peak))) + _ROUNDING * peak
    white = noise.bound is None and noise.source == "given"
    return Noise(std=level) if white else Noise(bound=level)


def require_level(noise: Noise) -> None:
    """Raises ValueError if the noise is to be estimated."""
    if noise.estimated:
        raise ValueError("noise on increments is not white and cannot be estimated from them: give its level")
