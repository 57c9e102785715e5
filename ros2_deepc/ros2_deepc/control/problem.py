# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The optimal control problem (6.1) on the behaviour, condensed to a small dense quadratic program.

Unknowns are the planned inputs, and slacks if outputs are limited. What depends on the settings alone is worked out
once (a `Template`), what depends on the predictor once per predictor (`condense`); a step needs a few matrix-vector
products.
"""

from dataclasses import dataclass, replace

import numpy as np

from ros2_deepc.behavior.hankel import Array

from .predictor import EPS, Predictor
from .settings import Sized, Terminal

TINY = 1e-6  # weight, relative to R, that pins what nothing else determines
CALM = 1e-5  # share of the pull towards the reference that holds the steady input where it is
SILENT = 1e-10  # of the strongest input's effect, squared: below it an input has none
HEAVY = 10.0  # squares that weigh more than this against Q get a variable of their own
FREE = 1e-12  # price of a doubt that is free
FAR = 1e30  # as good as no bound, and finite
THIN = 1e-7  # terminal rows weaker than this against the strongest cannot be met by inputs, whatever they are


@dataclass(frozen=True, slots=True)
class Condensed:
    """min x'Hx/2 + f'x subject to lower <= [I; A] x <= upper.

    f and the bounds are affine in what a step knows: w = [known inputs; disturbances; past outputs] and the reference
    trajectory, both as vectors.

    The first m unknowns are the first planned input, the first `free` ones all planned inputs.

    Attributes:
        H: shape (n, n).
        A: shape (rows, n).
        f0: constant part of f, shape (n,).
        f_w: f = f0 + f_w w + f_goal goal, shape (n, size of w).
        f_goal: shape (n, pL).
        lower: bounds at w = 0 and goal = 0, shape (n + rows,).
        upper: likewise.
        A_w: the bounds of A's rows move by -(A_w w + A_goal goal), shape (rows, size of w).
        A_goal: shape (rows, pL).
        inputs: u_plan = inputs x, shape (mL, n).
        outputs: y_plan = outputs x + outputs_w w, shape (pL, n).
        outputs_w: shape (pL, size of w).
        rests: the last unknowns are this many misses of the terminal rest; the bounds hold them at zero.
    """

    H: Array
    A: Array
    f0: Array
    f_w: Array
    f_goal: Array
    lower: Array
    upper: Array
    A_w: Array
    A_goal: Array
    inputs: Array
    outputs: Array
    outputs_w: Array
    rests: int = 0

    def eased(self, lower: Array, upper: Array) -> tuple[Array, Array]:
        """The bounds with the misses of the terminal rest set free, at their price."""
        n = self.H.shape[0]
        lower, upper = lower.copy(), upper.copy()
        lower[n - self.rests : n], upper[n - self.rests : n] = -FAR, FAR
        return lower, upper


class Template:
    """What a program owes to the settings alone: unknowns, input costs, input limits.

    Args:
        sized: settings.
        known: size of w.
        last_input: where w holds the last input before the plan.
        terminal: terminal condition.
    """

    def __init__(self, sized: Sized, known: int, last_input: slice, terminal: Terminal) -> None:
        m, p, L = sized.m, sized.p, sized.base.L
        self.sized, self.known, self.terminal = sized, known, terminal
        self.last_input = last_input
        self.last_input_negative = np.zeros((m, known))
        self.last_input_negative[:, last_input] = -np.eye(m)
        self.block = move_blocking(sized, terminal)
        self.free = self.block.shape[1]
        self.limited = bool(np.isfinite(sized.y_min).any() or np.isfinite(sized.y_max).any())
        self.n = n = self.free + (p if self.limited else 0)
        self.inputs = np.zeros((m * L, n))
        self.inputs[:, : self.free] = self.block
        self.lower, self.upper = np.zeros(n), np.full(n, np.inf)
        self.lower[: self.free] = np.tile(sized.u_min, self.free // m)
        self.upper[: self.free] = np.tile(sized.u_max, self.free // m)
        self.cost = _Cost(n, known, p * L)
        moves, moves_w = self._moves()
        self.input_size = max(float(np.trace(sized.R)) / m, TINY)
        self.input_shape = sized.R / self.input_size  # R by its mean, and never singular
        if np.linalg.eigvalsh(self.input_shape)[0] < TINY:
            self.input_shape = self.input_shape + TINY * np.eye(m)
        if terminal == "equilibrium":
            self.cost.add(self.inputs - np.tile(self.inputs[-m:], (L, 1)), None, sized.R)
        elif sized.base.form == "incremental":
            self.cost.add(moves, moves_w, sized.R)
        else:
            self.cost.add(self.inputs, None, sized.R)
        if terminal == "soft":
            self.cost.add(self.inputs[-m * sized.base.tail :], None, sized.base.terminal_weight * sized.R)
        self.rows = _Rows(n, known, p * L)
        self.slow = bool(np.isfinite(sized.du_max).any())
        if self.slow:
            some = (np.abs(moves).sum(axis=1) + np.abs(moves_w).sum(axis=1)) > 0  # blocked moves cannot change
            limit = np.tile(sized.du_max, L)[some]
            self.rows.add(moves[some], moves_w[some], None, -limit, limit)

    def from_here(self, w: Array, A_w: Array) -> Array:
        """A_w w, with moves counted from the last input brought into its box: from outside no plan would be left."""
        if self.slow:
            w = w.copy()
            w[self.last_input] = np.minimum(np.maximum(w[self.last_input], self.sized.u_min), self.sized.u_max)
        return A_w @ w

    def _moves(self) -> tuple[Array, Array]:
        """Changes of the inputs from one planned sample to the next, C x + D w."""
        m = self.sized.m
        C = self.inputs.copy()
        C[m:] -= self.inputs[:-m]
        D = np.zeros((C.shape[0], self.known))
        D[:m] = self.last_input_negative
        return C, D


def condense(template: Template, predictor: Predictor) -> Condensed:
    """The program for a predictor."""
    sized, free = template.sized, template.free
    outputs = np.zeros((predictor.G.shape[0], template.n))
    outputs[:, :free] = predictor.G @ template.block if free < predictor.G.shape[1] else predictor.G
    cost, rows = template.cost.copy(), template.rows.copy()
    squares: list[_Square] = []  # heavy ones
    weight = stage_weight(predictor, sized)
    if template.terminal == "equilibrium":
        _equilibrium_cost(cost, sized, outputs, predictor.F, weight)
        squares = _equilibrium_squares(cost, template, outputs, predictor)
    else:
        cost.f_goal -= cost.add(outputs, predictor.F, weight).T
    if template.terminal == "soft":
        part = slice(-sized.p * sized.base.tail, None)
        goal, price = -np.eye(outputs.shape[0])[part], sized.base.terminal_weight
        square = _Square.of(outputs[part], predictor.F[part], goal, price, _root(masked(sized)))
        squares = _apart(cost, [square.compressed(min(outputs.shape))[1]], price)
    elif template.terminal == "hard":
        _terminal_rows(rows, sized, outputs, predictor.F)
    if template.limited:
        _output_rows(rows, cost, sized, outputs, predictor.F, free)
    A, A_w, A_goal, lower, upper = rows.stacked()
    program = Condensed(
        H=cost.H,
        A=A,
        f0=cost.f0,
        f_w=cost.f_w,
        f_goal=cost.f_goal,
        lower=np.concatenate([template.lower, lower]),
        upper=np.concatenate([template.upper, upper]),
        A_w=A_w,
        A_goal=A_goal,
        inputs=template.inputs,
        outputs=outputs,
        outputs_w=predictor.F,
    )
    return _lift(program, squares) if squares else program


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


class _Cost:
    """Sum of |C x + D w + ...|_W^2, W repeated down the rows, and of linear prices."""

    def __init__(self, n: int, known: int, goal: int) -> None:
        self.H = np.zeros((n, n))
        self.f0 = np.zeros(n)
        self.f_w = np.zeros((n, known))
        self.f_goal = np.zeros((n, goal))

    def copy(self) -> "_Cost":
        other = _Cost.__new__(_Cost)
        other.H, other.f0, other.f_w, other.f_goal = self.H.copy(), self.f0.copy(), self.f_w.copy(), self.f_goal.copy()
        return other

    def add(self, C: Array, D: Array | None, W: Array) -> Array:
        """Adds |C x + D w|_W^2; returns 2 W C for whatever else stands in the same square."""
        twice = 2.0 * (W @ C.reshape(-1, W.shape[0], C.shape[1])).reshape(C.shape)
        self.H += C.T @ twice
        if D is not None:
            self.f_w += twice.T @ D
        return np.asarray(twice)


class _Rows:
    """Rows lower <= C x + D w + E goal <= upper; those without a finite bound are left out."""

    def __init__(self, n: int, known: int, goal: int) -> None:
        self._parts = [(np.zeros((0, n)), np.zeros((0, known)), np.zeros((0, goal)), np.zeros(0), np.zeros(0))]

    def copy(self) -> "_Rows":
        other = _Rows.__new__(_Rows)
        other._parts = list(self._parts)
        return other

    def add(self, C: Array, D: Array, E: Array | None, low: Array, high: Array) -> None:
        some = np.isfinite(low) | np.isfinite(high)
        E = np.zeros((C.shape[0], self._parts[0][2].shape[1])) if E is None else E
        self._parts.append((C[some], D[some], E[some], low[some], high[some]))

    def stacked(self) -> tuple[Array, Array, Array, Array, Array]:
        if len(self._parts) == 1:
            return self._parts[0]
        C, D, E, low, high = zip(*self._parts, strict=True)
        return np.vstack(C), np.vstack(D), np.vstack(E), np.concatenate(low), np.concatenate(high)


@dataclass(frozen=True, slots=True)
class _Square:
    """A cost sum of weight (C x + D w + E goal)^2, one weight per row; of a rest, zero wherever limits allow."""

    C: Array
    D: Array
    E: Array
    weight: Array
    rest: bool = False

    @staticmethod
    def of(C: Array, D: Array, E: Array, price: float, root: Array) -> "_Square":
        """With one price, and each sample's outputs mapped by ``root``, shape (any, p)."""
        C, D, E = (np.matmul(root, M.reshape(-1, root.shape[1], M.shape[1])).reshape(-1, M.shape[1]) for M in (C, D, E))
        return _Square(C, D, E, np.full(len(C), price))

    def compressed(self, rank: int, doubt: float = 0.0) -> tuple["_Square", "_Square"]:
        """The same, but for a constant, in at most ``rank`` rows: those that x can move, with orthonormal rows of C.

        Returns:
            Rows weaker than ``doubt`` against the strongest, and the others.
        """
        U, sv, Vt = np.linalg.svd(self.C, full_matrices=False)
        kept = min(rank, int(np.count_nonzero(sv > THIN * sv[:1])))
        firm = min(kept, int(np.count_nonzero(sv > doubt * sv[:1])))
        keep = (U[:, :kept] / sv[:kept]).T
        C, D, E, weight = Vt[:kept], keep @ self.D, keep @ self.E, self.weight[:1] * sv[:kept] ** 2
        weak, strong = (
            _Square(C[part], D[part], E[part], weight[part]) for part in (slice(firm, None), slice(None, firm))
        )
        return weak, strong

    def add_to(self, cost: "_Cost") -> None:
        """Adds it to the other costs."""
        root = np.sqrt(self.weight)[:, None]
        cost.f_goal += cost.add(root * self.C, root * self.D, np.eye(len(root))).T @ (root * self.E)


