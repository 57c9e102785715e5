# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Solvers of dense quadratic programs behind one small interface, with every answer checked."""

import math
from typing import Any, NamedTuple, Protocol

import daqp
import numpy as np
import osqp.ext_builtin as osqp  # the solver itself: the wrapper around it costs as much again as a short solve
from scipy.sparse import csc_matrix

from ros2_deepc.behavior.hankel import Array

from .active_set import ActiveSet
from .problem import FAR, Condensed

ACCURACY = 3e-5  # aimed at in x: residuals tell of errors up to the condition of H times as large
EPS = (2e-10, 1e-6)  # bounds of the tolerance that follows from it
EXACT = 1e-9  # tolerance of DAQP's rows; its own, 1e-6, shows in x
STEP = 1 / 3  # of sqrt(least * largest eigenvalue of H): the step size at which box programs take fewest iterations
SOLVED = osqp.osqp_status_type.OSQP_SOLVED.value


class Answer(NamedTuple):
    """What a solver says.

    Attributes:
        x: point, shape (n,).
        y: multipliers of the rows [I; A], shape (n + rows,); positive where an upper bound pushes.
        solved: whether the solver claims optimality.
        iterations: iterations made.
        status: the solver's own word.
        solver: its name.
    """

    x: Array
    y: Array
    solved: bool
    iterations: int
    status: str
    solver: str = ""


class QpSolver(Protocol):
    """min x'Hx/2 + f'x subject to lower <= [I; A] x <= upper; H and A stay for many solves."""

    name: str

    def load(self, H: Array, A: Array, lower: Array, upper: Array) -> None:
        """Takes new matrices H (n, n), symmetric positive semidefinite, and A (rows, n), and first bounds for them."""

    def solve(self, f: Array, lower: Array, upper: Array) -> Answer:
        """Solves for f (n,) and bounds (n + rows,), first the box, then the rows of A; infinite bounds are allowed."""


class Osqp:
    """OSQP: operator splitting, set up once with a fixed pattern, then updated; bounded by iterations, not time."""

    name = "osqp"

    def __init__(self) -> None:
        self._model: Any = None
        self._shape = (-1, -1)
        self._upper = np.empty(0, dtype=np.intp)
        self._bounds: tuple[Array, Array] | None = None

    def load(self, H: Array, A: Array, lower: Array, upper: Array) -> None:
        """See `QpSolver.load`; a change of shape sets up anew."""
        n, rows = H.shape[0], A.shape[0]
        if self._shape == (n, rows):
            self._model.update_data_mat(
                P_x=H.ravel()[self._upper], P_i=None, A_x=_with_identity(A) if rows else None, A_i=None
            )
            return
        row, column = np.tril_indices(n)
        self._upper = column * n + row  # upper triangle of H, column by column
        P = csc_matrix((H.ravel()[self._upper], column, np.append(0, np.cumsum(np.arange(1, n + 1)))), shape=(n, n))
        indices = np.hstack([np.arange(n)[:, None], np.tile(n + np.arange(rows), (n, 1))]).ravel()
        AI = csc_matrix((_with_identity(A), indices, (rows + 1) * np.arange(n + 1)), shape=(n + rows, n))
        bounds = (np.maximum(lower, -FAR), np.minimum(upper, FAR))
        self._model = osqp.OSQPSolver(
            osqp.CSC(P), np.zeros(n), osqp.CSC(AI), *bounds, n + rows, n, _osqp_settings(H, boxed=not rows)
        )
        self._shape, self._bounds = (n, rows), None

    def solve(self, f: Array, lower: Array, upper: Array) -> Answer:
        """See `QpSolver.solve`."""
        model = self._model
        if self._bounds is not None and self._bounds[0] is lower and self._bounds[1] is upper:
            model.update_data_vec(q=f, l=None, u=None)
        else:
            model.update_data_vec(q=f, l=np.maximum(lower, -FAR), u=np.minimum(upper, FAR))
            self._bounds = (lower, upper)
        model.solve()
        info, solution = model.info, model.solution
        solved = info.status_val == SOLVED
        if not solved:
            model.warm_start(x=np.zeros(f.size), y=np.zeros(lower.size))  # a bad end is a bad start
        return Answer(solution.x, solution.y, solved, info.iter, "" if solved else info.status, self.name)


