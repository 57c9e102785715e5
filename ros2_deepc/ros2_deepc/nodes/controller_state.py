# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""What the controller knows and decided, as a message and for people."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from deepc_msgs.msg import ControllerState

from ..control import StepResult
from ..control.agent import Agent, Decision
from ..control.modes import Mode
from ..ros.diagnostics import ERROR, OK, WARN


def state_message(agent: Agent, decision: Decision) -> ControllerState:
    """A decision as a message, without its header."""
    c = agent.controller
    msg = ControllerState(k=decision.k, mode=int(decision.mode), reason=decision.reason, failures=agent.failures)
    msg.reference = [] if decision.reference is None else decision.reference.tolist()
    msg.input = [] if decision.u is None else decision.u.tolist()
    msg.mask, msg.weak = c.mask.tolist(), c.weak
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


def judgement(msg: ControllerState, decision: Decision, complaints: Sequence[str]) -> tuple[bytes, str]:
    """Level and line of the diagnostics: the mode, and what is wrong with the loop."""
    if msg.overdue:
        complaints = ["outputs are overdue", *complaints]
    level = {Mode.FALLBACK: ERROR, Mode.HOLDING: WARN}.get(decision.mode, OK)
    if complaints or msg.status in (msg.STATUS_SHIFTED_PLAN, msg.STATUS_FALLBACK):
        level = max(level, WARN)
    return level, "; ".join([decision.mode.name, *complaints])


def facts(msg: ControllerState, decision: Decision) -> dict[str, Any]:
    """What the diagnostics tell of a state."""
    return {
        "reason": decision.reason,
        "k": decision.k,
        "rank": f"{msg.rank}/{msg.rank_need}",
        "excitation": f"{msg.excitation}/{msg.excitation_need}",
        "weak": msg.weak,
        "solve_time": msg.solve_time,
        "failures": msg.failures,
        "refused": msg.refused,
        "deadline_misses": msg.deadline_misses,
    }
