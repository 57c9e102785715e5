# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Whatever is fed to them: an uncontrollable plant is never PROVED, and errors are one line."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plant_sim import random_system
from ros2_deepc.monitors import Noise, Prior, Verdict, analyze, analyze_records, estimate_structure, indicate


def run(plant, K, rng, spread=1.0, u=None):
    """Inputs (K+s-1, m), uniform if none are given, and the K outputs of a plant."""
    if u is None:
        u = rng.uniform(-1, 1, (K + plant.s - 1, plant.system.m))
    return u, plant.system.simulate(u, spread * rng.standard_normal(plant.q)).y


def period(u, samples):
    return u[: max(2, samples)][np.arange(len(u)) % min(len(u), max(2, samples))]


INPUTS = {
    "random": lambda u, rng: u,
    "zero": lambda u, rng: 0 * u,
    "constant": lambda u, rng: np.ones_like(u) * rng.standard_normal(u.shape[1]),
    "all the same": lambda u, rng: np.repeat(u[:, :1], u.shape[1], axis=1),
    "nearly the same": lambda u, rng: u[:, :1] + 10.0 ** -rng.integers(3, 16) * u,
    "periodic": lambda u, rng: period(u, int(rng.integers(2, 30))),
    "period of the window": lambda u, rng: period(u, u.shape[1] * int(rng.integers(2, 14))),
    "sines": lambda u, rng: np.cos(np.arange(len(u))[:, None] * rng.uniform(0, np.pi, u.shape[1])),
    "steps": lambda u, rng: np.repeat(u, 7, axis=0)[: len(u)],
    "integers": lambda u, rng: np.round(3 * u).astype(int),
    "far from zero": lambda u, rng: u + 1e6,
    "growing": lambda u, rng: u * 1.05 ** np.arange(len(u))[:, None],
    "odd units": lambda u, rng: u * 10.0 ** rng.integers(-100, 100, u.shape[1]),
}
"""Inputs (T, m) from uniform ones."""


def glued(y, rng):
    half = len(y) // 2
    return np.vstack([y[:half], np.roll(y, int(rng.integers(1, 20)), axis=0)[half:]])


