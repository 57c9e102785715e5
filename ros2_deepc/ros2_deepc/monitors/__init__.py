# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""What the data prove: verdicts with margin, noise level and reason. Pure numpy and scipy."""

from .analysis import analyze, analyze_factor, analyze_records
from .estimate import estimate_structure
from .increments import increments
from .indicator import Indicator, indicate
from .noise import Noise
from .verdict import Finding, Mode, Printed, Prior, Report, StructureEstimate, Verdict
from .willems import Lengths, Parameterization, Richness, parameterize, required_length, richness

__all__ = [
    "Finding",
    "Indicator",
    "Lengths",
    "Mode",
    "Noise",
    "Parameterization",
    "Printed",
    "Prior",
    "Report",
    "Richness",
    "StructureEstimate",
    "Verdict",
    "analyze",
    "analyze_factor",
    "analyze_records",
    "estimate_structure",
    "increments",
    "indicate",
    "parameterize",
    "required_length",
    "richness",
]