def _apart(cost: _Cost, squares: list[_Square], price: float) -> list[_Square]:
    """Squares that are too heavy for H; the others are added to the cost."""
    squares = [square for square in squares if len(square.C)]
    if price > HEAVY:
        return squares
    for square in squares:
        square.add_to(cost)
    return []


def _lift(program: Condensed, squares: list[_Square]) -> Condensed:
    """The program with heavy squares added, a rest last: each row C x + D w + E goal = scale t has an unknown t.

    The price of t is an ordinary one. Added to H, the squares would leave it so ill-conditioned that an
    operator-splitting solver stops far from the optimum. The t of a rest are held at zero.
    """
    n = program.H.shape[0]
    price = max(float(program.H.diagonal().mean()), TINY)
    C, D, E = (np.vstack(maps) for maps in zip(*((q.C, q.D, q.E) for q in squares), strict=True))
    scale = np.sqrt(price / (2.0 * np.concatenate([square.weight for square in squares])))
    count = scale.size
    H = np.zeros((n + count, n + count))
    H[:n, :n] = program.H
    H[n:, n:] = price * np.eye(count)
    rests = sum(len(square.C) for square in squares if square.rest)
    far, zero = np.full(count, np.inf), np.zeros(count)
    far[count - rests :] = 0.0

    def padded(M: Array, axis: int) -> Array:
        return np.pad(M, [(0, count) if i == axis else (0, 0) for i in range(M.ndim)])

    return Condensed(
        H=H,
        A=np.vstack([padded(program.A, 1), np.hstack([C, -np.diag(scale)])]),
        f0=padded(program.f0, 0),
        f_w=padded(program.f_w, 0),
        f_goal=padded(program.f_goal, 0),
        lower=np.concatenate([program.lower[:n], -far, program.lower[n:], zero]),
        upper=np.concatenate([program.upper[:n], far, program.upper[n:], zero]),
        A_w=np.vstack([program.A_w, D]),
        A_goal=np.vstack([program.A_goal, E]),
        inputs=padded(program.inputs, 1),
        outputs=padded(program.outputs, 1),
        outputs_w=program.outputs_w,
        rests=rests,
    )


