# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Where the rows of a data matrix belong: known inputs, planned inputs, disturbances, past and future outputs."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .settings import Sized

Index = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Layout:
    """Row groups, in the order in which a predictor works through them.

    The data matrix covers rows_u instants of inputs and disturbances and rows_y = N + L instants of outputs. A step
    knows w = [known inputs (past and committed); disturbances (past, and forecast); past outputs].

    Attributes:
        known_u: scalar rows of known inputs.
        free_u: scalar rows of planned inputs.
        context: scalar rows of disturbances and past outputs, what the free response depends on besides known inputs.
        future_y: scalar rows of predicted outputs.
        stacked: order of the rows of [H(u, d); H(y)] that brings the groups one after the other.
        timed: likewise for time-major rows [u; d; y](0), [u; d; y](1), ...
        causal: order of the grouped rows in which every future instant comes as a whole: inputs, then the outputs that
            they complete.
    """

    known_u: int
    free_u: int
    context: int
    future_y: int
    stacked: Index
    timed: Index
    causal: Index

    @property
    def inputs(self) -> int:
        """Scalar rows of inputs."""
        return self.known_u + self.free_u

    @property
    def past(self) -> int:
        """Scalar rows of what a step knows."""
        return self.known_u + self.context


def lay_out(sized: Sized) -> Layout:
    """The layout for given settings."""
    base, m, nd, p = sized.base, sized.m, sized.base.disturbances, sized.p
    N, L, s, rows_u = base.N, base.L, base.s, sized.rows_u

    def rows(width: int, start: int, instants: range, channels: range, offset: int = 0) -> Index:
        return np.array([offset + start + b * width + c for b in instants for c in channels], dtype=np.intp)

    def grouped(u_width: int, y_width: int, y_offset: int) -> Index:
        return np.concatenate(
            [
                rows(u_width, 0, range(rows_u), range(m)),
                rows(u_width, m, range(rows_u), range(nd)),
                rows(y_width, 0, range(N + L), range(p), y_offset),
            ]
        )

    wide = m + nd
    known, free, context, future = m * (N + s - 1), m * L, nd * rows_u + p * N, p * L
    first_y = known + free + context
    causal = [np.arange(known), np.arange(known + free, first_y)]
    for k in range(L):
        causal.append(np.arange(known + k * m, known + (k + 1) * m))
        causal.append(np.arange(first_y + k * p, first_y + (k + 1) * p))
    return Layout(
        known_u=known,
        free_u=free,
        context=context,
        future_y=future,
        stacked=grouped(wide, p, wide * rows_u),
        timed=grouped(wide + p, wide + p, wide),
        causal=np.concatenate(causal),
    )
