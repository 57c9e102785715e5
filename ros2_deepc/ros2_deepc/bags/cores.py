# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The controller and the monitors as parts that a replay can feed."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ros2_deepc.control.agent import Agent, Decision
from ros2_deepc.monitors.live import Job, LiveMonitor, LiveReport

from .replay import Answer

Array = NDArray[np.float64]


class ControllerCore:
    """The controller's decisions.

    Args:
        agent: a fresh one, made as the controller node makes it.
        message: turns a decision into an object with the fields of ControllerState.
    """

    def __init__(self, agent: Agent, message: Callable[[Agent, Decision], Any]) -> None:
        self._agent, self._message = agent, message
        self._started = False

    def reference(self, k: int, values: Array) -> list[Answer]:
        """Takes a reference; the first one that holds at 0 starts the run."""
        self._agent.references.set(k, values)
        if self._started or self._agent.references.at(0) is None:
            return []
        self._started = True
        return [_inputs(i, u) for i, u in enumerate(self._agent.start())]

    def inputs(self, k: int, values: Array) -> list[Answer]:  # noqa: ARG002 - the controller knows its own inputs
        """Nothing: the inputs are what is to be found."""
        return []

    def outputs(self, k: int, values: Array, held: int) -> list[Answer]:
        """Decides as the node did. What never crossed the topics, such as a request for a mode, it cannot know."""
        if not self._started:
            return []
        decision = self._agent.step(k, values, held)
        state = self._message(self._agent, decision)
        self._agent.prepare()
        inputs = [] if decision.u is None else [_inputs(k + self._agent.settings.s, decision.u)]
        return [*inputs, ("controller/state", k, state)]


class MonitorCore:
    """The monitors' reports.

    Args:
        live: a fresh one, made as the monitor node makes it.
        message: turns a report into an object with the fields of MonitorReport.
    """

    def __init__(self, live: LiveMonitor, message: Callable[[LiveReport], Any]) -> None:
        self._live, self._message = live, message

    def reference(self, k: int, values: Array) -> list[Answer]:  # noqa: ARG002
        """Nothing: the monitors do not know references."""
        return []

    def inputs(self, k: int, values: Array) -> list[Answer]:
        """Takes inputs k."""
        return self._answers(self._live.input(k, values))

    def outputs(self, k: int, values: Array, held: int) -> list[Answer]:
        """Takes outputs k."""
        return self._answers(self._live.output(k, values, held))

    def _answers(self, jobs: list[Job]) -> list[Answer]:
        return [("monitor/report", job.k, self._message(self._live.analyse(job))) for job in jobs]


def _inputs(k: int, u: Array) -> Answer:
    return ("inputs", k, SimpleNamespace(k=k, values=u))
