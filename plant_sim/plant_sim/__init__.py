# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Plants: descriptor systems, their canonical form, and the networks."""

from .describe import describe
from .descriptor import DescriptorSystem
from .epanet_plant import epanet_from_inp, net3_epanet
from .errors import InconsistentStateError, NotRegularError, PlantError, ShapeError, UnclearStructureError
from .plant import Plant, StructurePrior
from .power import wscc9
from .random_systems import Planted, random_system
from .swing_plant import swing_from_case, wscc9_swing
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
    "epanet_from_inp",
    "net3",
    "net3_epanet",
    "random_system",
    "swing_from_case",
    "wscc9",
    "wscc9_swing",
]
