# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""DeePC: predictor, condensed quadratic program, controller. Pure: no ROS."""

from .controller import DeepcController
from .excitation import Excitation
from .result import NotReadyError, Status, StepResult
from .settings import DeepcSettings
from .tune import Trial, Tuning, tune

__all__ = [
    "DeepcController",
    "DeepcSettings",
    "Excitation",
    "NotReadyError",
    "Status",
    "StepResult",
    "Trial",
    "Tuning",
    "tune",
]
