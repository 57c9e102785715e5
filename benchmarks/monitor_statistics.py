# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""What the monitors claim, counted over thousands of random plants whose truth is planted.

    python benchmarks/monitor_statistics.py             # all tables, minutes
    python benchmarks/monitor_statistics.py --share 0.1 # a tenth of the plants
    python benchmarks/monitor_statistics.py near        # one table

Exits with 1 if a claim is broken; each broken claim is printed. Rates under noise: `noise_rates.py`.
"""

import argparse
import itertools
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from plant_sim import Planted, random_system
from ros2_deepc.behavior import hankel
from ros2_deepc.monitors import Prior, Verdict, analyze, estimate_structure
from ros2_deepc.monitors.compress import compress
from ros2_deepc.monitors.noise import gaussian_norm

PROVED = Verdict.PROVED


class Table(NamedTuple):
    """Lines to print and claims that turned out broken."""

    lines: list[str]
    broken: list[str]


def generator(*key: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(list(key)))


def respond(plant: Planted, u: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Outputs of the planted canonical form: no rounding from the mixing with S and P; u is s-1 samples longer."""
    P = [-plant.C2 @ np.linalg.matrix_power(plant.N, i) @ plant.B2 for i in range(plant.s)]
    P[0] = P[0] + plant.D
    y = np.empty((len(u) - plant.s + 1, len(plant.D)))
    for k in range(len(y)):
        y[k] = plant.C1 @ z + sum(P[i] @ u[k + i] for i in range(plant.s))
        z = plant.A1 @ z + plant.B1 @ u[k]
    return y


