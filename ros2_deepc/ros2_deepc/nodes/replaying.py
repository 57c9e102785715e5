# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The nodes' decisions as parts that a replay can feed, made from the parameters of the run."""

import json
from collections.abc import Callable, Mapping
from typing import Any

from ..bags.cores import ControllerCore, MonitorCore
from ..monitors.live import LiveMonitor
from .changes import Changes
from .controller_settings import make_agent
from .controller_state import state_message
from .monitor_node import PARAMETERS_CHANGED, change_live, make_live, report_message


def cores(parameters: Mapping[str, Mapping[str, Any]]) -> dict[str, Callable[[Any], Any]]:
    """A factory for each part, from the recorded PlantInfo, as `bags.replay` takes them.

    Args:
        parameters: by role, those with which the run began.
    """
    commanded, watched = dict(parameters["controller"]), dict(parameters.get("monitor", {}))  # changes outlast a run

    def controller(info: Any) -> ControllerCore:
        return ControllerCore(make_agent(commanded, info), state_message, Changes(commanded, info).apply)

    def monitor(info: Any) -> MonitorCore:
        def change(live: LiveMonitor, k: int, name: str, value: str) -> None:
            if name == PARAMETERS_CHANGED:
                watched.update(json.loads(value))
                change_live(live, k, watched, info)

        return MonitorCore(make_live(watched, info), report_message, change)

    return {"controller": controller, "monitor": monitor}
