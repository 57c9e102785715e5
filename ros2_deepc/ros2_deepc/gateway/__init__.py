# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The gateway: connects a plant behind OPC UA, Modbus/TCP or ROS topics to a zone, by one YAML file, safely.

The core (tag map, guard, states) knows neither ROS nor any protocol; each protocol is one module and one extra.
"""

from .core import Gateway, Outputs
from .errors import GatewayError, LinkError, MissingExtraError
from .guard import Command, Guard, Refusal
from .load import load, loads
from .supervisor import Answer, State
from .tags import TagMap

__all__ = [
    "Answer",
    "Command",
    "Gateway",
    "GatewayError",
    "Guard",
    "LinkError",
    "MissingExtraError",
    "Outputs",
    "Refusal",
    "State",
    "TagMap",
    "load",
    "loads",
]
