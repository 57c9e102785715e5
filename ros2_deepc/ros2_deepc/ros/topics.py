# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The topics of a zone, once: nodes, recorder, layouts and documentation read this table.

All names are relative, so that one namespace holds one plant or zone (for example /grid).
"""

from dataclasses import dataclass
from typing import Any

from deepc_msgs.msg import ControllerState, MonitorReport, PlantInfo, Sample
from diagnostic_msgs.msg import DiagnosticArray
from rosgraph_msgs.msg import Clock


@dataclass(frozen=True, slots=True)
class Topic:
    """One topic: its name, message type, whether it is latched (transient local, depth 1), who talks to whom."""

    name: str
    type: Any
    latched: bool
    path: str

    @property
    def type_name(self) -> str:
        """Full name of the message type, e.g. deepc_msgs/msg/Sample."""
        package, _, _ = self.type.__module__.partition(".")
        return f"{package}/msg/{self.type.__name__}"


PLANT_INFO = Topic("plant_info", PlantInfo, True, "plant -> all")
OUTPUTS = Topic("outputs", Sample, False, "plant -> controller, monitor, recorder")
INPUTS = Topic("inputs", Sample, False, "controller -> plant, monitor, recorder")
REFERENCE = Topic("reference", Sample, True, "operator -> controller")
STATE = Topic("controller/state", ControllerState, False, "controller -> all")
REPORT = Topic("monitor/report", MonitorReport, True, "monitor -> all")
DIAGNOSTICS = Topic("/diagnostics", DiagnosticArray, False, "all -> all")
CLOCK = Topic("/clock", Clock, False, "plant -> all, in lockstep")

ALL = (PLANT_INFO, OUTPUTS, INPUTS, REFERENCE, STATE, REPORT, DIAGNOSTICS, CLOCK)
