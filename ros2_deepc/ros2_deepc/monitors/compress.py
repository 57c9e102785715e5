# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The LQ factor of a data window: all that the tests need, whatever the length of the record."""

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla
from numpy.typing import NDArray

Array = NDArray[np.float64]

EPS = float(np.finfo(np.float64).eps)
EXCITATION_RCOND = 100 * EPS
"""Inputs whose triangular factor is closer to singular than this do not count as persistently exciting."""


@dataclass(frozen=True, slots=True)
class Compression:
    """Factor [R11 0; R21 R22] of [H_d(u); H_{L+1}(y)], orthogonal columns removed.

    Attributes:
        R11: inputs, lower triangular, shape (m d, m d).
        R21: what the outputs share with the inputs, shape (p (L+1), m d).
        R22: what they do not share, shape (p (L+1), k).
        m: inputs.
        p: outputs.
        L: output block rows of the pencils, one less than in the window.
        columns: columns of the data matrix.
        norm: bound of the spectral norm of the data matrix.
    """

    R11: Array
    R21: Array
    R22: Array
    m: int
    p: int
    L: int
    columns: int
    norm: float

    @property
    def d(self) -> int:
        """Input block rows of the window."""
        return int(self.R11.shape[0]) // self.m

    @property
    def floor(self) -> float:
        """Backward-error bound of the factorisation: singular values below it are rounding."""
        return 10 * EPS * float(np.sqrt(self.R11.shape[0] + self.R21.shape[0])) * self.norm

    def inverse(self) -> Array | None:
        """R11^-1, or None when the inputs are not persistently exciting of order d."""
        inverse, info = sla.lapack.dtrtri(self.R11, lower=1)
        if info or np.linalg.norm(inverse) * np.linalg.norm(self.R11) * EXCITATION_RCOND >= 1:
            return None
        return np.asarray(inverse)


def compress(Wu: Array, Wy: Array, m: int, p: int, columns: int) -> Compression:
    """Compresses a data matrix [Wu; Wy] with block rows in time order.

    Args:
        Wu: input block rows, shape (m d, c).
        Wy: output block rows, shape (p (L+1), c).
        m: inputs.
        p: outputs.
        columns: columns of the data before any earlier compression (for noise bounds), usually c.

    Raises:
        ValueError: if there are fewer columns than input rows.
    """
    a = Wu.shape[0]
    if Wu.shape[1] < a:
        raise ValueError(f"{Wu.shape[1]} columns cannot excite {a} input rows: record longer or take a smaller L")
    R = np.asarray(np.linalg.qr(np.vstack([Wu, Wy]).T, mode="r")).T
    norm = min(float(np.linalg.norm(R)), float(np.sqrt(np.linalg.norm(R, 1) * np.linalg.norm(R, np.inf))))
    return Compression(R[:a, :a], R[a:, :a], R[a:, a:], m, p, Wy.shape[0] // p - 1, columns, norm)
