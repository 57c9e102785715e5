# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The optimal control problem (6.1) on the behaviour, condensed to a small dense quadratic program.

Unknowns are the planned inputs, and as the settings ask: the steady output, terminal slacks, output slacks. Everything that
does not change from one sample to the next is worked out once per predictor; a step needs two matrix-vector products.
"""

from dataclasses import dataclass

import numpy as np

from ros2_deepc.behavior.hankel import Array

from .predictor import Predictor
from .settings import Sized

TINY = 1e-6  # weight, relative to R or Q, that pins what nothing else determines (steady values of dead inputs, idle slacks)


@dataclass(frozen=True, slots=True)
class Variables:
    """Where the parts of the unknown x lie.

    Attributes:
        v: planned inputs that are free, after move blocking by the terminal condition.
        steady: steady output.
        terminal: terminal slack, one per output.
        slack: output slack, one per output.
        size: length of x.
    """

    v: slice
    steady: slice
    terminal: slice
    slack: slice
    size: int


@dataclass(frozen=True, slots=True)
class Condensed:
    """min x'Hx/2 + f'x, lower <= [I; A] x <= upper, affine in theta = [w; reference trajectory].

    Attributes:
        H: shape (n, n).
        A: shape (rows, n).
        f0: constant part of f, shape (n,); linear prices.
        f_theta: f = f0 + f_theta theta, shape (n, size of theta).
        lower: bounds at theta = 0, shape (n + rows,).
        upper: likewise.
        shift: the bounds of A's rows move by -shift theta, shape (rows, size of theta).
        inputs: u_plan = inputs x, shape (mL, n).
        outputs: y_plan = outputs x + outputs_theta theta, shape (pL, n).
        outputs_theta: shape (pL, size of theta).
        variables: the parts of x.
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
    variables: Variables


def condense(predictor: Predictor, sized: Sized, last_input: slice) -> Condensed:
    """Builds the program for a predictor.

    Args:
        predictor: y_f = G u_f + F w.
        sized: settings.
        last_input: where w holds the last input before the plan (for the rate limit).
    """
    base, m, p = sized.base, sized.m, sized.p
    L, known = base.L, predictor.F.shape[1]
    theta = known + p * L
    block = move_blocking(sized)
    variables = _variables(sized, block.shape[1])
    n = variables.size

    inputs = np.zeros((m * L, n))
    inputs[:, variables.v] = block
    outputs = predictor.G @ inputs
    outputs_theta = np.hstack([predictor.F, np.zeros((p * L, p * L))])
    goal = np.hstack([np.zeros((p * L, known)), np.eye(p * L)])

    cost = _Cost(n, theta)
    _stage_cost(cost, sized, variables, inputs, outputs, outputs_theta, goal)
    rows = _Rows(n, theta)
    if np.isfinite(sized.du_max).any():
        _rate_rows(rows, sized, inputs, last_input)
    if base.terminal in ("equilibrium", "hard"):
        _terminal_rows(rows, cost, sized, variables, outputs, outputs_theta, goal)
    if np.isfinite(sized.y_min).any() or np.isfinite(sized.y_max).any():
        _output_rows(rows, cost, sized, variables, outputs, outputs_theta)
    low, high = _box(sized, variables)
    A, shift, lower, upper = rows.stacked()
    return Condensed(
        H=(cost.H + cost.H.T) / 2,
        A=A,
        f0=cost.f0,
        f_theta=cost.f_theta,
        lower=np.concatenate([low, lower]),
        upper=np.concatenate([high, upper]),
        shift=shift,
        inputs=inputs,
        outputs=outputs,
        outputs_theta=outputs_theta,
        variables=variables,
    )


def move_blocking(sized: Sized) -> Array:
    """Map from free inputs v to the plan u_f, shape (mL, size of v).

    "equilibrium" holds the last input for the terminal steps (it is the steady one), "hard" holds zero as (6.1c) prints it.
    """
    m, L, tail = sized.m, sized.base.L, sized.base.tail
    if sized.base.terminal == "equilibrium":
        steps = np.minimum(np.arange(L), L - tail)
        return np.kron(np.eye(L - tail + 1)[steps], np.eye(m))
    if sized.base.terminal == "hard":
        return np.eye(m * L, m * (L - tail))
    return np.eye(m * L)


def _variables(sized: Sized, v: int) -> Variables:
    p, terminal = sized.p, sized.base.terminal
    counts = (
        v,
        p if terminal == "equilibrium" else 0,
        p if terminal in ("equilibrium", "hard") else 0,
        p if np.isfinite(sized.y_min).any() or np.isfinite(sized.y_max).any() else 0,
    )
    ends = np.cumsum(counts)
    parts = [slice(int(end - count), int(end)) for count, end in zip(counts, ends, strict=True)]
    return Variables(*parts, size=int(ends[-1]))


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

    def price(self, part: slice, linear: Array) -> None:
        """Linear price on nonnegative unknowns, with a small quadratic one that keeps them unique."""
        self.f0[part] += linear
        index = np.arange(part.start, part.stop)
        self.H[index, index] += 1e-3 * np.maximum(linear, linear.max(initial=0.0) * TINY + TINY)


