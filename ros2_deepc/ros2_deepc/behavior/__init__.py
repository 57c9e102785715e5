# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Data matrices: Hankel matrices, excitation, the online window. Pure numpy and scipy."""

from .excitation import collective_excitation_order, excitation_order, excites, numerical_rank
from .gram import SlidingGram
from .hankel import hankel
from .sliding import SlidingFactor
from .window import DataWindow, Record, data_matrix

__all__ = [
    "DataWindow",
    "Record",
    "SlidingFactor",
    "SlidingGram",
    "collective_excitation_order",
    "data_matrix",
    "excitation_order",
    "excites",
    "hankel",
    "numerical_rank",
]
