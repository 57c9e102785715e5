# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The monitors beside three tests that a user would try first: verdicts on the same data, and processor time.

    OMP_NUM_THREADS=1 python benchmarks/monitors.py [--plants 300] [--json FILE]

Exits with 1 if the monitors ever prove what does not hold, or fail to prove what does, or if a time exceeds its goal.
"""

import argparse
import itertools
import json
import sys
import time
from collections.abc import Callable, Iterator

import numpy as np

from plant_sim import Planted, random_system
from ros2_deepc.behavior import SlidingFactor, hankel
from ros2_deepc.monitors import Noise, Prior, Verdict, analyze, analyze_factor, analyze_records, indicate
from ros2_deepc.monitors.stream import Stream

EXACT = Noise()
Method = Callable[[np.ndarray, np.ndarray, int, int], bool]


def pencil(u: np.ndarray, y: np.ndarray, L: int) -> tuple[np.ndarray, np.ndarray]:
    """Earlier and later data matrices [H_L(u); H_L(y)] of the paper's Theorem 1 (s = 1)."""
    W = np.vstack([hankel(u, L), hankel(y, L)])
    return W[:, :-1], W[:, 1:]


def holds_at(W0: np.ndarray, W1: np.ndarray, points: np.ndarray, required: int) -> bool:
    return all(np.linalg.matrix_rank(W1 - z * W0) == required for z in points)


def rank_at_random(u: np.ndarray, y: np.ndarray, q: int, L: int) -> bool:
    """matrix_rank of the pencil at 20 random lambda."""
    rng = np.random.Generator(np.random.PCG64(0))
    points = rng.uniform(-1.2, 1.2, 20) + 1j * rng.uniform(-1.2, 1.2, 20)
    return holds_at(*pencil(u, y, L), points, u.shape[1] * L + q)


def identify(u: np.ndarray, y: np.ndarray, q: int, L: int) -> tuple[np.ndarray, np.ndarray]:
    """(A, B) by subspace identification (MOESP): A from the outputs that inputs do not explain, B by least squares."""
    m, p = u.shape[1], y.shape[1]
    R = np.linalg.qr(np.vstack([hankel(u, L + 1), hankel(y, L + 1)]).T, mode="r").T
    a = m * (L + 1)
    observe = np.linalg.svd(R[a:, a:])[0][:, :q]
    A, C = np.linalg.pinv(observe[:-p]) @ observe[p:], observe[:p]
    used = min(len(y), 4 * q + 4 * m)
    state, rows = np.hstack([np.eye(q), np.zeros((q, q * m))]), []  # z(k) as a function of z(0) and B
    inputs = np.arange(q * m).reshape(q, m)
    for k in range(used):
        rows.append(np.hstack([C @ state, np.kron(np.eye(p), u[k])]))
        state = A @ state
        state[np.arange(q)[:, None], q + inputs] += u[k]
    solution = np.linalg.lstsq(np.vstack(rows), y[:used].ravel(), rcond=None)[0]
    return A, solution[q : q + q * m].reshape(q, m)


def rank_at_modes(u: np.ndarray, y: np.ndarray, q: int, L: int) -> bool:
    """matrix_rank of the pencil at the identified eigenvalues."""
    return holds_at(*pencil(u, y, L), np.linalg.eigvals(identify(u, y, q, L)[0]), u.shape[1] * L + q)


def kalman(u: np.ndarray, y: np.ndarray, q: int, L: int) -> bool:
    """matrix_rank of [B, AB, ...] of the identified plant."""
    A, B = identify(u, y, q, L)
    blocks = [B]
    for _ in range(q - 1):
        blocks.append(A @ blocks[-1])
    return bool(np.linalg.matrix_rank(np.hstack(blocks)) == q)


def monitors(u: np.ndarray, y: np.ndarray, q: int, L: int) -> bool:
    """The full certificate."""
    return analyze(u, y, prior=Prior(q=q), L=L).r_controllability.verdict == Verdict.PROVED


METHODS: dict[str, Method] = {
    "analyze (certificate)": monitors,
    "matrix_rank, random lambda": rank_at_random,
    "matrix_rank, identified modes": rank_at_modes,
    "Kalman rank, identified plant": kalman,
}


