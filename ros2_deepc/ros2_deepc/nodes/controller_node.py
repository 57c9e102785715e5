# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The controller: collects, then controls; publishes inputs and its state."""

import math
from collections.abc import Mapping
from dataclasses import fields
from typing import Any, get_args

import numpy as np
from deepc_msgs.msg import ControllerState, PlantInfo, Sample
from deepc_msgs.srv import SetMode
from rcl_interfaces.msg import SetParametersResult
from std_srvs.srv import Trigger

from ..control import DeepcSettings, StepResult
from ..control.agent import Agent, Decision
from ..control.excitation import Signal
from ..control.modes import FallbackPolicy, Mode, Safety
from ..control.settings import (
    LIVE,
    Cut,
    DataPolicy,
    Form,
    NoiseBlock,
    Regression,
    Solver,
    Terminal,
)
from ..control.watch import Bounds
from ..ros import topics
from ..ros.convert import nanoseconds, period_ns, refusal, sample
from ..ros.diagnostics import ERROR, OK, WARN, Diagnostics
from ..ros.lifecycle import ManagedNode
from ..ros.parameters import ConfigError, Param
from ..ros.publisher import PatientPublisher
from ..ros.run import run_node


def _row(name: str, default: Any, description: str, unit: str = "", **bounds: Any) -> Param:
    return Param(name, default, description, unit, live=name in LIVE, **bounds)


PARAMETERS = (
    _row(
        "N",
        6,
        "past samples that fix the initial condition, at least the plant's lag",
        "samples",
        low=1,
        high=1000,
    ),
    _row("L", 14, "prediction horizon", "samples", low=1, high=1000),
    _row(
        "T",
        0,
        "inputs in the data window; 0 = the least that Corollary 1 allows",
        "samples",
        low=0,
        high=1_000_000,
    ),
    _row("q", 0, "prior: upper bound of the slow order; 0 = what the plant says", low=0, high=1000),
    _row("s", 0, "prior: upper bound of the nilpotency index; 0 = what the plant says", low=0, high=100),
    _row("Q", [1.0], "output weights, one for all or shape (p,)", "1/output units^2", low=0.0),
    _row("R", [1.0], "input weights, one for all or shape (m,)", "1/input units^2", low=0.0),
    _row("u_min", [-math.inf], "lower input limits within the plant's own, one for all or shape (m,)", "input units"),
    _row("u_max", [math.inf], "upper input limits within the plant's own, one for all or shape (m,)", "input units"),
    _row("du_max", [math.inf], "largest change of an input per sample, one for all or shape (m,)", "input units"),
    _row("y_min", [-math.inf], "lower output limits of the plan, kept with a reported slack", "output units"),
    _row("y_max", [math.inf], "upper output limits of the plan, kept with a reported slack", "output units"),
    _row("mask", [1.0], "weight of each output in [0, 1]; 0 = not chased", low=0.0, high=1.0),
    _row("terminal", "equilibrium", "what the plan must end in", choices=get_args(Terminal)),
    _row("terminal_steps", 0, "samples at the end for which it holds; 0 = N", "samples", low=0, high=1000),
    _row("terminal_weight", 1e4, "price of violating it, relative to Q", low=0.0),
    _row("offset_weight", 1000.0, "price of the steady state's distance from the reference, relative to Q", low=0.0),
    _row("slack_weight", 1000.0, "price of violating an output limit, relative to Q", low=0.0),
    _row("solver", "osqp", "solver tried first; the other one is the second try", choices=get_args(Solver)),
    _row("form", "absolute", "what is predicted: outputs, or their changes (offset-free)", choices=get_args(Form)),
    _row("data_policy", "fixed", "which samples are the data", choices=get_args(DataPolicy)),
    _row("guard", 0.1, "guarded: least strength of a new window, relative to the first", low=1e-6, high=1.0),
    _row(
        "dither",
        [0.0],
        "white noise that keeps a moving window rich, one for all or shape (m,)",
        "input units",
        low=0.0,
    ),
    _row("noise", [0.0], "standard deviation of the output noise, one for all or shape (p,)", "output units", low=0.0),
    _row("cut", "order", "which directions of the free response are kept", choices=get_args(Cut)),
    _row(
        "predictor",
        "joint",
        "regression; causal is unbiased on closed-loop data",
        choices=get_args(Regression),
    ),
    _row("noise_block", "off", "what noise adds to the behaviour", choices=get_args(NoiseBlock)),
    _row("regularization", 100.0, "price of the noise block, relative to unit covariance", low=0.0),
    _row("initial_slack", math.inf, "price of moving the initial condition; inf = never", low=0.0, high=math.inf),
    _row("u_safe", [0.0], "safe input, one for all or shape (m,)", "input units"),
    _row("max_gap", 5, "longest run of lost samples that is bridged by holding", "samples", low=0, high=10_000),
    _row("max_hold", 100, "longest time in HOLDING", "samples", low=1, high=100_000),
    _row("max_failures", 5, "unsolved optimisations in a row before the fallback", "samples", low=1, high=10_000),
    _row("fallback_policy", "hold", "what the fallback does", choices=get_args(FallbackPolicy)),
    _row("trip_min", [-math.inf], "outputs below this end in the fallback, one for all or shape (p,)", "output units"),
    _row("trip_max", [math.inf], "outputs above this end in the fallback, one for all or shape (p,)", "output units"),
    _row(
        "trip_error",
        math.inf,
        "median prediction error that ends in the fallback; 1 = as wrong as no prediction, measured on the data",
        low=1e-9,
        high=math.inf,
    ),
    _row("trip_window", 10, "samples of that median", "samples", low=1, high=100_000),
    _row("ramp", 20, "length of the fallback's ramp", "samples", low=1, high=100_000),
    _row("shadow", False, "start in SHADOW: compute and report, move nothing"),
    _row("excitation", "uniform", "signal while collecting", choices=get_args(Signal)),
    _row("amplitude", 1.0, "share of the input range that the excitation uses", low=1e-6, high=1.0),
    _row("seed", 0, "seed of the excitation and the dither", low=0),
    _row("readers_inputs", 0, "lockstep only: subscribers of inputs to wait for before the first sample", low=0),
    _row("readers_state", 0, "lockstep only: subscribers of controller/state to wait for", low=0),
)
_SAFETY = ("max_gap", "max_hold", "max_failures", "ramp")
_BOUNDS = ("trip_min", "trip_max", "trip_error", "trip_window")
_PLAIN = {field.name for field in fields(DeepcSettings)} - {"q", "s", "u_min", "u_max"}


