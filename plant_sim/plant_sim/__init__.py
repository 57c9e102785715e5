# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Plants: descriptor systems, their canonical form, and the networks."""

from .describe import describe
from .descriptor import DescriptorSystem
from .errors import InconsistentStateError, NotRegularError, PlantError, ShapeError, UnclearStructureError
from .plant import Plant, StructurePrior
from .power import wscc9
from .random_systems import Planted, random_system
from .water import net3

__all__ = [
    "DescriptorSystem",
    "InconsistentStateError",
    "NotRegularError",
    "Plant",
    "PlantError",
    "Planted",
    "ShapeError",
    "StructurePrior",
    "UnclearStructureError",
    "describe",
    "net3",
    "random_system",
    "wscc9",
]