class _Rows:
    """Rows lower <= C x + D theta <= upper."""

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


def _stage_cost(
    cost: _Cost, sized: Sized, variables: Variables, inputs: Array, outputs: Array, outputs_theta: Array, goal: Array
) -> None:
    base, p, L = sized.base, sized.p, sized.base.L
    Q = masked(sized)
    if base.terminal == "equilibrium":
        # y(k) follows y_s plus the shape of the reference relative to its end; u(k) follows u_s, the last planned input
        last = np.tile(np.eye(p), (L, 1))
        C = outputs.copy()
        C[:, variables.steady] -= last
        cost.add(C, outputs_theta - goal + last @ goal[-p:], Q)
        cost.add(inputs - np.tile(inputs[-sized.m :], (L, 1)), None, sized.R)
        at_end = np.zeros((p, variables.size))
        at_end[:, variables.steady] = np.eye(p)
        cost.add(at_end, -goal[-p:], base.offset_weight * Q)
        pin = TINY * max(float(np.trace(sized.R)) / sized.m, TINY)
        cost.add(inputs[-sized.m :], None, pin * np.eye(sized.m))
        # a masked output has no weight at all: pin its steady value
        cost.add(at_end, -goal[-p:], TINY * (np.trace(Q) / p + TINY) * np.diag((np.diag(Q) == 0).astype(float)))
        return
    cost.add(outputs, outputs_theta - goal, Q)
    cost.add(inputs, None, sized.R)
    if base.terminal == "soft":
        tail = base.tail
        y_tail, u_tail = slice(-p * tail, None), slice(-sized.m * tail, None)
        weight = base.terminal_weight
        cost.add(outputs[y_tail], (outputs_theta - goal)[y_tail], weight * Q)
        cost.add(inputs[u_tail], None, weight * sized.R)


def masked(sized: Sized) -> Array:
    """Output weight with the mask applied from both sides, shape (p, p)."""
    root = np.sqrt(sized.mask)
    Q: Array = root[:, None] * sized.Q * root
    return Q


def _prices(sized: Sized, weight: float) -> Array:
    """Linear price per output: weight times its own weight in Q; outputs that do not count cost nothing."""
    return weight * np.diag(masked(sized)).copy()


def _terminal_rows(
    rows: _Rows, cost: _Cost, sized: Sized, variables: Variables, outputs: Array, outputs_theta: Array, goal: Array
) -> None:
    """|y(k) - target| <= slack over the terminal steps, per output; the target is the steady output or the reference."""
    p, tail = sized.p, sized.base.tail
    part = slice(-p * tail, None)
    C, D = outputs[part].copy(), outputs_theta[part].copy()
    if sized.base.terminal == "equilibrium":
        C[:, variables.steady] -= np.tile(np.eye(p), (tail, 1))
    else:
        D -= goal[part]
    slack = np.zeros_like(C)
    slack[:, variables.terminal] = np.tile(np.eye(p), (tail, 1))
    zero, free = np.zeros(p * tail), np.full(p * tail, np.inf)
    counts = np.tile(np.diag(masked(sized)) > 0, tail)
    rows.add((C + slack)[counts], D[counts], zero[counts], free[counts])
    rows.add((C - slack)[counts], D[counts], -free[counts], zero[counts])
    cost.price(variables.terminal, _prices(sized, sized.base.terminal_weight))


def _output_rows(
    rows: _Rows, cost: _Cost, sized: Sized, variables: Variables, outputs: Array, outputs_theta: Array
) -> None:
    """y_min - slack <= y(k) <= y_max + slack, one slack per output over the whole plan."""
    p, L = sized.p, sized.base.L
    slack = np.zeros_like(outputs)
    slack[:, variables.slack] = np.tile(np.eye(p), (L, 1))
    free = np.full(p * L, np.inf)
    rows.add(outputs + slack, outputs_theta, np.tile(sized.y_min, L), free)
    rows.add(outputs - slack, outputs_theta, -free, np.tile(sized.y_max, L))
    scale = max(float(np.trace(sized.Q)) / p, TINY)
    cost.price(variables.slack, np.full(p, sized.base.slack_weight * scale))


def _rate_rows(rows: _Rows, sized: Sized, inputs: Array, last_input: slice) -> None:
    m, L = sized.m, sized.base.L
    C = inputs.copy()
    C[m:] -= inputs[:-m]
    D = np.zeros((m * L, rows.stacked()[1].shape[1]))
    D[:m, last_input] = -np.eye(m)
    moves = np.abs(C).sum(axis=1) + np.abs(D).sum(axis=1) > 0  # blocked moves cannot change
    limit = np.tile(sized.du_max, L)
    rows.add(C[moves], D[moves], -limit[moves], limit[moves])


def _box(sized: Sized, variables: Variables) -> tuple[Array, Array]:
    low, high = np.full(variables.size, -np.inf), np.full(variables.size, np.inf)
    moves = (variables.v.stop - variables.v.start) // sized.m
    low[variables.v], high[variables.v] = np.tile(sized.u_min, moves), np.tile(sized.u_max, moves)
    for part in (variables.terminal, variables.slack):
        low[part] = 0.0
    return low, high