def _given(parameters: Mapping[str, Any]) -> dict[str, Any]:
    return {row.name: row.default for row in PARAMETERS} | dict(parameters)


def settings_for(parameters: Mapping[str, Any], info: PlantInfo) -> DeepcSettings:
    """Settings of the controller for a plant: the parameters, within the plant's limits and with its prior.

    Raises:
        ConfigError: in one line, if they cannot work.
    """
    given, m = _given(parameters), len(info.input_names)
    plain = {name: _scalar(given[name]) for name in _PLAIN & set(given)}
    try:
        return DeepcSettings(
            **plain,
            q=given["q"] or int(info.q),
            s=given["s"] or max(int(info.s), 1),
            u_min=np.maximum(info.input_min, np.broadcast_to(given["u_min"], (m,))),
            u_max=np.minimum(info.input_max, np.broadcast_to(given["u_max"], (m,))),
        )
    except ValueError as error:
        raise ConfigError(f"controller: {error}") from None


def _scalar(value: Any) -> Any:
    """A list of one means one for all channels."""
    return value[0] if isinstance(value, list) and len(value) == 1 else value


def make_agent(parameters: Mapping[str, Any], info: PlantInfo) -> Agent:
    """The decisions of one run on a plant; the node, the loop without ROS and a replay make the same one.

    Raises:
        ConfigError: in one line, if the parameters cannot work for this plant.
    """
    given, settings = _given(parameters), settings_for(parameters, info)
    try:
        safety = Safety(fallback=given["fallback_policy"], **{name: given[name] for name in _SAFETY})
        agent = Agent(
            len(info.input_names),
            len(info.output_names),
            settings,
            int(given["seed"]),
            safety,
            bounds=Bounds(**{name: _scalar(given[name]) for name in _BOUNDS}),
            excitation=given["excitation"],
            amplitude=given["amplitude"],
        )
    except ValueError as error:
        raise ConfigError(f"controller: {error}") from None
    if given["shadow"]:
        agent.request(Mode.SHADOW)
    return agent