def _osqp_settings(H: Array, *, boxed: bool) -> Any:
    """Settings for a program; of a box alone, OSQP needs no scaling but the step size that its H asks for."""
    settings = osqp.OSQPSettings()
    osqp.osqp_set_default_settings(settings)
    settings.verbose, settings.polishing, settings.check_termination = False, False, 10
    settings.max_iter, settings.check_dualgap = 2000, False  # every answer is checked here
    eigenvalues = np.linalg.eigvalsh(H)
    largest = max(eigenvalues[-1], EPS[0])
    least = max(eigenvalues[0], EPS[0] * largest)
    settings.eps_abs = settings.eps_rel = min(max(ACCURACY * least / largest, EPS[0]), EPS[1])
    if boxed:
        settings.scaling, settings.rho = 0, STEP * math.sqrt(least * largest)
        settings.check_termination, settings.alpha = 5, 1.5
    else:
        settings.alpha, settings.adaptive_rho_tolerance = 1.8, 2.0
    return settings


class Daqp:
    """DAQP: dual active set, exact to rounding, warm started with the last active set."""

    name = "daqp"

    def __init__(self) -> None:
        self._model: Any = None
        self._problem = (np.empty((0, 0)), np.empty((0, 0)))
        self._sense = np.empty(0, dtype=np.int32)
        self._seen: tuple[Array, Array] | None = None  # bounds last seen, and what DAQP was given for them
        self._bounds = (np.empty(0), np.empty(0))

    def load(self, H: Array, A: Array, lower: Array, upper: Array) -> None:
        """See `QpSolver.load`; a change of shape or of the equality rows sets up anew."""
        before, self._problem = self._problem, (H, A)
        self._same(lower, upper)
        if self._model is not None and before[0].shape == H.shape and before[1].shape == A.shape:
            low, high = self._bounds
            if self._model.update(H=H, A=A if A.shape[0] else None, bupper=high, blower=low) == 0:
                return
        self._set_up()

    def solve(self, f: Array, lower: Array, upper: Array) -> Answer:
        """See `QpSolver.solve`."""
        same = self._same(lower, upper)
        if self._model is None:
            self._set_up()
        if self._model is None:
            return Answer(np.full(f.size, np.nan), np.zeros(lower.size), False, 0, "setup failed")
        if same:
            self._model.update(f=f)
        else:
            self._model.update(f=f, bupper=self._bounds[1], blower=self._bounds[0])
        x, _, flag, info = self._model.solve()
        if flag != 1:
            self._model = None  # a bad end is a bad start
        return Answer(x, info["lam"], flag == 1, info["iterations"], f"exit flag {flag}", self.name)

    def _same(self, lower: Array, upper: Array) -> bool:
        """Whether these bounds are the last ones; otherwise takes them, infinities in DAQP's way."""
        if self._seen is not None and self._seen[0] is lower and self._seen[1] is upper:
            return True
        self._seen = (lower, upper)
        self._bounds = (np.maximum(lower, -FAR), np.minimum(upper, FAR))
        sense = np.where(self._bounds[0] == self._bounds[1], 5, 0).astype(np.int32)  # equalities are active for good
        if not np.array_equal(sense, self._sense):
            self._sense, self._model = sense, None
        return False

    def _set_up(self) -> None:
        """A fresh model."""
        H, A = self._problem
        low, high = self._bounds
        self._model = daqp.Model()
        flag, _ = self._model.setup(H, np.zeros(H.shape[0]), A, high, low, self._sense)
        self._model.settings = {**self._model.settings, "primal_tol": EXACT}
        if flag < 0:
            self._model = None


def _with_identity(A: Array) -> Array:
    """Entries of [I; A], column by column: one of the identity, then a column of A."""
    return np.vstack([np.ones(A.shape[1]), A]).T.ravel()


def make_solver(name: str) -> QpSolver:
    """A fresh solver by name, "osqp" or "daqp"."""
    return Osqp() if name == "osqp" else Daqp()


def fault(
    answer: Answer,
    H: Array,
    f: Array,
    A: Array,
    lower: Array,
    upper: Array,
    steepest: float = 0.0,
    tolerance: float = 0.0,
) -> str:
    """Checks an answer against the optimality conditions; empty if they hold, else what is wrong with it.

    Tolerances are relative to the size of the terms that are compared.

    Args:
        answer: to be checked.
        H: as in `QpSolver`, like f, A, lower and upper.
        f: shape (n,).
        A: shape (rows, n).
        lower: shape (n + rows,).
        upper: shape (n + rows,).
        steepest: largest diagonal entry of H; looked up if 0.
        tolerance: 0 for what fits a solver that iterates, 1e-5 with a box alone, otherwise 1e-4.
    """
    if not answer.solved:
        return answer.status
    if not A.shape[0]:
        steepest = steepest or float(H.diagonal().max())
        return _box_fault(answer.x, H, f, lower, upper, steepest, tolerance or 1e-5)
    tolerance = tolerance or 1e-4
    x, y, n = answer.x, answer.y, answer.x.size
    if not math.isfinite(x.dot(x) + y.dot(y)):
        return "not finite"
    z, Ay = np.concatenate([x, A.dot(x)]), y[:n] + A.T.dot(y[n:])
    excess = float(np.maximum(lower - z, z - upper).max())
    if excess > tolerance * max(1.0, _largest(z)):
        return f"constraints violated by {excess:.1e}"
    Hx = H.dot(x)
    forces = max(1.0, _largest(f), _largest(Ay), _largest(Hx))
    slope = _largest(Hx + f + Ay)
    if slope > tolerance * forces:
        return f"not stationary by {slope:.1e}"
    # a multiplier may push only where its bound is met
    idle = np.maximum(y, 0.0) * np.minimum(upper - z, 1.0) - np.minimum(y, 0.0) * np.minimum(z - lower, 1.0)
    if _largest(idle) > tolerance * forces * max(1.0, _largest(z)):
        return f"multipliers off their bounds by {_largest(idle):.1e}"
    return ""


