# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The controller: collects, then controls; publishes inputs and its state."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from deepc_msgs.msg import ControllerState, PlantInfo, Sample

from ..control import DeepcSettings, StepResult
from ..control.agent import Agent, Decision
from ..ros import topics
from ..ros.convert import nanoseconds, period_ns, refusal, sample
from ..ros.diagnostics import OK, WARN, Diagnostics
from ..ros.lifecycle import ManagedNode
from ..ros.parameters import ConfigError, Param
from ..ros.publisher import PatientPublisher
from ..ros.run import run_node

PARAMETERS = (
    Param(
        "N",
        6,
        "past samples that fix the initial condition, at least the lag of the plant",
        "samples",
        low=1,
        high=1000,
    ),
    Param("L", 14, "prediction horizon", "samples", low=1, high=1000),
    Param(
        "T",
        0,
        "inputs in the data window; 0 = the least number that Corollary 1 allows",
        "samples",
        low=0,
        high=1_000_000,
    ),
    Param("Q", [1.0], "output weights, one for all or shape (p,)", "1/output units^2"),
    Param("R", [1.0], "input weights, one for all or shape (m,)", "1/input units^2"),
    Param(
        "u_min", [-math.inf], "lower input limits on top of the plant's own, one for all or shape (m,)", "input units"
    ),
    Param(
        "u_max", [math.inf], "upper input limits on top of the plant's own, one for all or shape (m,)", "input units"
    ),
    Param("terminal", "equilibrium", "what the plan must end in", choices=("none", "equilibrium", "hard", "soft")),
    Param("solver", "osqp", "solver tried first; the other one is the second try", choices=("osqp", "daqp")),
    Param("q", 0, "prior: upper bound of the slow order; 0 = what the plant says", low=0),
    Param("s", 0, "prior: upper bound of the nilpotency index; 0 = what the plant says", low=0),
    Param("seed", 0, "seed of the excitation", low=0),
    Param("readers_inputs", 0, "lockstep only: subscribers of inputs to wait for before the first sample", low=0),
    Param("readers_state", 0, "lockstep only: subscribers of controller/state to wait for", low=0),
)


def settings_for(parameters: Mapping[str, Any], info: PlantInfo) -> DeepcSettings:
    """Settings of the controller for a plant: the parameters, within the plant's limits and with its prior.

    Raises:
        ConfigError: in one line, if they cannot work.
    """
    given = {row.name: row.default for row in PARAMETERS} | dict(parameters)
    try:
        m = len(info.input_names)
        return DeepcSettings(
            **{name: given[name] for name in ("N", "L", "T", "Q", "R", "terminal", "solver")},
            q=given["q"] or int(info.q),
            s=given["s"] or max(int(info.s), 1),
            u_min=np.maximum(info.input_min, np.broadcast_to(given["u_min"], (m,))),
            u_max=np.minimum(info.input_max, np.broadcast_to(given["u_max"], (m,))),
        )
    except ValueError as error:
        raise ConfigError(f"controller: {error}") from None


def make_agent(parameters: Mapping[str, Any], info: PlantInfo) -> Agent:
    """The decisions of one run on a plant; the node and the ROS-free loop make the same one.

    Raises:
        ConfigError: in one line, if the parameters cannot work for this plant.
    """
    settings = settings_for(parameters, info)
    try:
        return Agent(len(info.input_names), len(info.output_names), settings, int(parameters.get("seed", 0)))
    except ValueError as error:
        raise ConfigError(f"controller: {error}") from None


