# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""A DeePC step beside the alternatives a user would pick: CPU time, accuracy against the true model, failed steps.

Everyone controls the same seeded plant over the same samples, box constraints, set-points that change every 25 steps.
"offline": the data are fixed. "online": the window takes every new sample, with a little dither; update, rebuild and
solution are all in the step. Times are CPU times of whole steps. The contenders take turns in several rounds: shown are
the medians over the rounds of each round's median and 99th percentile, and of the ratio to the baseline in the same
round. "command" is the part from sample in to input out when the rest is prepared in the pause. Errors are those of the
first input against predictive control on the true model.

Baseline: problem (6.1) typed into cvxpy with OSQP. cvxpy, direct-data-driven-mpc and deepctools are optional
(pip install cvxpy direct-data-driven-mpc deepctools); what is missing is left out.
"""

import argparse
import contextlib
import importlib.util
import io
import json
import sys
import time
import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from ros2_deepc.behavior import hankel
from ros2_deepc.control import DeepcController, DeepcSettings
from ros2_deepc.control.qp import Daqp

N, L, Q, R, DITHER = 6, 14, 5.0, 1.0, 0.1
ROUNDS = 5
BUDGET = 120.0  # CPU seconds of steps that one contender may take in one round
LARGE = 1000  # rows of the Hankel matrix from which on the alternatives take a minute a step: one round, and not all
SPOILT = 2.0  # other work on the machine costs short steps more than long ones
BASELINES = ("cvxpy+osqp", "cvxpy+osqp, rebuilt")
FACTORS = {"offline": {100: 30, 400: 60, 1600: 200}, "online": {100: 20, 400: 40, 1600: 130}}  # against cvxpy, at T
OURS = ("ours, osqp", "ours, daqp")
ALONE = "ours, osqp without its law"
MEDIANS = ("median_ms", "p99_ms", "command_p99_ms", "iterated_ms")


class Plant:
    """A seeded stable plant of order q and MPC on it: the truth."""

    def __init__(self, m, p, q, seed=3):
        rng = np.random.Generator(np.random.PCG64(seed))
        A = rng.normal(size=(q, q))
        self.A = 0.9 * A / np.abs(np.linalg.eigvals(A)).max()
        self.B, self.C = rng.normal(size=(q, m)) / np.sqrt(q), rng.normal(size=(p, q)) / np.sqrt(q)
        self.m, self.p, self.x = m, p, rng.normal(size=q)
        powers = [self.C]
        for _ in range(L):
            powers.append(powers[-1] @ self.A)
        self.O = np.vstack(powers[:L])
        self.G = np.zeros((p * L, m * L))
        for i in range(L):
            for j in range(i):
                self.G[i * p : (i + 1) * p, j * m : (j + 1) * m] = powers[i - 1 - j] @ self.B
        self.solver = Daqp()
        box = np.ones(m * L)
        self.solver.load(2 * (Q * self.G.T @ self.G + R * np.eye(m * L)), np.zeros((0, m * L)), -box, box)
        self.box = (-box, box)

    def move(self, u):
        """The output now; then the input acts on the state."""
        y = self.C @ self.x
        self.x = self.A @ self.x + self.B @ u
        return y

    def best(self, goal):
        """First input of MPC from the true state."""
        f = 2 * Q * self.G.T @ (self.O @ self.x - np.tile(goal, L))
        return self.solver.solve(f, *self.box).x[: self.m]


class Case(NamedTuple):
    """One cell of the comparison."""

    m: int
    p: int
    q: int
    T: int
    online: bool


class Ours:
    """The controller of this project: observe and step, then prepare."""

    def __init__(self, case, solver, *, law=True):
        settings = DeepcSettings(
            N=N, L=L, T=case.T, q=case.q, Q=Q, R=R, u_min=-1.0, u_max=1.0, terminal="none", solver=solver,
            data_policy="sliding" if case.online else "fixed",
        )  # fmt: skip
        self.controller, self.law = DeepcController(case.m, case.p, settings), law

    def start(self, u, y):
        """Takes the record before the loop and makes the first step."""
        for a, b in zip(u, y, strict=True):
            self.controller.observe(a, b)
        self.controller.step(np.zeros(y.shape[1]))
        if not self.law:
            self.controller._planner._main.solver._learns = False
        self.controller.prepare()

    def step(self, u, y, goal):
        """First input after the newest sample; None if the step failed."""
        begin = time.process_time()
        self.controller.observe(u[-1], y[-1])
        answer = self.controller.step(goal)
        self.command, self.solver = time.process_time() - begin, answer.solver
        self.controller.prepare()
        return answer.u if answer.status.solved else None


class Cvxpy:
    """(6.1) typed in. Offline: past and set-point are parameters. Online: rebuilt, or the Hankel matrix a parameter."""

    def __init__(self, case, hankel_parameter=False):
        import cvxpy as cp

        self.cp, self.online, self.T, self.problem = cp, case.online, case.T, None
        rows = (case.m + case.p) * (N + L)
        self.H = cp.Parameter((rows, case.T - N - L + 1)) if hankel_parameter else None

    def start(self, u, y):
        """Takes the record before the loop and makes the first step."""
        self.data = (u, y)
        self.step(u, y, np.zeros(y.shape[1]))

    def build(self, u, y):
        """The problem for this data, or new values for its parameters."""
        cp, (m, p) = self.cp, (u.shape[1], y.shape[1])
        H = np.vstack([hankel(u[-self.T :], N + L), hankel(y[-self.T :], N + L)])
        if self.H is not None:
            self.H.value = H
            if self.problem is not None:
                return
            H = self.H
        self.past, self.goal = cp.Parameter((m + p) * N), cp.Parameter(p * L)
        alpha, self.u, self.y = cp.Variable(H.shape[1]), cp.Variable(m * L), cp.Variable(p * L)
        known = [H[: m * N], H[m * (N + L) : m * (N + L) + p * N]]
        rows = [
            known[0] @ alpha == self.past[: m * N],
            known[1] @ alpha == self.past[m * N :],
            H[m * N : m * (N + L)] @ alpha == self.u,
            H[m * (N + L) + p * N :] @ alpha == self.y,
            self.u >= -1,
            self.u <= 1,
        ]
        cost = Q * cp.sum_squares(self.y - self.goal) + R * cp.sum_squares(self.u)
        self.problem = cp.Problem(cp.Minimize(cost), rows)

    def step(self, u, y, goal):
        """First input after the newest sample; None if the step failed."""
        if self.problem is None or self.online:
            self.build(*((u, y) if self.online else self.data))
        self.past.value = np.concatenate([u[-N:].ravel(), y[-N:].ravel()])
        self.goal.value = np.tile(goal, L)
        self.problem.solve(solver=self.cp.OSQP)
        return self.u.value[: u.shape[1]] if self.problem.status == "optimal" else None


class DirectDdmpc:
    """direct-data-driven-mpc: no online update, so online makes a new controller each step."""

    def __init__(self, case):
        self.online, self.T, self.controller = case.online, case.T, None

    def start(self, u, y):
        """Takes the record before the loop and makes the first step."""
        self.step(u, y, np.zeros(y.shape[1]))

    def step(self, u, y, goal):
        """First input after the newest sample; None if the step failed."""
        from direct_data_driven_mpc import LTIDataDrivenMPCController

        m, p, column = u.shape[1], y.shape[1], np.asarray(goal)[:, None]
        if self.controller is None or self.online:
            self.controller = LTIDataDrivenMPCController(
                N, m, p, u[-self.T :], y[-self.T :], L, Q * np.eye(p * L), R * np.eye(m * L), np.zeros((m, 1)), column,
                U=np.tile([-1.0, 1.0], (m, 1)), use_terminal_constraints=False,
            )  # fmt: skip
        self.controller.set_input_output_setpoints(np.zeros((m, 1)), column)
        self.controller.set_past_input_output_data(u[-N:].reshape(-1, 1), y[-N:].reshape(-1, 1))
        self.controller.update_and_solve_data_driven_mpc()
        return np.ravel(self.controller.get_optimal_control_input_at_step(0))


class Deepctools:
    """deepctools with its rank truncation, its fastest form (CasADi, IPOPT); a new object each step online."""

    def __init__(self, case):
        self.online, self.T, self.tool = case.online, case.T, None

    def start(self, u, y):
        """Takes the record before the loop and makes the first step."""
        self.step(u, y, np.zeros(y.shape[1]))

    def step(self, u, y, goal):
        """First input after the newest sample; None if the step failed."""
        from deepctools import deepctools

        m, p = u.shape[1], y.shape[1]
        if self.tool is None or self.online:
            c, bounds = self.T - N - L + 1, np.ones(m)
            with contextlib.redirect_stdout(io.StringIO()):
                self.tool = deepctools(
                    m, p, self.T, N, L, u[-self.T :], y[-self.T :], Q * np.eye(p * L), R * np.eye(m * L),
                    lambda_g=1e-9 * np.eye(c), sp_change=True, ineqconidx={"u": list(range(m))},
                    ineqconbd={"lbu": -bounds, "ubu": bounds}, svd=True,
                )  # fmt: skip
                self.tool.init_DeePCsolver("u", {"ipopt.print_level": 0, "print_time": 0, "ipopt.sb": "yes"})
        past = (u[-N:].reshape(-1, 1), y[-N:].reshape(-1, 1))
        return self.tool.solver_step(*past, np.zeros((m * L, 1)), np.tile(goal, L)[:, None])[0][:m]


def contenders(case):
    """Name, constructor and steps in a round."""
    large = (case.m + case.p) * (N + L) >= LARGE
    yield OURS[0], lambda: Ours(case, "osqp"), 150
    yield OURS[1], lambda: Ours(case, "daqp"), 150
    if not case.online:  # with a window that moves, every step has a program of its own, and no law
        yield ALONE, lambda: Ours(case, "osqp", law=False), 150
    if importlib.util.find_spec("cvxpy"):
        yield "cvxpy+osqp" + (", rebuilt" if case.online else ""), lambda: Cvxpy(case), 75
        if case.online and not large:
            yield "cvxpy+osqp, Hankel parameter", lambda: Cvxpy(case, hankel_parameter=True), 15
    if importlib.util.find_spec("direct_data_driven_mpc") and not large:
        yield "direct-data-driven-mpc", lambda: DirectDdmpc(case), 6
    if importlib.util.find_spec("deepctools") and case.m + case.p <= 5:  # minutes a step on larger plants
        yield "deepctools (svd)", lambda: Deepctools(case), 3


def run(make, case, steps):
    """Closed loop of one contender; a failed step gets the true input."""
    m, p, q, T, online = case
    plant, rng = Plant(m, p, q), np.random.Generator(np.random.PCG64(11))
    u, y = np.empty((T + steps, m)), np.empty((T + steps, p))
    for k in range(T):
        u[k] = rng.uniform(-1, 1, m)
        y[k] = plant.move(u[k])
    contender = make()
    contender.start(u[:T], y[:T])
    times, commands, errors, failed, iterated = [], [], [], 0, []
    answer = plant.best(np.zeros(p))
    for k in range(steps):
        goal = [np.zeros(p), np.full(p, 0.8), np.linspace(-3, 3, p)][k // 25 % 3]
        u[T + k] = np.clip(answer + (DITHER * rng.uniform(-1, 1, m) if online else 0.0), -1, 1)
        y[T + k] = plant.move(u[T + k])
        best = plant.best(goal)
        begin = time.process_time()
        try:
            answer = contender.step(u[: T + k + 1], y[: T + k + 1], goal)
        except (ValueError, ArithmeticError, RuntimeError):
            answer = None
        times.append(time.process_time() - begin)
        commands.append(getattr(contender, "command", times[-1]))
        iterated += [times[-1]] if getattr(contender, "solver", "") == "osqp" else []
        if answer is None or not np.isfinite(answer).all() or np.abs(answer - best).max() > 0.1:
            answer, failed = best, failed + 1
        else:
            errors.append(np.abs(answer - best).max())
        if sum(times) > BUDGET:
            break
    ms = 1e3 * np.array(times)
    return {
        "median_ms": float(np.median(ms)),
        "p99_ms": float(np.quantile(ms, 0.99)),
        "command_p99_ms": float(1e3 * np.quantile(commands, 0.99)),
        "iterated_ms": float(1e3 * np.median(iterated)) if iterated else float("nan"),
        "iterated": len(iterated),
        "error": float(np.max(errors, initial=0.0)),
        "failed": failed,
        "steps": len(times),
    }


def compare(case, share):
    """All contenders at one size, in turns."""
    rounds, reasons = {}, {}
    for turn in range(1 if (case.m + case.p) * (N + L) >= LARGE else ROUNDS):
        for name, make, steps in contenders(case):
            if name in reasons:
                continue
            if sys.stdout.isatty():
                print(f"  round {turn + 1}: {name} ...\033[K", end="\r", flush=True)
            try:
                row = run(make, case, max(3, int(share * steps)))
            except Exception as error:
                reasons[name] = f"{type(error).__name__}: {str(error).splitlines()[0][:80]}"
                continue
            rounds.setdefault(name, []).append(row)
    for name, reason in reasons.items():
        print(f"  {name:30s} {reason}")
    base = next((rounds[name] for name in rounds if name in BASELINES), [])
    rows = {name: summary(turns, base) for name, turns in rounds.items()}
    for name, row in rows.items():
        times = " ".join(f"{row[key]:9.3f}" for key in ("median_ms", "p99_ms", "command_p99_ms"))
        print(f"  {name:30s} {times} {row['error']:8.0e} {row['failed']:4d}/{row['steps']:<4d}", flush=True)
    if (row := rows[OURS[0]])["iterated"] < row["steps"]:
        print(f"  {OURS[0]}: OSQP in {row['iterated']} of {row['steps']} steps, {row['iterated_ms']:.3f} ms each")
    if base:
        ours = [name for name in (*OURS, ALONE) if name in rows]
        print("  times faster than cvxpy+osqp: " + ", ".join(f"{n} {rows[n]['times_faster']:.0f}" for n in ours))
    return rows


def summary(turns, base):
    """Medians over the rounds, the worst error and all failures; the ratio to the baseline is taken round by round."""
    ratios = [b["median_ms"] / t["median_ms"] for b, t in zip(base, turns, strict=False)]
    return {
        **{key: float(np.median([t[key] for t in turns])) for key in MEDIANS},
        "times_faster": float(np.median(ratios)) if ratios else float("nan"),
        "error": max(t["error"] for t in turns),
        "failed": sum(t["failed"] for t in turns),
        "iterated": sum(t["iterated"] for t in turns),
        "steps": sum(t["steps"] for t in turns),
        "rounds": len(turns),
    }


def goals(results):
    """What an idle machine of today is to reach, beside what this run has reached: CPU time, no allowance made."""
    print("goals                            measured         wanted")

    def line(text, measured, wanted, *, ms=True):
        met = measured <= wanted if ms else measured >= wanted
        unit = " ms" if ms else "x "
        print(f"  {text:28s} {measured:10.3g}{unit} {wanted:10.3g}{unit}  {'met' if met else 'MISSED'}")

    for mode, limits in (("offline", (0.15, 0.04)), ("online", (0.8, 0.5))):
        for T, factor in FACTORS[mode].items():
            rows = results[f"{mode} T={T}"]
            for name, limit in zip(OURS, limits, strict=True):
                line(f"{mode} T={T} {name.split()[1]}", rows[name]["median_ms"], limit)
                line("  sample to command, p99", rows[name]["command_p99_ms"], 0.3)
            if row := rows.get(ALONE):
                line("  osqp alone", row["median_ms"], limits[0])
            if rows.keys() & set(BASELINES):
                line("  osqp against cvxpy+osqp", rows[OURS[0]]["times_faster"], factor, ms=False)
    for size, limit in (("T=400 m=10 p=10 q=20", 8.0), ("T=1600 m=50 p=50 q=60", 400.0)):
        for name in OURS:
            if row := results.get(f"online {size}", {}).get(name):
                line(f"{size} {name.split()[1]}", row["median_ms"], limit)


def judge(results):
    """Claims that hold on any machine: accuracy, and ratios up to what a busy machine may spoil. Returns what fails."""
    broken = []
    for mode, factors in FACTORS.items():
        for T, factor in factors.items():
            rows = results[f"{mode} T={T}"]
            for name, limit in zip(OURS, (1e-4, 1e-9), strict=True):
                row = rows[name]
                if row["failed"] or row["error"] > limit:
                    broken.append(f"{mode} T={T} {name}: error {row['error']:.0e}, {row['failed']} failed")
                if row["times_faster"] * SPOILT < factor:  # never, if there is no baseline: NaN
                    broken.append(f"{mode} T={T} {name}: {row['times_faster']:.0f}, not {factor} times faster")
    for name in OURS:
        times = [results[f"online T={T}"][name]["median_ms"] for T in (100, 400, 1600)]
        if max(times) > 1.5 * SPOILT * min(times):
            broken.append(
                f"online {name}: {max(times) / min(times):.2f} times slower at one window length than at another"
            )
    return broken


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--share", type=float, default=1.0, help="share of the steps to run")
    parser.add_argument("--large", action="store_true", help="also m = p = 50, T = 1600 (minutes)")
    parser.add_argument("--json", type=Path, help="write the figures there")
    args = parser.parse_args()
    warnings.filterwarnings("ignore")
    results = {}
    with threadpool_limits(1):
        cases = [Case(3, 2, 6, T, online) for online in (False, True) for T in (100, 400, 1600)]
        cases.append(Case(10, 10, 20, 400, True))
        if args.large:
            cases.append(Case(50, 50, 60, 1600, True))
        for case in cases:
            size = "" if case.m == 3 else f" m={case.m} p={case.p} q={case.q}"
            title = f"{'online' if case.online else 'offline'} T={case.T}{size}"
            print(f"{title:32s}  CPU ms: median       p99   command    error  failed", flush=True)
            results[title] = compare(case, args.share * (0.2 if size else 1))
    if args.json:
        args.json.write_text(json.dumps(results, indent=1))
    goals(results)
    if broken := judge(results):
        sys.exit("claims that do not hold:\n  " + "\n  ".join(broken))


if __name__ == "__main__":
    main()
