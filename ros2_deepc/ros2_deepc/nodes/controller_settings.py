# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The controller's parameters, and the decisions of one run that they make."""

import math
from collections.abc import Mapping
from dataclasses import fields
from typing import Any, get_args

import numpy as np
from deepc_msgs.msg import PlantInfo

from ..control import DeepcSettings
from ..control.agent import Agent, Leave
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
from ..ros.parameters import ConfigError, Param


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
    _row("terminal_weight", 1e7, "price of violating it, relative to Q", low=0.0),
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
    _row("standby", False, "while another controller commands the plant: wait until it is gone, instead of refusing"),
    _row("stop", "safe", "real time only: last input when it is stopped", choices=get_args(Leave)),
    _row(
        "patience",
        5,
        "real time only: periods without outputs after which the clock decides; 0 = never",
        "samples",
        low=0,
        high=10_000,
    ),
    _row("preview", False, "plan over the references that are known to come"),
    _row("heed_monitor", False, "do not chase outputs that the modes reported by the monitor make impossible to hold"),
    _row("excitation", "uniform", "signal while collecting", choices=get_args(Signal)),
    _row("amplitude", 1.0, "share of the input range that the excitation uses", low=1e-6, high=1.0),
    _row("seed", 0, "seed of the excitation and the dither", low=0),
    _row("readers_inputs", 0, "lockstep only: subscribers of inputs to wait for before the first sample", low=0),
    _row("readers_state", 0, "lockstep only: subscribers of controller/state to wait for", low=0),
)
_SAFETY = ("max_gap", "max_hold", "max_failures", "ramp")
_BOUNDS = ("trip_min", "trip_max", "trip_error", "trip_window")
_PLAIN = {field.name for field in fields(DeepcSettings)} - {"q", "s", "u_min", "u_max", "disturbances"}


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
            disturbances=len(getattr(info, "disturbance_names", ())),  # bags of old do not know them
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
            preview=given["preview"],
        )
    except ValueError as error:
        raise ConfigError(f"controller: {error}") from None
    if given["shadow"]:
        agent.request(Mode.SHADOW)
    return agent
