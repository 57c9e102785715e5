# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""What can be wrong with a plant. All are ValueErrors with a one-line message."""


class PlantError(ValueError):
    """Root of the errors of this package."""


class ShapeError(PlantError):
    """A matrix or signal has the wrong shape, or holds a NaN or an infinity."""


class NotRegularError(PlantError):
    """det(zE - A) vanishes for every z: the equations do not determine the state."""


class UnclearStructureError(PlantError):
    """Rounding hides a rank that the canonical form depends on."""


class InconsistentStateError(PlantError):
    """A given x(0) contradicts the algebraic equations."""