def _root(Q: Array) -> Array:
    """C with C'C = Q and no more rows than the rank of Q."""
    values, vectors = np.linalg.eigh(Q)
    some = values > EPS * max(float(values[-1]), 0.0)
    return np.asarray((vectors[:, some] * np.sqrt(values[some])).T)


def _equilibrium_cost(cost: _Cost, sized: Sized, outputs: Array, F: Array, weight: Array) -> None:
    """Stage cost against the plan's own end (u_s, y_s).

    y_s and u_s are the last predicted output and the last planned input, not further unknowns: at rest the two
    readings coincide. A previewed reference is followed relative to its end.
    """
    p, L = sized.p, sized.base.L
    off, off_w = _from_end(outputs, p), _from_end(F, p)
    weighted = cost.add(off, off_w, weight)
    cost.f_goal -= weighted.T
    cost.f_goal[:, -p:] += weighted.T.reshape(-1, L, p).sum(axis=1)


def _equilibrium_squares(cost: _Cost, template: Template, outputs: Array, predictor: Predictor) -> list[_Square]:
    """Rest over the tail, and the distance of y_s from the reference.

    Rest is no price but a condition, as long as any plan within the limits meets it: the limit of an exact penalty.
    Where none does, terminal_weight prices what is missing. Rows so weak that noise in the data may have made them up
    are only priced. Two small prices choose among steady inputs that serve alike, and vanish at rest: on the move to
    them, and on their share that no output sees at rest.
    """
    sized, F = template.sized, predictor.F
    base, p, m = sized.base, sized.p, sized.m
    root = _root(masked(sized))
    end = _Square.of(outputs[-p:], F[-p:], -np.eye(p * base.L)[-p:], base.offset_weight, root)
    part = slice(-p * base.tail, -p)
    off, off_w = _from_end(outputs, p)[part], _from_end(F, p)[part]
    rest = _Square.of(off, off_w, np.zeros((len(off), p * base.L)), base.terminal_weight, root)
    conditions = predictor.order + m * (base.s - 1) if base.q else len(off)
    pull = base.offset_weight * float(np.sum(end.C[:, template.free - m : template.free] ** 2)) / m
    calm = max(CALM * pull, TINY * template.input_size) * template.input_shape
    steady, known = template.inputs[-m:], template.last_input.stop
    # Around an unknown operating point, 0 is an input like any other.
    idle = _idle(predictor, root, m, known) if base.form == "absolute" else np.zeros((m, m))
    acting = np.eye(m) - idle
    cost.add(acting @ steady, acting @ template.last_input_negative, calm)
    # The way there disturbs outputs, but for inputs that no output ever sees: those may go at once.
    cost.add(idle @ steady, None, TINY * template.input_size * template.input_shape)
    cost.add(_silent(predictor, root, m, known) @ idle @ steady, None, calm)
    weak, firm = rest.compressed(conditions, predictor.doubt)
    return [
        *_apart(cost, [end], base.offset_weight),
        *_apart(cost, [weak, replace(firm, rest=True)], base.terminal_weight),
    ]


