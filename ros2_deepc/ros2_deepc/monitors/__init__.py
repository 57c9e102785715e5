# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""What the data prove: verdicts with margin, noise level and reason. Pure numpy and scipy."""

from .analysis import analyze, analyze_factor, analyze_records
from .estimate import estimate_structure
from .noise import Noise
from .verdict import Finding, Mode, Printed, Prior, Report, StructureEstimate, Verdict

__all__ = [
    "Finding",
    "Mode",
    "Noise",
    "Printed",
    "Prior",
    "Report",
    "StructureEstimate",
    "Verdict",
    "analyze",
    "analyze_factor",
    "analyze_records",
    "estimate_structure",
]
