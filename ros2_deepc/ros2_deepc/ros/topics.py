# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The topics of a zone, once: nodes, recorder, layouts and documentation read this table.

All names are relative, so that one namespace holds one plant or zone (for example /grid).
"""

from dataclasses import dataclass
from typing import Any

from deepc_msgs.msg import Change, Claim, ControllerState, Indicator, MonitorReport, PlantInfo, Sample
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import Log, ParameterEvent
from rosgraph_msgs.msg import Clock


@dataclass(frozen=True, slots=True)
class Topic:
    """One topic.

    Attributes:
        name: relative to the namespace of the zone.
        type: message class.
        path: who talks to whom.
        latched: a reader that joins late gets the last messages (transient local).
        depth: messages kept for a reader that lags or joins late; in lockstep, samples are all kept.
    """

    name: str
    type: Any
    path: str
    latched: bool = False
    depth: int = 10

    @property
    def type_name(self) -> str:
        """Full name of the message type, e.g. deepc_msgs/msg/Sample."""
        package, _, _ = self.type.__module__.partition(".")
        return f"{package}/msg/{self.type.__name__}"


PLANT_INFO = Topic("plant_info", PlantInfo, "plant -> all", latched=True, depth=1)
OUTPUTS = Topic("outputs", Sample, "plant -> controller, monitor, recorder")
INPUTS = Topic("inputs", Sample, "controller -> plant, monitor, recorder")
REFERENCE = Topic("reference", Sample, "operator -> controller", latched=True, depth=100)  # a whole schedule
DISTURBANCES = Topic("disturbances", Sample, "plant -> controller")
STATE = Topic("controller/state", ControllerState, "controller -> all")
CHANGES = Topic("controller/changes", Change, "controller -> recorder", latched=True, depth=1000)
CLAIM = Topic("claim", Claim, "controller -> plant, controller", latched=True, depth=1)
REPORT = Topic("monitor/report", MonitorReport, "monitor -> all", latched=True)
MONITOR_CHANGES = Topic("monitor/changes", Change, "monitor -> recorder", depth=1000)
INDICATOR = Topic("monitor/indicator", Indicator, "monitor -> all")
DIAGNOSTICS = Topic("/diagnostics", DiagnosticArray, "all -> all")
CLOCK = Topic("/clock", Clock, "plant -> all, in lockstep", depth=1)

ALL = (
    PLANT_INFO,
    OUTPUTS,
    INPUTS,
    REFERENCE,
    DISTURBANCES,
    STATE,
    CHANGES,
    CLAIM,
    REPORT,
    MONITOR_CHANGES,
    INDICATOR,
    DIAGNOSTICS,
    CLOCK,
)

# what every node of ROS publishes by itself: recorded, too
PARAMETER_EVENTS = Topic("/parameter_events", ParameterEvent, "all -> all", depth=1000)
ROSOUT = Topic("/rosout", Log, "all -> all", latched=True, depth=1000)
RECORDED = (*ALL, PARAMETER_EVENTS, ROSOUT)