def _idle(predictor: Predictor, root: Array, m: int, known: int) -> Array:
    """Projector onto the constant inputs that leave outputs at rest alone, shape (m, m).

    Constant inputs u in the past and in the plan, with outputs 0 in the past, predict outputs 0 if and only if the
    steady gain takes u to 0.
    """
    rows = len(predictor.F)
    response = predictor.F[:, :known].reshape(rows, -1, m).sum(axis=1) + predictor.G.reshape(rows, -1, m).sum(axis=1)
    seen = np.matmul(root, response.reshape(-1, root.shape[1], m)).reshape(-1, m)
    _, sv, directions = np.linalg.svd(seen)
    kept = directions[: int(np.count_nonzero(sv > THIN * sv[:1]))]
    return np.asarray(np.eye(m) - kept.T @ kept)


def _silent(predictor: Predictor, root: Array, m: int, known: int) -> Array:
    """Projector onto the inputs without any effect on the outputs that count, at rest or on the way, shape (m, m)."""
    effects = np.hstack([predictor.F[:, :known], predictor.G])
    seen = np.matmul(root, effects.reshape(-1, root.shape[1], effects.shape[1])).reshape(-1, m)
    values, directions = np.linalg.eigh(seen.T @ seen)
    kept = directions[:, values > SILENT * values[-1]]
    return np.asarray(np.eye(m) - kept @ kept.T)