class ControllerNode(ManagedNode):
    """Answers outputs k with inputs k+s, then publishes its state.

    It learns sizes, limits, prior and sample time from plant_info; a new epoch there starts a new run.
    """

    parameters = PARAMETERS

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("controller", **kwargs)
        self.refused = 0

    @classmethod
    def check(cls, parameters: Mapping[str, Any], info: PlantInfo) -> None:
        """Whether the settings can work for the plant."""
        make_agent(parameters, info)

    def configure(self) -> None:
        """Makes the topics that do not depend on the plant."""
        self._agent: Agent | None = None
        self._inputs: PatientPublisher | None = None
        self._state: PatientPublisher | None = None
        self._early: dict[int, Sample] = {}
        self._diagnostics = Diagnostics(self, "")
        self.resources.callback(self._diagnostics.destroy)
        self.subscribe(topics.PLANT_INFO, self._on_plant)
        self.subscribe(topics.REFERENCE, self._on_reference)

    def _on_plant(self, info: PlantInfo) -> None:
        """A plant or a new epoch of it: a fresh run. Its first inputs go out once a reference is known."""
        agent = make_agent(self.p, info)
        if self._inputs is None:
            self._connect(info)
        self._agent, self._info, self._k, self._started = agent, info, -1, False
        self._t0, self._period = nanoseconds(info.header.stamp), period_ns(info.sample_time)
        for k, msg in sorted(self._early.items()):
            self._set_reference(k, msg)
        self._begin()

    def _connect(self, info: PlantInfo) -> None:
        lockstep, Ts = bool(info.lockstep), info.sample_time
        readers = (self.p["readers_inputs"], self.p["readers_state"]) if lockstep else (0, 0)
        self._inputs = self.advertise(topics.INPUTS, lockstep=lockstep, sample_time=Ts, readers=readers[0])
        self._state = self.advertise(topics.STATE, lockstep=lockstep, readers=readers[1])
        self.subscribe(topics.OUTPUTS, self._on_outputs, lockstep=lockstep)

    def _on_reference(self, msg: Sample) -> None:
        if self._agent is None:
            self._early[int(msg.k)] = msg
            return
        self._set_reference(int(msg.k), msg)
        self._begin()

    def _set_reference(self, k: int, msg: Sample) -> None:
        assert self._agent is not None
        reason = refusal(msg, len(self._info.output_names))
        if reason:
            self._refuse(f"reference from {k} on: {reason}")
            return
        self._agent.references.set(k, msg.values)

    def _begin(self) -> None:
        """The inputs that outputs 0 depend on."""
        assert self._agent is not None
        if self._started or self._agent.references.at(0) is None:
            return
        self._started = True
        for k, u in enumerate(self._agent.start()):
            self._send(k, u)

    def _on_outputs(self, msg: Sample) -> None:
        assert self._agent is not None
        reason = refusal(msg, len(self._info.output_names))
        if not reason and msg.epoch != self._info.epoch:
            reason = f"epoch {msg.epoch} instead of {self._info.epoch}"
        if not reason and msg.k <= self._k:
            reason = f"outputs {msg.k} again or too late, {self._k} were the last"
        if reason:
            self._refuse(f"outputs {msg.k}: {reason}")
            return
        self._k = int(msg.k)
        decision = self._agent.step(self._k, msg.values)
        self._send(self._k + self._agent.settings.s, decision.u)
        self._publish_state(msg, decision)
        self._agent.prepare()

    def _send(self, k: int, u: np.ndarray) -> None:
        assert self._inputs is not None
        self._inputs.publish(sample(self._info.name, self._info.epoch, k, u, self._t0 + k * self._period))

    def _refuse(self, reason: str) -> None:
        self.refused += 1
        self.get_logger().warning(f"refused {reason}", throttle_duration_sec=5.0)

    def _publish_state(self, outputs: Sample, decision: Decision) -> None:
        assert self._agent is not None
        assert self._state is not None
        msg = state_message(self._agent, decision)
        msg.header = outputs.header
        msg.epoch, msg.refused = outputs.epoch, self.refused
        self._state.publish(msg)
        level = WARN if msg.status in (msg.STATUS_SHIFTED_PLAN, msg.STATUS_FALLBACK) else OK
        self._diagnostics.report(level, decision.mode.name, {"reason": decision.reason, "failures": msg.failures})


def state_message(agent: Agent, decision: Decision) -> ControllerState:
    """A decision as a message, without its header."""
    c = agent.controller
    msg = ControllerState(k=decision.k, mode=int(decision.mode), reason=decision.reason, failures=agent.failures)
    msg.reference = [] if decision.reference is None else decision.reference.tolist()
    msg.input = decision.u.tolist()
    msg.window, msg.rank, msg.rank_need = c.window_length, c.rank, c.rank_need
    msg.gap, msg.excitation, msg.excitation_need = float(c.gap), c.excitation_order, c.excitation_need
    msg.distance = msg.cost = math.nan
    if decision.result is not None:
        _fill(msg, decision.result)
    return msg


def _fill(msg: ControllerState, result: StepResult) -> None:
    """What the optimisation adds."""
    msg.status = int(result.status) + 1
    msg.limited, msg.solver, msg.iterations = bool(result.limited), result.solver, int(result.iterations)
    msg.input_plan, msg.output_plan = result.u_plan.ravel().tolist(), result.y_plan.ravel().tolist()
    if np.isfinite(result.y_steady).all():
        msg.steady_input, msg.steady_output = result.u_steady.tolist(), result.y_steady.tolist()
    msg.distance, msg.cost = float(result.distance), float(result.cost)
    msg.slack = float(max(np.max(result.slack, initial=0.0), np.max(np.nan_to_num(result.violation), initial=0.0)))
    msg.prepare_time, msg.solve_time = float(result.prepare_time), float(result.solve_time)


def main() -> int:
    """Console script: runs the controller node."""
    return run_node(ControllerNode)


if __name__ == "__main__":
    raise SystemExit(main())