def _box_fault(x: Array, H: Array, f: Array, lower: Array, upper: Array, steepest: float, tolerance: float) -> str:
    """The same for a box alone: x is optimal if and only if a projected gradient step leads back to it.

    This covers bounds, stationarity and the signs of multipliers at once, and any NaN.
    """
    step: Array = H.dot(x)  # dot and in place: this is run at every step, between sample and command
    step += f
    step *= -1.0 / steepest
    step += x
    np.maximum(step, lower, out=step)
    np.minimum(step, upper, out=step)
    step -= x
    size = float(step.dot(step))
    if size <= tolerance**2 * (1.0 + float(x.dot(x))):
        return ""
    return f"not optimal: a projected gradient step moves by {math.sqrt(size):.1e}"


def _largest(v: Array) -> float:
    """Largest absolute entry."""
    return float(max(v.max(), -v.min()))


class CheckedSolver:
    """Two solvers in turn: the second one when the first one's answer does not stand up to the check.

    Before OSQP is asked, the law of the last active set is, if that set has stayed the same for two samples of the same
    program: exact, and much faster. Its answers are checked as strictly as rounding allows.

    Args:
        first: name of the solver to try first.
    """

    def __init__(self, first: str) -> None:
        self.solvers = (make_solver(first), make_solver("daqp" if first == "osqp" else "osqp"))
        self._loaded = [False, False]
        self._program: Condensed | None = None
        self._steepest = 0.0
        self._learns = first == "osqp"  # DAQP starts from the last active set by itself
        self._forget()

    def _forget(self) -> None:
        self._law: ActiveSet | None = None
        self._key = b""  # of the last active set
        self._fresh: tuple[Array, ...] | None = None  # solution and bounds that settle has not seen

    def load(self, program: Condensed) -> None:
        """Takes a new program; the second solver gets it when it is needed."""
        self._program, self._steepest = program, max(float(program.H.diagonal().max()), EPS[0])
        self.solvers[0].load(program.H, program.A, program.lower, program.upper)
        self._loaded = [True, False]
        self._forget()

    def settle(self) -> None:
        """Draws on the last answer for the next ones; best called once the command is out."""
        if self._fresh is None or self._program is None:
            return
        (x, y, lower, upper), self._fresh = self._fresh, None
        newest = ActiveSet(x, y, self._program.A, lower, upper)
        before, self._key = self._key, newest.key
        if newest.key == before:
            self._law = newest if newest.build(self._program.H, self._program.A) else None

    def solve(self, f: Array, lower: Array, upper: Array, *, exactly: bool = False) -> tuple[Answer | None, int, str]:
        """Solves and checks.

        Args:
            f: shape (n,).
            lower: shape (n + rows,).
            upper: shape (n + rows,).
            exactly: by DAQP alone, which is sure about programs without a solution.

        Returns:
            The answer that passed the check, or None; how many solvers failed before; what they failed on.
        """
        program = self._program
        assert program is not None  # load comes first
        H, A = program.H, program.A
        if self._law is not None:
            answer = Answer(*self._law.solve(f, lower, upper), True, 0, "", "active set")
            if not fault(answer, H, f, A, lower, upper, self._steepest, EXACT):
                return answer, 0, ""
        complaints: list[str] = []
        for i, solver in enumerate(self.solvers):
            if exactly and solver.name != "daqp":
                continue
            if not self._loaded[i]:
                solver.load(H, A, program.lower, program.upper)
                self._loaded[i] = True
            try:
                answer = solver.solve(f, lower, upper)
                complaint = fault(answer, H, f, A, lower, upper, self._steepest)
            except Exception as error:  # whatever a solver throws, the plant needs an input
                complaint = f"{type(error).__name__}: {error}"
                self._loaded[i] = False
            if not complaint:
                if self._learns:
                    self._fresh = (answer.x, answer.y, lower, upper)
                return answer, len(complaints), "; ".join(complaints)
            complaints.append(f"{solver.name}: {complaint}")
        return None, len(complaints), "; ".join(complaints)