def _from_end(M: Array, p: int) -> Array:
    """Rows of M less the last p rows, sample by sample."""
    return np.asarray(M - np.tile(M[-p:], (M.shape[0] // p, 1)))


def _terminal_rows(rows: _Rows, sized: Sized, outputs: Array, F: Array) -> None:
    """The output part of (6.1c) as equality rows, cut down to independent ones (at most the order of the plant)."""
    part = np.tile(sized.mask > 0, sized.base.L)
    part[: -sized.p * sized.base.tail] = False
    goal = -np.eye(part.size)[part]
    U, sv, _ = np.linalg.svd(outputs[part])
    rank = int(np.count_nonzero(sv > THIN * sv[0])) if sv.size and sv[0] > 0 else 0
    keep, zero = U[:, :rank].T, np.zeros(rank)
    rows.add(keep @ outputs[part], keep @ F[part], keep @ goal, zero, zero)


def _output_rows(rows: _Rows, cost: _Cost, sized: Sized, outputs: Array, F: Array, free: int) -> None:
    """y_min - slack <= y(k) <= y_max + slack, one slack per output over the whole plan, with a price that is exact."""
    p, L = sized.p, sized.base.L
    slack = np.zeros_like(outputs)
    slack[:, free:] = np.tile(np.eye(p), (L, 1))
    far = np.full(p * L, np.inf)
    rows.add(outputs + slack, F, None, np.tile(sized.y_min, L), far)
    rows.add(outputs - slack, F, None, -far, np.tile(sized.y_max, L))
    price = sized.base.slack_weight * max(float(np.trace(sized.Q)) / p, TINY)
    cost.f0[free:] = price
    cost.H[free:, free:] = price * np.eye(p)