def record(plant: Planted, K: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    u = rng.uniform(-1, 1, (K + plant.s - 1, plant.D.shape[1]))
    return u, respond(plant, u, rng.standard_normal(plant.q))


def lost(rng: np.random.Generator, room: int) -> list[complex]:
    """One or two modes to cut: real, equal in modulus to the others, or a complex pair."""
    if room >= 2 and rng.random() < 0.4:
        return [complex(rng.uniform(0.3, 1.0) * np.exp(1j * rng.uniform(0.2, 2.9)))]
    return [complex(v) for v in rng.uniform(-1, 1, 2 if room >= 2 and rng.random() < 0.3 else 1)]


def draw(rng: np.random.Generator, kind: str = "good") -> tuple[Planted, int]:
    """A random plant (m, p in 1..4, q in 2..12, s in 1..3) and a window length from q to 2 q."""
    m, p, q, s = (int(rng.integers(a, b)) for a, b in ((1, 5), (1, 5), (2, 13), (1, 4)))
    blocks = (s, *(int(b) for b in rng.integers(1, s + 1, rng.integers(0, 3))))
    cut = {} if kind == "good" else {kind: lost(rng, q - 1)}
    plant = random_system(m=m, p=p, q=q, blocks=blocks, **cut, seed=rng)
    return plant, int(rng.integers(q, 2 * q + 1))


def enough(plant: Planted, L: int, rng: np.random.Generator) -> int:
    """Outputs for a rich window with one column to spare, and up to 80 more."""
    m = plant.D.shape[1]
    return (m + 1) * L + m * plant.s + plant.q + 1 + int(rng.integers(0, 80))


def blurred(plant: Planted) -> bool:
    """Whether an observable mode is invisible in double precision: then nothing is expected of the verdicts."""
    observe = np.vstack([plant.C1 @ np.linalg.matrix_power(plant.A1, k) for k in range(plant.q)])
    size = np.linalg.svd(observe, compute_uv=False)
    return plant.r_observable and bool(size[-1] < 1e-11 * size[0])


def noise_free(n: int) -> Table:
    lines, broken = [f"{'exact data':28} {'plants':>7} PROVED NOT_PR UNDEC. blurred   (R-controllability)"], []
    for code, kind in enumerate(("good", "uncontrollable", "unobservable")):
        seen: Counter[Verdict] = Counter()
        beyond = 0
        for i in range(n):
            rng = generator(1, code, i)
            plant, L = draw(rng, kind)
            u, y = record(plant, enough(plant, L, rng), rng)
            report = analyze(u, y, prior=Prior(q=plant.q, s=plant.s), L=L if i % 2 else None)
            seen[report.r_controllability.verdict] += 1
            if blurred(plant):
                beyond += 1
                continue
            observed = report.r_observability.verdict == PROVED
            if observed != plant.r_observable:
                broken.append(f"R-observability of {kind} plant {i}: {report.r_observability.verdict.name}")
            if (report.r_controllability.verdict == PROVED) != (plant.r_controllable and plant.r_observable):
                broken.append(f"R-controllability of {kind} plant {i}: {report.r_controllability.verdict.name}")
        lines.append(
            f"{kind:28} {n:7} {seen[PROVED]:6} {seen[Verdict.NOT_PROVED]:6} {seen[Verdict.UNDECIDED]:6} {beyond:6}"
        )
    return Table(lines, broken)


def attainable(plant: Planted, L: int) -> bool:
    """Whether [O_L T_future] is injective: what Theorems 1 and 3 as printed need beside their subject."""
    p, m = plant.D.shape
    P = [-plant.C2 @ np.linalg.matrix_power(plant.N, i) @ plant.B2 for i in range(plant.s)]
    future = np.zeros((p * L, m * (plant.s - 1)))
    for k in range(L):
        for i in range(1, plant.s):
            j = k + i - L
            if j >= 0:
                future[k * p : (k + 1) * p, j * m : (j + 1) * m] = P[i]
    observe = np.vstack([plant.C1 @ np.linalg.matrix_power(plant.A1, k) for k in range(L)])
    joint = np.hstack([observe, future])
    return bool(np.linalg.matrix_rank(joint, tol=1e-9 * np.linalg.norm(joint, 2)) == joint.shape[1])


def printed(n: int) -> Table:
    lines, broken = [f"{'theorem as printed':28} {'plants':>7} holds predicted"], []
    counts: Counter[tuple[str, int, str]] = Counter()
    for i in range(n):
        rng = generator(2, i)
        kind = ("good", "good", "uncontrollable")[i % 3]
        plant, L = draw(rng, kind)
        u, y = record(plant, enough(plant, L + plant.q, rng), rng)
        report = analyze(u, y, prior=Prior(q=plant.q, s=plant.s, n=plant.q + plant.r), L=L)
        fits = attainable(plant, L)
        for number, truth in ((1, plant.r_controllable and fits), (2, False), (3, fits), (4, False)):
            holds = report.printed[number].holds
            key = f"{number}, s = {plant.s}"
            counts[key, number, "n"] += 1
            counts[key, number, "holds"] += holds
            counts[key, number, "truth"] += truth
            if holds != truth:
                broken.append(f"printed Theorem {number} on plant {i}: holds {holds}, predicted {truth}")
    for key in sorted({k for k, _, _ in counts}):
        number = int(key[0])
        n_, holds, truth = (counts[key, number, what] for what in ("n", "holds", "truth"))
        lines.append(f"{key:28} {n_:7} {holds:5} {truth:9}")
    return Table(lines, broken)


def near(n: int) -> Table:
    lines, broken = (
        [f"{'distance to uncontrollable':28} {'plants':>7} PROVED  kappa/distance over that at 1e-4 (min, max)"],
        [],
    )
    reference: dict[int, float] = {}
    for exponent in (4, 1, 2, 3, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14):
        ratios, proved = [], 0
        for i in range(n):
            rng = generator(3, i)
            plant = random_system(
                m=3, p=2, q=4, blocks=(1,), uncontrollable=[0.6], uncontrollable_gain=10.0**-exponent, seed=rng
            )
            u, y = record(plant, 101, rng)
            f = analyze(u, y, prior=Prior(q=4), L=4).r_controllability
            proved += f.verdict == PROVED
            ratio = f.noise_bound * 10 ** (f.margin / 20) * 10.0**exponent
            reference.setdefault(i, ratio)
            ratios.append(ratio / reference[i])
        lines.append(f"{f'1e-{exponent}':28} {n:7} {proved:6}  {min(ratios):.3f} {max(ratios):.3f}")
        if 2 <= exponent <= 13 and not (min(ratios) > 0.5 and max(ratios) < 2):
            broken.append(f"margin at distance 1e-{exponent} is off by {min(ratios):.2f} to {max(ratios):.2f}")
        if exponent <= 10 and proved < n:
            broken.append(f"{n - proved} plants at distance 1e-{exponent} not proved")
    return Table(lines, broken)


def with_noise(y: np.ndarray, decibel: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    std = np.sqrt(np.mean(y**2, axis=0)) * 10 ** (-decibel / 20)
    return y + std * rng.standard_normal(y.shape), std


def noise_bound(n: int) -> Table:
    """White noise alone against its bound, for windows with all columns and with those that instruments keep."""
    lines = [f"{'noise norm (m,p,L,T)':28} {'windows':>7} above bound   bound / median norm"]
    broken, above, total = [], 0, 0
    for cell, (m, p, L, T) in enumerate(itertools.product((1, 3), (1, 2, 4), (1, 4, 12), (150, 600))):
        for past in (0, 3):
            rng = generator(9, cell, past)
            u = rng.uniform(-1, 1, (T, m))
            c = T - past - L
            W = hankel(u[: c + past + L], past + L + 1) if past else np.eye(1, c)
            W = np.vstack([W, np.zeros((p * (L + 1), c))])
            data = compress(W, m, p, L, c, m * past) if past else None
            spread = data.spread if data else float(c)
            Q = np.linalg.qr(W[: m * (past + L + 1)].T)[0] if past else None
            bound = gaussian_norm(np.sqrt(p * (L + 1)), np.sqrt(spread), L)
            norms = []
            for _ in range(n):
                H = hankel(rng.standard_normal((c + L, p)), L + 1)
                kept = H if Q is None else H @ Q
                norms.append(np.sqrt(np.linalg.eigvalsh(kept @ kept.T)[-1]))
            count = int(np.sum(np.array(norms) > bound))
            above, total = above + count, total + n
            label = f"({m},{p},{L},{T}){' kept' if past else ''}"
            lines.append(f"{label:28} {n:7} {count:11}   {bound / np.median(norms):.2f}")
            if count > 0.001 * n + 4 * np.sqrt(0.001 * n) + 1:
                broken.append(f"noise norm above its bound in {count} of {n} windows {label}")
    lines.append(f"{'all':28} {total:7} {above:11}")
    if above > 0.001 * total + 3 * np.sqrt(0.001 * total) + 1:
        broken.append(f"noise norm above its bound in {above} of {total} windows")
    return Table(lines, broken)


def undeclared(n: int) -> Table:
    """Noisy data declared exact, in windows from where a verdict becomes possible: one column to spare and more."""
    lines = [f"{'noise declared as none':22} {'plants':>7} PROVED by columns to spare: 1 2 3 4 | controllable plants"]
    broken = []
    for exponent in range(2, 15):
        count: Counter[tuple[int, bool]] = Counter()
        for i in range(n):
            for bad in (False, True):
                rng = generator(8, exponent, i, bad)
                plant, L = draw(rng, "uncontrollable" if bad else "good")
                least = (plant.D.shape[1] + 1) * L + plant.D.shape[1] * plant.s + plant.q
                u, y = record(plant, least + 4, rng)
                y, _ = with_noise(y, 20 * exponent, rng)
                for spare in range(1, 5):
                    K = least + spare
                    prior = Prior(q=plant.q, s=plant.s)
                    report = analyze(u[: K + plant.s - 1], y[:K], prior=prior, L=L if i % 2 else None)
                    count[spare, bad] += report.r_controllability.verdict == PROVED
        wrong, right = ([count[spare, bad] for spare in range(1, 5)] for bad in (True, False))
        label = f"1e-{exponent}"
        lines.append(
            f"{label:22} {n:7} " + " ".join(f"{c:5}" for c in wrong) + " | " + " ".join(f"{c:5}" for c in right)
        )
        if any(wrong) or (exponent <= 6 and any(right)):
            broken.append(f"PROVED from noise 1e-{exponent} declared as none: {wrong} uncontrollable, {right} others")
    return Table(lines, broken)


def wrong_prior(n: int) -> Table:
    lines = [
        f"{'prior too small by one':22} {'noise':>7} {'plants':>7}  noticed  PROVED although uncontrollable  other"
    ]
    broken = []
    for what in ("q", "s"):
        for decibel in (np.inf, 60.0):
            seen: Counter[str] = Counter()
            for i in range(n):
                rng = generator(5, i, what == "q")
                bad = bool(i % 2)
                cut = [complex(rng.uniform(-0.95, 0.95))] if bad else []
                plant = random_system(m=2, p=2, q=5, blocks=(2,), uncontrollable=cut, seed=rng)
                u, y = record(plant, 200, rng)
                y, std = with_noise(y, decibel, rng)
                prior = Prior(q=4, s=2) if what == "q" else Prior(q=5, s=1)
                f = analyze(u, y, prior=prior, noise=std if np.isfinite(decibel) else 0.0).r_controllability
                noticed = f.verdict == Verdict.PRIOR_VIOLATED
                seen["noticed" if noticed else "false" if bad and f.verdict == PROVED else "other"] += 1
            label = "exact" if np.isinf(decibel) else f"{decibel:g} dB"
            lines.append(
                f"{what:22} {label:>7} {n:7} {100 * seen['noticed'] / n:7.1f}% {seen['false']:18} {seen['other']:18}"
            )
            if np.isinf(decibel) and seen["noticed"] < n:
                broken.append(f"prior {what} too small not noticed in {n - seen['noticed']} exact records")
    return Table(lines, broken)


def closed_loop(n: int) -> Table:
    """Output feedback with a set-point after 100 random samples; the window slides over the switch."""
    lines = [
        f"{'closed loop, last 150':28} {'dither':>7} {'plants':>7} PROVED  by share of random samples left: 2/3 1/3 0"
    ]
    broken = []
    for dither in (0.0, 0.01, 0.1):
        count: Counter[tuple[int, bool]] = Counter()
        for i in range(n):
            for bad in (False, True):
                rng = generator(6, i, bad)
                plant = random_system(m=2, p=2, q=4, blocks=(1,), uncontrollable=[0.8] if bad else [], seed=rng)
                u, y = feedback_run(plant, 100, 300, dither, rng)
                for place, end in enumerate((150, 200, 300)):
                    window = slice(end - 150, end)
                    report = analyze(u[window], y[window], prior=Prior(q=4))
                    count[place, bad] += report.r_controllability.verdict == PROVED
        rates = " ".join(f"{100 * count[place, False] / n:4.0f}%" for place in range(3))
        lines.append(f"{'':28} {dither:7g} {n:7} {rates}")
        if any(count[place, True] for place in range(3)):
            broken.append(f"false PROVED in closed loop, dither {dither}")
    return Table(lines, broken)


def feedback_run(
    plant: Planted, free: int, K: int, dither: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Random inputs for `free` samples, then u(k+1) = clip(u(k) + 0.05 G (r - y(k)), -1, 1) and dither."""
    P = plant.D - plant.C2 @ plant.B2
    gain = 0.05 * np.linalg.pinv(P + plant.C1 @ np.linalg.solve(np.eye(plant.q) - plant.A1, plant.B1))
    z, u, y = rng.standard_normal(plant.q), rng.uniform(-1, 1, (K, 2)), np.empty((K, 2))
    target = rng.uniform(-0.5, 0.5, 2)
    for k in range(K):
        y[k] = plant.C1 @ z + P @ u[k]
        z = plant.A1 @ z + plant.B1 @ u[k]
        if free <= k + 1 < K:
            u[k + 1] = np.clip(u[k] + gain @ (target - y[k]), -1, 1) + dither * rng.uniform(-1, 1, 2)
    return u, y


def structure(n: int) -> Table:
    lines, broken = [f"{'estimate (m,p,q,s,T)':22} {'noise':>7} {'plants':>7}  q, s, rho right  q too large"], []
    for cell, (m, p, q, s, T) in enumerate(
        ((1, 1, 3, 1, 200), (2, 2, 4, 2, 200), (3, 2, 4, 3, 200), (2, 2, 4, 2, 1000))
    ):
        for decibel in (np.inf, 80.0, 60.0, 40.0):
            right = over = 0
            for i in range(n):
                rng = generator(7, cell, i)
                plant = random_system(m=m, p=p, q=q, blocks=(s,), seed=rng)
                u, y = record(plant, T, rng)
                u = np.vstack([u, rng.uniform(-1, 1, (4 - s, m))])
                y, std = with_noise(y, decibel, rng)
                found = estimate_structure(u, y, noise=std if np.isfinite(decibel) else 0.0)
                rho = tuple(j for j in range(s - 1, 0, -1)) + (0,) * (5 - s)
                right += (found.q, found.s, found.rho) == (q, s, rho)
                over += found.q > q
            label = "exact" if np.isinf(decibel) else f"{decibel:g} dB"
            lines.append(f"{f'({m},{p},{q},{s},{T})':22} {label:>7} {n:7} {100 * right / n:15.0f}% {over:12}")
            if over or (np.isinf(decibel) and right < n):
                broken.append(f"structure of cell {cell} at {label}: {right} of {n} right, {over} too large")
    return Table(lines, broken)


TABLES: dict[str, tuple[Callable[[int], Table], int]] = {
    "noise_free": (noise_free, 5000),
    "printed": (printed, 1500),
    "near": (near, 200),
    "noise_bound": (noise_bound, 2000),
    "undeclared": (undeclared, 100),
    "wrong_prior": (wrong_prior, 600),
    "closed_loop": (closed_loop, 200),
    "structure": (structure, 50),
}


def run(names: list[str], share: float) -> Iterator[str]:
    """Prints the tables; yields broken claims."""
    for name in names:
        table, n = TABLES[name]
        lines, broken = table(max(2, round(n * share)))
        print("\n".join(lines), end="\n\n", flush=True)
        yield from broken


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("tables", nargs="*", default=list(TABLES), help=f"of {', '.join(TABLES)}")
    parser.add_argument("--share", type=float, default=1.0, help="fraction of the plants")
    options = parser.parse_args()
    threadpool_limits(1)  # small matrices: more threads only wait for each other
    broken = list(run(options.tables, options.share))
    for claim in broken:
        print(f"broken: {claim}", file=sys.stderr)
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
