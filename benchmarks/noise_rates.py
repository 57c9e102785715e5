# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""How often controllability is PROVED under noise, on the same records as a plain test, and how often wrongly.

    python benchmarks/noise_rates.py                        # 400 plants of each kind a cell, seed never used before
    python benchmarks/noise_rates.py --plants 40 --jobs 1   # a tenth, in one process

Each cell prints when it is done. Exits with 1 if an uncontrollable plant is PROVED, or if the plain test
(`pencil_baseline`, with the best of its window lengths) proves more plants than the monitors do: in all cells together,
or in one of them by more than chance.
"""

import argparse
import itertools
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import NamedTuple

import numpy as np
from monitor_statistics import PROVED, generator, record, with_noise
from pencil_baseline import lengths, proves
from scipy.stats import binomtest
from threadpoolctl import threadpool_limits

from plant_sim import random_system
from ros2_deepc.behavior import Record, data_matrix
from ros2_deepc.monitors import Noise, Prior, analyze
from ros2_deepc.monitors.analysis import FAR, _lengths
from ros2_deepc.monitors.pencil import reduce
from ros2_deepc.monitors.search import minimum
from ros2_deepc.monitors.source import Records, from_records

SEED = 20261128
"""Never used while the monitors were made; their constants were chosen on seed 4."""

CELLS = (
    (1, 1, 2, 1, 200),
    (3, 2, 4, 1, 100),
    (3, 2, 6, 1, 200),
    (2, 2, 4, 2, 200),
    (3, 2, 4, 1, 1000),
    (10, 10, 20, 1, 1000),
)
"""(m, p, q, s, T)."""

LEVELS = (40, 60, 80, 100)
CHANCE = 0.01
"""Below this probability (sign test of the plants that only one of both proves) a lead is none of chance."""

LARGE = 10
"""Slow dimension from which a tenth of the plants must do, if that is any."""


class Trial(NamedTuple):
    """Which record: a plant of a cell at a noise level, controllable or not."""

    seed: int
    cell: int
    plant: int
    bad: bool
    decibel: int


class Seen(NamedTuple):
    """What each test said of one record; the last two are only asked of controllable plants.

    Attributes:
        given: PROVED with the standard deviation given.
        estimated: PROVED with the level estimated.
        plain: proved by the plain test at one of its window lengths at least.
        possible: whether a test that knew the norm of this very noise would prove it in one of the windows.
    """

    given: bool
    estimated: bool
    plain: bool = False
    possible: bool = False


def interval(hits: int, n: int) -> str:
    """95 % confidence interval of a share (Wilson) in percent."""
    z, share = 1.96, hits / n
    middle, half = share + z * z / (2 * n), z * np.sqrt(share * (1 - share) / n + z * z / (4 * n * n))
    return f"{100 * (middle - half) / (1 + z * z / n):.0f}-{100 * (middle + half) / (1 + z * z / n):.0f}"


def data(trial: Trial) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, Prior]:
    """Inputs, noisy outputs, the noise, its standard deviation (p,) and the prior."""
    m, p, q, s, T = CELLS[trial.cell]
    rng = generator(trial.seed, trial.cell, trial.plant, trial.bad)
    cut = [complex(rng.uniform(-1, 1))] if trial.bad else []
    plant = random_system(m=m, p=p, q=q, blocks=(s,), uncontrollable=cut, seed=rng)
    u, exact = record(plant, T + 1, rng)
    y, std = with_noise(exact, trial.decibel, rng)
    return u, y, y - exact, std, Prior(q=q, s=s)


def look(trial: Trial) -> Seen:
    """Every test on one record."""
    u, y, v, std, prior = data(trial)
    given, estimated = (
        analyze(u, y, prior=prior, noise=noise).r_controllability.verdict == PROVED for noise in (std, None)
    )
    if trial.bad:
        return Seen(given, estimated)
    scan = lengths(y.shape[1], prior.q) if prior.q < LARGE else []  # the bound of each takes minutes there
    tried = dict.fromkeys([4, 5, *scan])
    plain = any(proves(u, y, std, L, prior.s, prior.q) for L in tried)
    return Seen(given, estimated, plain, given or plain or possible(u, y, v, std, prior))


def possible(u: np.ndarray, y: np.ndarray, v: np.ndarray, std: np.ndarray, prior: Prior) -> bool:
    """Whether kappa exceeds the norm of this very noise in one of the windows that `analyze` may look at.

    A proof by the norm of the noise needs kappa > bound >= norm. It is asked at the weakest lambda of the reduced
    pencil, of the pencil before any reduction: what fails here fails for every such test and every valid bound.
    """
    noise = Noise(std=std)
    source = from_records([(u, y)], prior.s)
    source = source.weighted(noise.weights(source.y_scale))
    of_noise = Records(
        records=(Record(source.records[0].u, v[: source.samples] / source.y_scale),),
        u_scale=source.u_scale,
        y_scale=source.y_scale,
    )
    past = -(-prior.q // source.m) + 1
    for L, before in itertools.product(_lengths(source, prior, None, exact=False), (0, past, FAR * past)):
        d = L + prior.s
        if source.columns(L, d, before) <= source.m * (d + before) + prior.q:
            continue
        lam = minimum(reduce(source.window(L, d, before), prior.q)).lambda_
        if unreduced(source, L, d, before, lam, prior.q) > noise_norm(of_noise, L, d, before):
            return True
    return False


def noise_norm(of_noise: Records, L: int, d: int, before: int) -> float:
    """Norm of the noise in a window, or in what instruments keep of it."""
    window = of_noise.window(L, d, before)
    return float(np.linalg.norm(np.hstack([window.R21, window.directions]), 2))


def unreduced(source: Records, L: int, d: int, before: int, lam: complex, q: int) -> float:
    """sigma_q(Y(lambda) Pi) / |S1 - lambda S0| from the data matrix itself."""
    m, p, r = source.m, source.p, source.records[0]
    W = data_matrix([Record(r.u, r.y[before:])], before + d, L + 1)
    inputs = m * (before + d)
    U, Y = np.roll(W[:inputs], -m * before, axis=0), W[inputs:]
    if before:
        kept = np.linalg.qr(U.T)[0]
        U, Y = U @ kept, Y @ kept
    U = U[: m * d]
    t, later, earlier = (1 / lam, 1 / lam, 1.0) if abs(lam) > 1 else (lam, 1.0, lam)
    shifted = later * Y[p:] - earlier * Y[:-p]
    span = np.linalg.qr((later * U[m:] - earlier * U[:-m]).conj().T)[0]
    weight = np.sqrt(1 + abs(t) ** 2 + 2 * abs(t) * np.cos(np.pi / (L + 1)))
    return float(np.linalg.svd(shifted - (shifted @ span) @ span.conj().T, compute_uv=False)[q - 1] / weight)


class Row(NamedTuple):
    """One cell at one noise level.

    Attributes:
        line: to print.
        broken: claims that it breaks.
        plain: plants that the plain test proves.
        lead: how many more the monitors prove.
    """

    line: str
    broken: list[str]
    plain: int
    lead: int


HEAD = (
    f"{'(m,p,q,s,T)':18} {'dB':>4} {'plants':>6}  {'given level':>14}  {'plain test':>14} {'ours only':>9} "
    f"{'its only':>8} {'possible':>8}  {'estimated':>14} | false PROVED: given, estimated"
)


def row(cell: int, decibel: int, good: list[Seen], bad: list[Seen]) -> Row:
    """One line, and what it breaks."""
    n, label = len(good), "({},{},{},{},{})".format(*CELLS[cell])
    hits = Counter({name: sum(getattr(seen, name) for seen in good) for name in Seen._fields})
    ours = sum(seen.given and not seen.plain for seen in good)
    its = sum(seen.plain and not seen.given for seen in good)
    false = [sum(seen.given for seen in bad), sum(seen.estimated for seen in bad)]
    share = {name: f"{100 * hits[name] / n:.1f}% ({interval(hits[name], n)})" for name in Seen._fields}
    line = (
        f"{label:18} {decibel:4} {n:6}  {share['given']:>14}  {share['plain']:>14} {ours:9} {its:8} "
        f"{100 * hits['possible'] / n:7.1f}%  {share['estimated']:>14} | {false[0]} {false[1]} of {len(bad)}"
    )
    broken = [f"false PROVED at {label}, {decibel} dB: {false}"] if any(false) else []
    if its > ours and binomtest(its, its + ours, alternative="greater").pvalue < CHANCE:
        broken.append(f"{label}, {decibel} dB: {hits['given']} PROVED, {hits['plain']} by the plain test")
    return Row(line, broken, hits["plain"], hits["given"] - hits["plain"])


def rows(
    plants: int, seed: int, jobs: int = 1, cells: Sequence[int] = range(len(CELLS)), levels: Sequence[int] = LEVELS
) -> Iterator[Row]:
    """Cell by cell, noise level by noise level [dB]."""
    with ProcessPoolExecutor(jobs, initializer=threadpool_limits, initargs=(1,)) as pool:
        for cell, decibel in itertools.product(cells, levels):
            n = plants if CELLS[cell][2] < LARGE else plants // 10
            if not n:
                continue
            trials = [Trial(seed, cell, i, bad, decibel) for bad in (False, True) for i in range(n)]
            seen = list((partial(pool.map, chunksize=4) if jobs > 1 else map)(look, trials))
            yield row(cell, decibel, seen[:n], seen[n:])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--plants", type=int, default=400, help="of each kind, a cell; a tenth of it in the largest")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    options = parser.parse_args()
    print(HEAD, flush=True)
    broken, lead = [], 0
    for each in rows(options.plants, options.seed, options.jobs):
        print(each.line, flush=True)
        broken, lead = broken + each.broken, lead + each.lead
    if lead < 0:
        broken.append(f"the plain test proves {-lead} plants more, all cells together")
    for claim in broken:
        print(f"broken: {claim}", file=sys.stderr)
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