def record(plant: Planted, T: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    u = rng.uniform(-1, 1, (T, plant.D.shape[1]))
    z, y = rng.standard_normal(plant.q), np.empty((T, len(plant.D)))
    through = plant.D - plant.C2 @ plant.B2
    for k in range(T):
        y[k] = plant.C1 @ z + through @ u[k]
        z = plant.A1 @ z + plant.B1 @ u[k]
    return u, y


def answers(plants: int) -> dict[str, dict[str, float]]:
    """Share of PROVED by kind of plant [%]: only the middle column should be zero."""
    kinds = {"controllable": ([], 0.0), "uncontrollable": ([0.7], 0.0), "1e-6 from uncontrollable": ([0.7], 1e-6)}
    found: dict[str, dict[str, float]] = {name: {} for name in METHODS}
    for code, (kind, (cut, gain)) in enumerate(kinds.items()):
        proved = dict.fromkeys(METHODS, 0)
        for i in range(plants):
            rng = np.random.Generator(np.random.PCG64([code, i]))
            m, p, q = (int(rng.integers(a, b)) for a, b in ((1, 5), (1, 5), (2, 13)))
            plant = random_system(m=m, p=p, q=q, blocks=(1,), uncontrollable=cut, uncontrollable_gain=gain, seed=rng)
            u, y = record(plant, (m + 1) * (q + 2) + m + q + 60, rng)
            for name, method in METHODS.items():
                proved[name] += method(u, y, q, q + 1)
        for name in METHODS:
            found[name][kind] = 100 * proved[name] / plants
    return found


def quick_time(call: Callable[[], object], repeats: int) -> float:
    """Processor time of a call [ms]: the lower quartile, for others may share the machine."""
    call()
    times = []
    for _ in range(repeats):
        start = time.process_time()
        call()
        times.append(time.process_time() - start)
    return 1e3 * float(np.quantile(times, 0.25))


SIZES = ((3, 2, 6, 4, 100, 60), (3, 2, 6, 20, 100, 60), (10, 10, 20, 4, 1000, 5), (10, 10, 20, 30, 1000, 5))


def speed() -> dict[str, dict[str, float]]:
    """Processor time [ms] by size (m, p, q, L, T)."""
    table: dict[str, dict[str, float]] = {}
    for m, p, q, L, T, repeats in SIZES:
        rng = np.random.Generator(np.random.PCG64(q))
        plant = random_system(m=m, p=p, q=q, blocks=(1,), seed=rng)
        u, y = record(plant, T + 1, rng)
        calls: dict[str, Callable[[], object]] = {
            name: (lambda method=method: method(u, y, q, L))  # noqa: B023
            for name, method in METHODS.items()
            if T <= 100 or "matrix_rank" not in name
        }
        calls["indicate (modes only)"] = lambda: indicate(u, y, prior=Prior(q=q), L=L)  # noqa: B023
        table[f"({m},{p},{q},{L},{T})"] = {name: quick_time(call, repeats) for name, call in calls.items()}
    return table


def stream() -> dict[str, dict[str, float]]:
    """On a stream, (m3 p2 q6 L20): a push, indicator and certificate from the followed factor, live reports [ms]."""
    rng = np.random.Generator(np.random.PCG64(6))
    plant = random_system(m=3, p=2, q=6, blocks=(1,), seed=rng)
    table = {}
    for T in (100, 400, 1600):
        u, y = record(plant, 3 * T, rng)
        w = np.hstack([u, y])
        sliding = SlidingFactor(channels=5, blocks=21, columns=T)
        for sample in w[:T]:
            sliding.push(sample)
        start = time.process_time()
        for sample in w[T:]:
            sliding.push(sample)
        push = 1e3 * (time.process_time() - start) / (2 * T)

        def certificate(sliding: SlidingFactor = sliding) -> object:
            return analyze_factor(sliding.factor().T, 3, 2, sliding.held, prior=Prior(q=6), L=20)

        follow, samples = Stream(3, 2, Prior(q=6), 20, T), itertools.cycle(zip(u[T:], y[T:], strict=True))
        follow.refill([(u[:T], y[:T])])

        def sample(follow: Stream = follow, samples: Iterator[tuple[np.ndarray, np.ndarray]] = samples) -> object:
            follow.push(*next(samples))
            return follow.indicate(EXACT)

        records = [(u[:T], y[:T])]
        table[f"T = {T}"] = {
            "push": push,
            "push and indicator": quick_time(sample, 200),
            "certificate from factor": quick_time(certificate, 20),
            "certificate from records": quick_time(
                lambda records=records: analyze_records(records, prior=Prior(q=6), L=20),  # type: ignore[misc]
                20,
            ),
        }
    return table


GOALS = {
    ("speed", "(3,2,6,20,100)", "analyze (certificate)"): 8.0,
    ("speed", "(3,2,6,20,100)", "indicate (modes only)"): 1.0,
    ("speed", "(10,10,20,30,1000)", "analyze (certificate)"): 130.0,
    ("stream", "T = 100", "push"): 0.1,
    ("stream", "T = 1600", "push"): 0.1,
    ("stream", "T = 100", "push and indicator"): 1.0,
    ("stream", "T = 1600", "push and indicator"): 1.0,
}
"""Longest processor time [ms] by table, row and column."""


def show(title: str, table: dict[str, dict[str, float]], form: str) -> None:
    columns = list(dict.fromkeys(c for row in table.values() for c in row))
    print(f"{title:32}" + "".join(f"{c:>32}" for c in columns))
    for name, row in table.items():
        print(f"{name:32}" + "".join(f"{format(row[c], form) if c in row else '-':>32}" for c in columns))
    print()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--plants", type=int, default=300, help="plants of each kind")
    parser.add_argument("--json", help="file for the numbers")
    options = parser.parse_args()
    results = {"answers": answers(options.plants), "speed": speed(), "stream": stream()}
    show("PROVED [%]", results["answers"], ".1f")
    by_method: dict[str, dict[str, float]] = {}
    for size, row in results["speed"].items():
        for name, value in row.items():
            by_method.setdefault(name, {})[size] = value
    show("processor time [ms] (m,p,q,L,T)", by_method, ".2f")
    show("sliding factor [ms]", results["stream"], ".3f")
    if options.json:
        with open(options.json, "w", encoding="utf-8") as file:
            json.dump(results, file, indent=1)
    ours = results["answers"]["analyze (certificate)"]
    right = ours["uncontrollable"] == 0 and ours["controllable"] == 100
    late = [
        f"{' '.join(key)}: {results[key[0]][key[1]][key[2]]:.2f} ms, goal {goal:g} ms"
        for key, goal in GOALS.items()
        if results[key[0]][key[1]][key[2]] > goal
    ]
    for line in late:
        print(f"too slow: {line}", file=sys.stderr)
    return 0 if right and not late else 1


if __name__ == "__main__":
    sys.exit(main())
