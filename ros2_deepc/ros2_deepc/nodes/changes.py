# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""What enters a controller besides samples and references, applied alike by the node and by a replay of its bag."""

import json
from collections.abc import Iterable, Mapping
from typing import Any

from deepc_msgs.msg import PlantInfo

from ..control.agent import Agent, Array
from ..control.settings import LIVE
from .controller_settings import settings_for

REFERENCE = "reference"
"""A reference was taken."""
MODE = "mode"
"""An operator asked for a mode."""
PARAMETERS = "parameters"
"""Parameters changed, those that may change while running."""
MODES = "modes"
"""A monitor reported the modes that the inputs do not reach."""
CUT = "cut"
"""The next sample does not follow the last one."""
OVERDUE = "overdue"
"""Outputs did not come in time."""
LEAVE = "leave"
"""The controller was stopped."""


def change_parameters(agent: Agent, parameters: dict[str, Any], info: PlantInfo, changes: Mapping[str, Any]) -> None:
    """Takes parameters that may change while running.

    Raises:
        ConfigError: if they do not fit.
    """
    parameters |= changes
    settings = settings_for(parameters, info)
    agent.tune(**{name: getattr(settings, name) for name in changes if name in LIVE})


def pairs(modes: Iterable[complex]) -> list[list[float]]:
    """Modes as they stand in a change: real and imaginary parts."""
    return [[mode.real, mode.imag] for mode in modes]


class Changes:
    """Repeats recorded changes on an agent.

    Args:
        parameters: of the controller when the run began; changes go into them.
        info: of the plant.
    """

    def __init__(self, parameters: dict[str, Any], info: PlantInfo) -> None:
        self._parameters, self._info = parameters, info

    def apply(self, agent: Agent, k: int, name: str, text: str) -> list[tuple[int, Array]]:
        """Applies one change before outputs k; returns the inputs that come of it, with their index."""
        value = json.loads(text)
        if name == MODE:
            agent.request(value)
        elif name == PARAMETERS:
            change_parameters(agent, self._parameters, self._info, value)
        elif name == MODES:
            agent.blame(k, [complex(*pair) for pair in value])
        elif name == CUT:
            agent.cut()
        elif name == OVERDUE:
            u = agent.overdue(value).u
            return [] if u is None else [(value + agent.settings.s, u)]
        elif name == LEAVE:
            last = agent.leave(value)
            return [] if last is None else [last]
        return []
