# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Plants: descriptor systems, their canonical form, and the networks."""

from .descriptor import DescriptorSystem
from .errors import InconsistentStateError, NotRegularError, PlantError, ShapeError, UnclearStructureError
from .plant import Plant, StructurePrior
from .power import wscc9
from .water import net3

__all__ = [
    "DescriptorSystem",
    "InconsistentStateError",
    "NotRegularError",
    "Plant",
    "PlantError",
    "ShapeError",
    "StructurePrior",
    "UnclearStructureError",
    "net3",
    "wscc9",
]