class ControllerNode(ManagedNode):
    """Answers outputs k with inputs k+s, then publishes its state.

    It learns sizes, limits, prior and sample time from plant_info; every plant_info starts a new run. Services:
    ``controller/set_mode`` asks for a mode, ``controller/reset`` starts over with an empty window.
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
        """Makes the topics and services that do not depend on the plant."""
        self._agent: Agent | None = None
        self._inputs: PatientPublisher | None = None
        self._state: PatientPublisher | None = None
        self._early: dict[int, Sample] = {}
        self._changes: dict[str, Any] = {}
        self._diagnostics = Diagnostics(self, "")
        self.resources.callback(self._diagnostics.destroy)
        for kind, name, answer in (
            (SetMode, "controller/set_mode", self._on_set_mode),
            (Trigger, "controller/reset", self._on_reset),
        ):
            self.resources.callback(self.destroy_service, self.create_service(kind, name, answer))
        self.add_on_set_parameters_callback(self._on_change)
        self.resources.callback(self.remove_on_set_parameters_callback, self._on_change)
        self.subscribe(topics.PLANT_INFO, self._on_plant)
        self.subscribe(topics.REFERENCE, self._on_reference)

    def _on_plant(self, info: PlantInfo) -> None:
        """A plant or a new epoch of it: a fresh run. Its first inputs go out once a reference is known."""
        agent = make_agent(self.p, info)
        self._agent, self._info, self._k, self._started = agent, info, -1, False
        self._t0, self._period = nanoseconds(info.header.stamp), period_ns(info.sample_time)
        if self._inputs is None:
            self._connect(info)
        for k, msg in sorted(self._early.items()):
            self._set_reference(k, msg)
        self._begin()

    def _connect(self, info: PlantInfo) -> None:
        lockstep, Ts = bool(info.lockstep), info.sample_time
        readers = (self.p["readers_inputs"], self.p["readers_state"]) if lockstep else (0, 0)
        self._inputs = self.advertise(topics.INPUTS, lockstep=lockstep, sample_time=Ts, readers=readers[0])
        self._state = self.advertise(topics.STATE, lockstep=lockstep, readers=readers[1])
        self.subscribe(topics.OUTPUTS, self._on_outputs, lockstep=lockstep)
        if self.p["shadow"]:
            self.subscribe(topics.INPUTS, self._on_inputs, lockstep=lockstep)

    def _on_reference(self, msg: Sample) -> None:
        self._early[int(msg.k)] = msg
        if self._agent is not None:
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
        if self._started or self._agent.mode is Mode.SHADOW or self._agent.references.at(0) is None:
            return
        self._started = True
        for k, u in enumerate(self._agent.start()):
            self._send(k, u)

    def _on_inputs(self, msg: Sample) -> None:
        """SHADOW only: what whoever is in control commands."""
        assert self._agent is not None
        if self._agent.mode is Mode.SHADOW and not refusal(msg, len(self._info.input_names)):
            self._agent.overhear(int(msg.k), msg.values)

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
        self._apply_changes()
        decision = self._agent.step(self._k, msg.values, int(msg.held))
        if decision.u is not None:
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
        level = {Mode.FALLBACK: ERROR, Mode.HOLDING: WARN}.get(decision.mode, OK)
        if msg.status in (msg.STATUS_SHIFTED_PLAN, msg.STATUS_FALLBACK):
            level = max(level, WARN)
        values = {"reason": decision.reason, "failures": msg.failures, "lost": self._agent.lost}
        self._diagnostics.report(level, decision.mode.name, values | {"refused": self.refused})

    def _on_set_mode(self, request: Any, response: Any) -> Any:
        why = "there is no plant yet" if self._agent is None else self._agent.request(int(request.mode))
        response.success = not why
        response.message = why or f"now {self._agent.mode.name}"
        self.get_logger().info(f"set_mode {request.mode}: {response.message}")
        return response

    def _on_reset(self, _request: Any, response: Any) -> Any:
        why = "there is no plant yet" if self._agent is None else self._agent.request(Mode.COLLECTING)
        response.success = not why
        response.message = why or "the window is empty, collecting again"
        self.get_logger().info(f"reset: {response.message}")
        return response

    def _on_change(self, changed: list[Any]) -> SetParametersResult:
        """Parameters that may change while running are checked together and applied at the next sample."""
        values = {parameter.name: _plain(parameter.value) for parameter in changed}
        rows = {row.name: row for row in PARAMETERS}
        wanted = {name: value for name, value in values.items() if name in rows}
        for name, value in wanted.items():
            if complaint := rows[name].complaint(value):
                return SetParametersResult(successful=False, reason=complaint)
        try:
            if self._agent is not None:
                make_agent(self.p | wanted, self._info)
        except ConfigError as error:
            return SetParametersResult(successful=False, reason=str(error))
        self._changes |= wanted
        return SetParametersResult(successful=True)

    def _apply_changes(self) -> None:
        if not self._changes:
            return
        assert self._agent is not None
        self.p |= self._changes
        settings = settings_for(self.p, self._info)
        self._agent.tune(**{name: getattr(settings, name) for name in self._changes if name in LIVE})
        self._changes = {}


def _plain(value: Any) -> Any:
    return value.tolist() if hasattr(value, "tolist") else value


def state_message(agent: Agent, decision: Decision) -> ControllerState:
    """A decision as a message, without its header."""
    c = agent.controller
    msg = ControllerState(k=decision.k, mode=int(decision.mode), reason=decision.reason, failures=agent.failures)
    msg.reference = [] if decision.reference is None else decision.reference.tolist()
    msg.input = [] if decision.u is None else decision.u.tolist()
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
