# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The controller and the monitors as parts that a replay can feed."""

import json
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ros2_deepc.control.agent import Agent, Decision
from ros2_deepc.control.joined import Joined
from ros2_deepc.control.modes import Mode
from ros2_deepc.monitors.live import Job, LiveMonitor, LiveReport

from .replay import Answer

Array = NDArray[np.float64]


class ControllerCore:
    """The controller's decisions.

    Args:
        agent: a fresh one, made as the controller node makes it.
        message: turns a decision into an object with the fields of ControllerState.
        change: applies a recorded change to the agent and returns the inputs that come of it, by index; None: changes
            are not known.
    """

    def __init__(
        self,
        agent: Agent,
        message: Callable[[Agent, Decision], Any],
        change: Callable[[Agent, int, str, str], list[tuple[int, Array]]] | None = None,
    ) -> None:
        self._agent, self._message, self._change = agent, message, change
        self._joined: Joined[tuple[Array, int]] = Joined(agent.disturbances, agent.settings.disturbances > 0)
        self._started = False

    def reference(self, k: int, values: Array) -> list[Answer]:
        """Takes a reference; the first one that holds at 0 starts the run."""
        self._agent.references.set(k, values)
        if self._started or self.listens or self._agent.references.at(0) is None:
            return []
        self._started = True
        return [_inputs(i, u) for i, u in enumerate(self._agent.start())]

    @property
    def listens(self) -> bool:
        """In SHADOW the inputs are those of whoever is in control."""
        return self._agent.mode is Mode.SHADOW

    def inputs(self, k: int, values: Array) -> list[Answer]:
        """Takes the inputs of somebody else; its own are what is to be found."""
        if self.listens:
            self._agent.overhear(k, values)
        return []

    def outputs(self, k: int, values: Array, held: int) -> list[Answer]:
        """Decides as the node did, once the disturbances of the sample are there, too."""
        return self._answers(self._joined.outputs(k, (values, held)))

    def disturbances(self, k: int, values: Array) -> list[Answer]:
        """Takes measured disturbances and their forecast."""
        self._agent.disturbances.set(k, np.reshape(values, (-1, self._agent.settings.disturbances)))
        return self._answers(self._joined.told())

    def change(self, k: int, name: str, value: str) -> list[Answer]:
        """Takes what an operator or the clock did, and references when the controller did."""
        if name == "reference":
            return self.reference(*json.loads(value))
        if self._change is None:
            return []
        return [_inputs(i, u) for i, u in self._change(self._agent, k, name, value)]

    def _answers(self, ready: list[tuple[int, tuple[Array, int]]]) -> list[Answer]:
        return [answer for k, (values, held) in ready for answer in self._answer(k, values, held)]

    def _answer(self, k: int, values: Array, held: int) -> list[Answer]:
        if not (self._started or self.listens):
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
        change: applies a recorded change to the monitor; None: changes are not known.
    """

    def __init__(
        self,
        live: LiveMonitor,
        message: Callable[[LiveReport], Any],
        change: Callable[[LiveMonitor, int, str, str], None] | None = None,
    ) -> None:
        self._live, self._message, self._change = live, message, change

    @property
    def listens(self) -> bool:
        """The monitor commands nothing, and compares none of the inputs."""
        return False

    def reference(self, k: int, values: Array) -> list[Answer]:  # noqa: ARG002
        """Nothing: the monitors do not know references."""
        return []

    def inputs(self, k: int, values: Array) -> list[Answer]:
        """Takes inputs k."""
        return self._answers(self._live.input(k, values))

    def outputs(self, k: int, values: Array, held: int) -> list[Answer]:
        """Takes outputs k."""
        return self._answers(self._live.output(k, values, held))

    def disturbances(self, k: int, values: Array) -> list[Answer]:  # noqa: ARG002
        """Nothing: the monitors do not know disturbances."""
        return []

    def change(self, k: int, name: str, value: str) -> list[Answer]:
        """Takes parameters that changed while it ran."""
        if self._change is not None:
            self._change(self._live, k, name, value)
        return []

    def _answers(self, jobs: list[Job]) -> list[Answer]:
        return [("monitor/report", job.k, self._message(self._live.analyse(job))) for job in jobs]


def _inputs(k: int, u: Array) -> Answer:
    return ("inputs", k, SimpleNamespace(k=k, values=u))