OUTPUTS = {
    "as they are": lambda y, rng: y,
    "one twice": lambda y, rng: np.hstack([y, y[:, :1]]),
    "dependent": lambda y, rng: np.hstack([y, y @ rng.standard_normal((y.shape[1], 1))]),
    "one dead": lambda y, rng: np.hstack([y, np.zeros((len(y), 1))]),
    "one constant": lambda y, rng: np.hstack([y, np.full((len(y), 1), 5.0)]),
    "offset": lambda y, rng: y + 1,
    "far from zero": lambda y, rng: y + 1e6,
    "drift": lambda y, rng: y + 1e-3 * np.arange(len(y))[:, None],
    "random walk": lambda y, rng: y + 1e-3 * np.cumsum(rng.standard_normal(y.shape), axis=0),
    "hum": lambda y, rng: y + 0.1 * np.sin(0.3 * np.arange(len(y)))[:, None],
    "quantized": lambda y, rng: np.round(y, 3),
    "clipped": lambda y, rng: np.clip(y, -1, 1),
    "stuck": lambda y, rng: np.vstack([y[: len(y) // 2], np.repeat(y[len(y) // 2 :][:1], len(y) - len(y) // 2, 0)]),
    "an outlier": lambda y, rng: y + 100.0 * (np.arange(len(y)) == rng.integers(len(y)))[:, None],
    "glued": glued,
    "odd units": lambda y, rng: y * 10.0 ** rng.integers(-200, 200, y.shape[1]),
    "lists": lambda y, rng: y.tolist(),
    "single precision": lambda y, rng: np.clip(y, -1e30, 1e30).astype(np.float32),
}
"""Outputs (K, p) from true ones."""

NOISE = {
    "none": lambda std: 0.0,
    "1e-6": lambda std: 1e-6 * std,
    "1e-3": lambda std: 1e-3 * std,
    "bounded": lambda std: Noise(bound=1e-4 * std),
    "estimated": lambda std: None,
    "more than the signal": lambda std: 1e3 * std,
}


def size(y):
    peak = np.abs(y).max(axis=0)
    peak = np.where(peak > 0, peak, 1.0)
    return peak * np.sqrt(np.mean((y / peak) ** 2, axis=0))


def findings(report):
    return report.r_controllability, report.r_observability, report.c_controllability, report.c_observability


HARMLESS = ("as they are", "one twice", "dependent", "one dead", "odd units", "lists", "single precision")
"""What leaves the prior true."""

PLAIN = tuple(kind for kind in INPUTS if kind not in ("nearly the same", "far from zero", "growing", "odd units"))
"""Inputs of which no combination is a millionth of the others: behind those a wrong prior may hide (docs/theory.md)."""


def cases(inputs, outputs):
    return given(
        seed=st.integers(0, 10**9),
        shape=st.tuples(st.integers(1, 3), st.integers(1, 3), st.integers(1, 5), st.integers(1, 2)),
        mode=st.sampled_from([0.5, 1.0, -0.3, 0.95, 0.0, 1.02]),
        fast=st.booleans(),
        kinds=st.tuples(st.sampled_from(inputs), st.sampled_from(outputs), st.sampled_from(sorted(NOISE))),
        K=st.sampled_from([1, 3, 20, 60, 120, 250]),
        more=st.tuples(st.sampled_from([0, 0, 0, 1, 30]), st.sampled_from([0, 0, 1])),
        L=st.sampled_from([None, None, 1, 3, 8, 500]),
    )


def check(seed, shape, mode, fast, kinds, K, more, L):
    """Analyses a spoiled record of an uncontrollable plant, with all that can be asked of it."""
    m, p, q, s = shape
    rng = np.random.Generator(np.random.PCG64(seed))
    radius = (0.9, 1.1) if fast else (0.3, 0.95)  # beyond one: outputs grow up to 1e10
    plant = random_system(m=m, p=p, q=q, blocks=(s,), uncontrollable=[mode], radius=radius, seed=rng)
    u = INPUTS[kinds[0]](rng.uniform(-1, 1, (K + s - 1, m)), rng)
    _, true = run(plant, K, rng, spread=rng.choice([0.0, 1.0, 1000.0]), u=u.astype(float))
    y = OUTPUTS[kinds[1]](true.copy(), rng)
    noise = NOISE[kinds[2]](size(np.asarray(y, dtype=np.float64)))
    prior = Prior(q=q + more[0], s=s + more[1], n=q + s + sum(more))
    report = analyze(u, y, prior=prior, L=L, noise=noise)
    assert report.r_controllability.verdict != Verdict.PROVED
    assert report.c_controllability.verdict != Verdict.PROVED
    assert all(f.reason and "\n" not in f.reason for f in findings(report))
    assert len([report.printed[k].holds for k in report.printed]) == 4
    indicate(u, y, prior=prior, L=L or q, noise=noise)
    assert estimate_structure(u, y, noise=noise).q >= 0


@settings(max_examples=150, deadline=None)
@cases(sorted(INPUTS), HARMLESS)
def test_uncontrollable_is_never_proved_whatever_the_inputs(**case):
    check(**case)


@settings(max_examples=150, deadline=None, derandomize=True)  # nothing is promised under a wrong prior, hence no luck
@cases(PLAIN, sorted(OUTPUTS))
def test_uncontrollable_is_not_proved_from_spoiled_outputs_either(**case):
    check(**case)


def test_offset_that_a_period_of_the_inputs_hides_is_not_overlooked():
    """With as many samples in a period as rows of inputs, constants are combinations of the inputs."""
    for m, q, L in ((2, 1, 3), (1, 2, 4), (3, 2, 2)):
        plant = random_system(m=m, p=2, q=q, blocks=(1,), uncontrollable=[0.95], seed=4)
        rng = np.random.Generator(np.random.PCG64(5))
        samples = m * (L + 1)
        u = period(rng.uniform(-1, 1, (80, m)), samples)
        u, y = run(plant, 80, rng, u=u)
        for noise in (0.0, 1e-9):
            report = analyze(u, y + 1.0, prior=Prior(q=q), L=L, noise=noise)
            assert Verdict.PROVED not in (report.r_controllability.verdict, report.r_observability.verdict)
        longer = period(rng.uniform(-1, 1, (80, m)), samples + m * (q // m + 1))
        seen = analyze(*run(plant, 80, rng, u=longer), prior=Prior(q=q), L=L).r_observability
        assert seen.verdict == Verdict.PROVED


def test_units_of_any_size_change_nothing(rng):
    plant = random_system(m=2, p=2, q=3, blocks=(1,), seed=1)
    u, y = run(plant, 90, rng)
    plain = analyze(u, y, prior=Prior(q=3)).r_controllability
    for unit in (1e-250, 1e-100, 1e100, 1e250):
        scaled = analyze(u * [1, unit], y * [unit, 1 / unit], prior=Prior(q=3)).r_controllability
        assert scaled.verdict == plain.verdict == Verdict.PROVED
        assert scaled.margin == pytest.approx(plain.margin, abs=1e-3)


def test_records_of_two_plants_are_not_taken_for_one(rng):
    records = [run(random_system(m=2, p=2, q=3, blocks=(1,), seed=seed), 80, rng) for seed in (1, 2)]
    report = analyze_records(records, prior=Prior(q=3))
    assert report.r_controllability.verdict == report.r_observability.verdict == Verdict.PRIOR_VIOLATED


@pytest.mark.parametrize(
    ("u", "y"),
    [
        (np.zeros((5, 2, 2)), np.zeros((5, 1))),
        (np.zeros((5, 0)), np.zeros((5, 1))),
        (np.full((5, 1), np.nan), np.zeros((5, 1))),
        (np.zeros((5, 1)), np.full((5, 1), -np.inf)),
        (3.0, np.zeros((5, 1))),
        ([["a"]], np.zeros((5, 1))),
        ([[1.0], [1.0, 2.0]], np.zeros((2, 1))),
        ([[{}]], np.zeros((1, 1))),
        (np.array([[1 + 1j]]), np.zeros((1, 1))),
    ],
)
def test_what_is_no_record_is_refused_in_one_line(u, y):
    with pytest.raises(ValueError, match=r"\A[^\n]+\Z"):
        analyze(u, y, prior=Prior(q=1))


@pytest.mark.parametrize("wrong", [{"q": -1}, {"q": 1, "s": 0}, {"q": 3, "n": 2}, {"q": 1, "s": 3, "n": 2}])
def test_a_prior_that_contradicts_itself_is_refused_in_one_line(wrong):
    with pytest.raises(ValueError, match=r"\A[^\n]+\Z"):
        Prior(**wrong)
