# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Records side by side and factors say the same as one record."""

import numpy as np
import pytest

from plant_sim import random_system
from ros2_deepc.behavior import SlidingFactor, hankel
from ros2_deepc.monitors import Prior, Verdict, analyze, analyze_factor, analyze_records


def piece(plant, K, seed):
    rng = np.random.Generator(np.random.PCG64(seed))
    u = rng.uniform(-1, 1, (K + plant.s - 1, plant.system.m))
    return u, plant.system.simulate(u, rng.standard_normal(plant.q)).y


@pytest.fixture(scope="module")
def plant():
    return random_system(m=2, p=2, q=4, blocks=(2,), seed=3)


@pytest.fixture(scope="module")
def cut():
    return random_system(m=2, p=2, q=4, blocks=(2,), uncontrollable=[0.6], seed=3)


@pytest.mark.parametrize("noise", [0.0, 1e-5])
def test_pieces_too_short_alone_prove_together(plant, cut, noise):
    for p, verdict in ((plant, Verdict.PROVED), (cut, Verdict.NOT_PROVED)):
        pieces = [piece(p, 11, seed) for seed in range(8)]
        alone = analyze(*pieces[0], prior=Prior(q=4, s=2), noise=noise)
        assert alone.r_controllability.verdict == Verdict.UNDECIDED
        together = analyze_records(pieces, prior=Prior(q=4, s=2), noise=noise)
        assert together.r_controllability.verdict == verdict
        assert together.samples == 8 * 11
        assert together.columns == 8 * (11 - together.L)


def test_a_gap_must_be_cut(plant):
    (u1, y1), (u2, y2) = piece(plant, 60, 1), piece(plant, 60, 2)
    glued = analyze(np.vstack([u1[:60], u2]), np.vstack([y1, y2]), prior=Prior(q=4, s=2))
    assert glued.r_controllability.verdict == Verdict.PRIOR_VIOLATED
    cut = analyze_records([(u1, y1), (u2, y2)], prior=Prior(q=4, s=2))
    assert cut.r_controllability.verdict == Verdict.PROVED


def factor_of(u, y, depth):
    w = np.hstack([u[: len(y)], y])
    H = hankel(w, depth)
    return H, np.linalg.qr(H.T, mode="r").T


@pytest.mark.parametrize("noise", [0.0, 1e-6])
def test_factor_gives_what_the_record_gives(plant, cut, noise):
    for p in (plant, cut):
        u, y = piece(p, 150, 4)
        H, R = factor_of(u, y, 8)
        prior = Prior(q=4, s=2, n=6, D=p.D)
        for F in (
            H,
            R,
            R @ np.linalg.qr(np.random.Generator(np.random.PCG64(1)).standard_normal(2 * (R.shape[1],)))[0],
        ):
            by_factor = analyze_factor(F, 2, 2, H.shape[1], prior=prior, L=4, noise=noise)
            by_record = analyze(u, y, prior=prior, L=4, noise=noise)
            for name in ("r_controllability", "r_observability", "c_controllability", "c_observability"):
                assert getattr(by_factor, name).verdict == getattr(by_record, name).verdict
            assert by_factor.rank == by_record.rank


def test_factor_too_shallow_is_said(plant):
    u, y = piece(plant, 100, 4)
    H, R = factor_of(u, y, 4)
    report = analyze_factor(R, 2, 2, H.shape[1], prior=Prior(q=4, s=2), L=4)
    assert report.r_controllability.verdict == Verdict.UNDECIDED
    assert "depth 4" in report.r_controllability.reason


@pytest.mark.parametrize("columns", [60, 150])
def test_sliding_factor_shared_with_the_controller(plant, cut, columns):
    for p in (plant, cut):
        u, y = piece(p, 400, 5)
        w = np.hstack([u[:400], y])
        sliding = SlidingFactor(channels=4, blocks=8, columns=columns)
        for k, sample in enumerate(w):
            sliding.push(sample)
            if k % 97 == 96:
                newest = slice(k + 1 - columns - 7, k + 1) if k >= columns + 7 else slice(0, k + 1)
                prior = Prior(q=4, s=2)
                by_factor = analyze_factor(sliding.factor().T, 2, 2, sliding.held, prior=prior, L=4)
                H, _ = factor_of(u[newest], y[newest], 8)
                fresh = analyze_factor(H, 2, 2, H.shape[1], prior=prior, L=4)
                assert by_factor.r_controllability.verdict == fresh.r_controllability.verdict
                if p is plant and fresh.r_controllability.verdict == Verdict.PROVED:
                    assert by_factor.r_controllability.margin == pytest.approx(fresh.r_controllability.margin, abs=1e-6)
