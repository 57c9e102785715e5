# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The optimal control problem (6.1) on the behaviour, condensed to a small dense quadratic program.

Unknowns are the planned inputs, and slacks if outputs are limited. What does not change from one sample to the next is
worked out once per predictor; a step needs two matrix-vector products.
"""

from dataclasses import dataclass

import numpy as np

from ros2_deepc.behavior.hankel import Array

from .predictor import Predictor
from .settings import Sized, Terminal

TINY = 1e-6  # weight, relative to R, that pins what nothing else determines: steady values of inputs without effect
FREE = 1e-12  # price of a doubt that is free
THIN = 1e-7  # terminal rows weaker than this against the strongest cannot be met by inputs, whatever they are


@dataclass(frozen=True, slots=True)
class Condensed:
    """min x'Hx/2 + f'x subject to lower <= [I; A] x <= upper, affine in theta = [w; reference trajectory].

    Attributes:
        H: shape (n, n).
        A: shape (rows, n).
        f0: constant part of f, shape (n,).
        f_theta: f = f0 + f_theta theta, shape (n, size of theta).
        lower: bounds at theta = 0, shape (n + rows,).
        upper: likewise.
        shift: the bounds of A's rows move by -shift theta, shape (rows, size of theta).
        inputs: u_plan = inputs x, shape (mL, n).
        outputs: y_plan = outputs x + outputs_theta theta, shape (pL, n).
        outputs_theta: shape (pL, size of theta).
        beyond: beyond theta is what no input can do about a hard terminal condition, shape (any, size of theta).
    """

    H: Array
    A: Array
    f0: Array
    f_theta: Array
    lower: Array
    upper: Array
    shift: Array
    inputs: Array
    outputs: Array
    outputs_theta: Array
    beyond: Array


def condense(
    predictor: Predictor, sized: Sized, last_input: slice, terminal: Terminal, relaxed: bool = False
) -> Condensed:
    """Builds the program for a predictor.

    Args:
        predictor: y_f = G u_f + F w.
        sized: settings.
        last_input: where w holds the last input before the plan (for the rate limit).
        terminal: terminal condition.
        relaxed: for "hard": y = y_ref at the end becomes a penalty, u = 0 stays.
    """
    m, p, L, known = sized.m, sized.p, sized.base.L, predictor.F.shape[1]
    block = move_blocking(sized, terminal)
    limited = np.isfinite(sized.y_min).any() or np.isfinite(sized.y_max).any()
    n = block.shape[1] + (p if limited else 0)
    inputs = np.zeros((m * L, n))
    inputs[:, : block.shape[1]] = block
    plan = _Plan(
        inputs=inputs,
        outputs=predictor.G @ inputs,
        theta=np.hstack([predictor.F, np.zeros((p * L, p * L))]),
        goal=np.hstack([np.zeros((p * L, known)), np.eye(p * L)]),
        free=block.shape[1],
    )
    cost, rows = _Cost(n, known + p * L), _Rows(n, known + p * L)
    beyond = np.zeros((0, known + p * L))
    weight = stage_weight(predictor, sized)
    if terminal == "equilibrium":
        _equilibrium_cost(cost, sized, plan, weight)
    else:
        cost.add(plan.outputs, plan.theta - plan.goal, weight)
        if sized.base.form == "incremental":
            cost.add(*_moves(sized, plan, last_input), sized.R)
        else:
            cost.add(plan.inputs, None, sized.R)
    if terminal == "soft" or relaxed:
        _terminal_penalty(cost, sized, plan)
    elif terminal == "hard":
        beyond = _terminal_rows(rows, sized, plan)
    if np.isfinite(sized.du_max).any():
        _rate_rows(rows, sized, plan, last_input)
    if limited:
        _output_rows(rows, cost, sized, plan)
    low, high = _box(sized, plan.free, n)
    A, shift, lower, upper = rows.stacked()
    return Condensed(
        H=(cost.H + cost.H.T) / 2,
        A=A,
        f0=cost.f0,
        f_theta=cost.f_theta,
        lower=np.concatenate([low, lower]),
        upper=np.concatenate([high, upper]),
        shift=shift,
        inputs=plan.inputs,
        outputs=plan.outputs,
        outputs_theta=plan.theta,
        beyond=beyond,
    )


def move_blocking(sized: Sized, terminal: Terminal) -> Array:
    """Map from the free inputs to the plan u_f, shape (mL, free).

    "equilibrium" holds the last input for the terminal steps: it is the steady one. "hard" ends in zero (6.1c).
    """
    m, L, tail = sized.m, sized.base.L, sized.base.tail
    if terminal == "equilibrium":
        steps = np.minimum(np.arange(L), L - tail)
        return np.asarray(np.kron(np.eye(L - tail + 1)[steps], np.eye(m)), dtype=np.float64)
    return np.eye(m * L, m * (L - tail if terminal == "hard" else L))


def masked(sized: Sized) -> Array:
    """Output weight with the mask applied from both sides, shape (p, p)."""
    root = np.sqrt(sized.mask)
    Q: Array = root[:, None] * sized.Q * root
    return Q


def stage_weight(predictor: Predictor, sized: Sized) -> Array:
    """Weight of the output deviations: Q per sample, or (p L, p L) where the prediction is allowed some doubt.

    The noise block and the slack on the initial condition let the prediction move by D xi at a price |xi|^2. Minimised
    over xi, the stage cost keeps its form with the weight Q - Q D (I + D'QD)^-1 D'Q: deviations in directions in which
    the data are in doubt count less. So they cost no further unknowns. The reported plan stays the nominal one.
    """
    base, Q = sized.base, masked(sized)
    doubts = []
    if base.noise_block != "off":
        price = base.regularization if base.noise_block == "ridge" else 0.0
        doubts.append(predictor.noise / np.sqrt(max(price, FREE)))
    if np.isfinite(base.initial_slack):
        doubts.append(predictor.state / np.sqrt(max(base.initial_slack, FREE)))
    if not doubts:
        return Q
    values, vectors = np.linalg.eigh(Q)
    root = np.kron(np.eye(base.L), (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)
    U, sv, _ = np.linalg.svd(root @ np.hstack(doubts), full_matrices=False)
    shrunk = (U * (sv**2 / (1.0 + sv**2))) @ U.T
    return np.asarray(root @ (np.eye(len(root)) - shrunk) @ root)


@dataclass(frozen=True, slots=True)
class _Plan:
    """u_plan = inputs x, y_plan = outputs x + theta theta, y_ref = goal theta; the first `free` unknowns are inputs."""

    inputs: Array
    outputs: Array
    theta: Array
    goal: Array
    free: int


class _Cost:
    """Sum of |C x + D theta|_W^2, W repeated down the rows, and of linear prices."""

    def __init__(self, n: int, theta: int) -> None:
        self.H = np.zeros((n, n))
        self.f0 = np.zeros(n)
        self.f_theta = np.zeros((n, theta))

    def add(self, C: Array, D: Array | None, W: Array) -> None:
        WC = (W @ C.reshape(-1, W.shape[0], C.shape[1])).reshape(C.shape)
        self.H += 2 * C.T @ WC
        if D is not None:
            self.f_theta += 2 * WC.T @ D


class _Rows:
    """Rows lower <= C x + D theta <= upper; those without a finite bound are left out."""

    def __init__(self, n: int, theta: int) -> None:
        self._C, self._D = [np.zeros((0, n))], [np.zeros((0, theta))]
        self._low, self._high = [np.zeros(0)], [np.zeros(0)]

    def add(self, C: Array, D: Array, low: Array, high: Array) -> None:
        some = np.isfinite(low) | np.isfinite(high)
        self._C.append(C[some])
        self._D.append(D[some])
        self._low.append(low[some])
        self._high.append(high[some])

    def stacked(self) -> tuple[Array, Array, Array, Array]:
        return np.vstack(self._C), np.vstack(self._D), np.concatenate(self._low), np.concatenate(self._high)


def _equilibrium_cost(cost: _Cost, sized: Sized, plan: _Plan, weight: Array) -> None:
    """Stage cost against the plan's own end (u_s, y_s), distance of y_s from the reference, and rest over the tail.

    y_s and u_s are the last predicted output and the last planned input, not further unknowns: at rest the two
    readings coincide, and the program stays a pure box problem of which both solvers make short work. A reference
    that can be held is held exactly, since every term vanishes there.
    """
    m, p, L, tail = sized.m, sized.p, sized.base.L, sized.base.tail
    Q = masked(sized)
    y_s, y_s_theta = plan.outputs[-p:], plan.theta[-p:]
    end = plan.goal[-p:]
    off = plan.outputs - np.tile(y_s, (L, 1))
    off_theta = plan.theta - np.tile(y_s_theta, (L, 1))
    shape = plan.goal - np.tile(end, (L, 1))  # a previewed reference is followed relative to its end
    cost.add(off, off_theta - shape, weight)
    cost.add(plan.inputs - np.tile(plan.inputs[-m:], (L, 1)), None, sized.R)
    cost.add(y_s, y_s_theta - end, sized.base.offset_weight * Q)
    cost.add(off[-p * tail :], off_theta[-p * tail :], sized.base.terminal_weight * Q)
    cost.add(plan.inputs[-m:], None, TINY * max(float(np.trace(sized.R)) / m, TINY) * np.eye(m))


def _terminal_penalty(cost: _Cost, sized: Sized, plan: _Plan) -> None:
    """(6.1c) as a quadratic penalty."""
    part, weight = slice(-sized.p * sized.base.tail, None), sized.base.terminal_weight
    cost.add(plan.outputs[part], (plan.theta - plan.goal)[part], weight * masked(sized))
    cost.add(plan.inputs[-sized.m * sized.base.tail :], None, weight * sized.R)


def _terminal_rows(rows: _Rows, sized: Sized, plan: _Plan) -> Array:
    """The output part of (6.1c) as equality rows, cut down to independent ones (at most the order of the plant).

    Returns:
        Map from theta to what the dropped rows would still ask for: zero if and only if they agree with the kept ones.
    """
    part = np.tile(sized.mask > 0, sized.base.L)
    part[: -sized.p * sized.base.tail] = False
    C, D = plan.outputs[part], (plan.theta - plan.goal)[part]
    U, sv, _ = np.linalg.svd(C)
    rank = int(np.count_nonzero(sv > THIN * sv[0])) if sv.size and sv[0] > 0 else 0
    zero = np.zeros(rank)
    rows.add(U[:, :rank].T @ C, U[:, :rank].T @ D, zero, zero)
    return np.asarray(U[:, rank:] @ (U[:, rank:].T @ D))


def _output_rows(rows: _Rows, cost: _Cost, sized: Sized, plan: _Plan) -> None:
    """y_min - slack <= y(k) <= y_max + slack, one slack per output over the whole plan, with a price that is exact."""
    p, L = sized.p, sized.base.L
    slack = np.zeros_like(plan.outputs)
    slack[:, plan.free :] = np.tile(np.eye(p), (L, 1))
    free = np.full(p * L, np.inf)
    rows.add(plan.outputs + slack, plan.theta, np.tile(sized.y_min, L), free)
    rows.add(plan.outputs - slack, plan.theta, -free, np.tile(sized.y_max, L))
    price = sized.base.slack_weight * max(float(np.trace(sized.Q)) / p, TINY)
    cost.f0[plan.free :] = price
    cost.H[plan.free :, plan.free :] = price * np.eye(p)


def _moves(sized: Sized, plan: _Plan, last_input: slice) -> tuple[Array, Array]:
    """Changes of the inputs from one planned sample to the next, C x + D theta."""
    m = sized.m
    C = plan.inputs.copy()
    C[m:] -= plan.inputs[:-m]
    D = np.zeros((C.shape[0], plan.theta.shape[1]))
    D[:m, last_input] = -np.eye(m)
    return C, D


def _rate_rows(rows: _Rows, sized: Sized, plan: _Plan, last_input: slice) -> None:
    C, D = _moves(sized, plan, last_input)
    some = (np.abs(C).sum(axis=1) + np.abs(D).sum(axis=1)) > 0  # blocked moves cannot change
    limit = np.tile(sized.du_max, sized.base.L)[some]
    rows.add(C[some], D[some], -limit, limit)


def _box(sized: Sized, free: int, n: int) -> tuple[Array, Array]:
    low, high = np.zeros(n), np.full(n, np.inf)
    low[:free], high[:free] = np.tile(sized.u_min, free // sized.m), np.tile(sized.u_max, free // sized.m)
    return low, high
