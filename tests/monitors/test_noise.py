# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Noise bounds against simulated noise, and what they do to verdicts."""

import numpy as np
import pytest

from plant_sim import random_system
from ros2_deepc.behavior import hankel
from ros2_deepc.monitors import Noise, Prior, Verdict, analyze, analyze_records
from ros2_deepc.monitors.compress import compress, toeplitz_norm
from ros2_deepc.monitors.noise import estimate_std, gaussian_norm, marchenko_pastur_median
from ros2_deepc.monitors.source import from_records


def stack(u, y, L, past):
    c = len(y) - past - L
    Hu = hankel(u[: c + past + L], past + L + 1)
    m = u.shape[1]
    return np.vstack([Hu[m * past :], Hu[: m * past], hankel(y[past:], L + 1)])


@pytest.mark.parametrize(
    ("p", "L", "T", "past"), [(1, 3, 100, 0), (2, 8, 150, 0), (3, 20, 200, 0), (2, 8, 150, 3), (1, 5, 400, 4)]
)
def test_white_noise_stays_below_its_bound(rng, p, L, T, past):
    u = rng.uniform(-1, 1, (T, 2))
    ratios = []
    for _ in range(60):
        v = 0.3 * rng.standard_normal((T, p))
        W = stack(u, v, L, past)
        data = compress(W, 2, p, L, W.shape[1], 2 * past)
        bound = Noise(std=0.3).hankel_bound(data, np.full(p, 0.3))
        kept = (L + 1) * 2 + 2 * past
        Q = np.linalg.qr(W.T)[0][:, : kept if past else None]
        ratios.append(np.linalg.norm(hankel(v[past:], L + 1) @ Q, 2) / bound)
    assert max(ratios) <= 1
    assert np.median(ratios) > 0.5  # and it is not a lazy one


def test_narrow_band_instruments_let_more_noise_through(rng):
    k = np.arange(300)
    slow = np.linalg.qr(np.cos(2 * np.pi * k[:, None] * np.array([0.01, 0.013])))[0]
    white = np.linalg.qr(rng.standard_normal((300, 2)))[0]
    assert toeplitz_norm([slow], 20) > 5 * toeplitz_norm([white], 20)
    norms = [np.linalg.norm(hankel(rng.standard_normal(319), 20) @ slow, 2) for _ in range(50)]
    assert max(norms) <= gaussian_norm(np.sqrt(20), np.sqrt(toeplitz_norm([slow], 20)), 19)


def test_toeplitz_norm_of_all_directions_is_their_number():
    assert toeplitz_norm([np.eye(30)], 7) == pytest.approx(30)


def test_a_record_too_short_for_a_column_changes_nothing(rng):
    plant = random_system(m=2, p=2, q=3, blocks=(1,), seed=3)
    u = rng.uniform(-1, 1, (200, 2))
    y = plant.system.simulate(u, np.ones(3)).y + 1e-3 * rng.standard_normal((200, 2))
    alone = analyze_records([(u[:190], y[:190])], prior=Prior(q=3), L=3, noise=1e-3).r_controllability
    beside = analyze_records([(u[:190], y[:190]), (u[191:193], y[191:193])], prior=Prior(q=3), L=3, noise=1e-3)
    assert beside.r_controllability.verdict == alone.verdict == Verdict.PROVED
    assert beside.r_controllability.margin == pytest.approx(alone.margin, abs=0.1)


def test_hard_bound_is_attained_by_constant_noise():
    y = np.ones((50, 2))
    source = from_records([(np.eye(50, 1), y)], 1)
    W = np.vstack([np.zeros((5, 46)), hankel(y, 5)])
    data = compress(np.vstack([hankel(np.eye(50, 1), 5), W[5:]]), 1, 2, 4, 46)
    bound = Noise(bound=1.0).hankel_bound(data, np.ones(2))
    assert bound == pytest.approx(np.linalg.norm(W, 2))
    assert source.p == 2


def test_median_of_the_marchenko_pastur_law():
    assert marchenko_pastur_median(1.0) == pytest.approx(0.6528, abs=2e-4)  # tabulated by Gavish and Donoho
    rng = np.random.Generator(np.random.PCG64(1))
    sigma = np.linalg.svd(rng.standard_normal((200, 800)), compute_uv=False)
    assert marchenko_pastur_median(0.25) == pytest.approx(np.median(sigma**2) / 800, rel=0.02)


def test_level_is_estimated_within_a_quarter(rng):
    for seed in range(10):
        plant = random_system(m=2, p=2, q=4, blocks=(1,), seed=seed)
        u = rng.uniform(-1, 1, (200, 2))
        y = plant.system.simulate(u, rng.standard_normal(4)).y
        source = from_records([(u, y + 1e-3 * rng.standard_normal(y.shape) * np.sqrt(np.mean(y**2, axis=0)))], 1)
        assert estimate_std(source.window(8, 9), 4) == pytest.approx(1e-3, rel=0.25)


def test_very_unequal_noise_is_no_contradiction_once_its_levels_are_given(rng):
    for seed in range(6):
        plant = random_system(m=2, p=2, q=4, blocks=(1,), seed=seed)
        u = rng.uniform(-1, 1, (200, 2))
        y = plant.system.simulate(u, rng.standard_normal(4)).y
        std = np.array([1e-2, 1e-5]) * np.sqrt(np.mean(y**2, axis=0))
        y = y + std * rng.standard_normal(y.shape)
        assert analyze(u, y, prior=Prior(q=4), noise=std).r_controllability.verdict != Verdict.PRIOR_VIOLATED


def test_a_better_sensor_beside_a_bad_one_is_used(rng):
    """Outputs count by their noise: the margin hardly suffers from a third that is mostly noise."""
    for seed in range(4):
        plant = random_system(m=2, p=2, q=3, blocks=(1,), seed=seed)
        u = rng.uniform(-1, 1, (200, 2))
        y = plant.system.simulate(u, rng.standard_normal(3)).y
        std = 1e-4 * np.sqrt(np.mean(y**2, axis=0))
        good = y + std * rng.standard_normal(y.shape)
        bad = y[:, :1] + 0.3 * np.std(y[:, 0]) * rng.standard_normal((200, 1))
        alone = analyze(u, good, prior=Prior(q=3), noise=std).r_controllability
        both = np.append(std, 0.3 * np.std(y[:, 0]))
        beside = analyze(u, np.hstack([good, bad]), prior=Prior(q=3), noise=both).r_controllability
        assert beside.margin > alone.margin - 6


@pytest.mark.parametrize("noise", [0.01, None, Noise(bound=0.0174)])
def test_uncontrollable_is_never_proved_and_controllable_can_be(rng, noise):
    proved = 0
    for seed in range(12):
        for cut in ([], [0.8]):
            modes = [0.5, -0.3] if cut else [0.8, 0.5, -0.3]
            plant = random_system(m=2, p=2, q=3, blocks=(1,), uncontrollable=cut, modes=modes, seed=seed)
            u = rng.uniform(-1, 1, (300, 2))
            v = 0.01 * np.sqrt(3) * rng.uniform(-1, 1, (300, 2))
            y = plant.system.simulate(u, rng.standard_normal(3)).y + v
            verdict = analyze(u, y, prior=Prior(q=3), noise=noise).r_controllability.verdict
            assert not (cut and verdict == Verdict.PROVED)
            proved += not cut and verdict == Verdict.PROVED
    assert proved >= (2 if isinstance(noise, Noise) else 7)


def test_source_of_the_level_is_said(rng):
    plant = random_system(m=1, p=1, q=2, blocks=(1,), seed=0)
    u = rng.uniform(-1, 1, (80, 1))
    y = plant.system.simulate(u, np.ones(2)).y
    for noise, source in ((0.0, "exact"), (0.1, "given"), (Noise(bound=0.1), "given"), (None, "estimated")):
        assert analyze(u, y, prior=Prior(q=2), noise=noise).noise_source == source


def test_wrong_noise_is_refused(rng):
    u, y = rng.uniform(-1, 1, (30, 1)), rng.uniform(-1, 1, (30, 2))
    for bad in (-1.0, np.nan, [[1.0]]):
        with pytest.raises(ValueError, match="noise must be"):
            analyze(u, y, prior=Prior(q=1), noise=bad)
    with pytest.raises(ValueError, match="3 outputs, the record has 2"):
        analyze(u, y, prior=Prior(q=1), noise=[1.0, 1.0, 1.0])


def test_loud_channel_beside_a_quiet_one_does_not_change_units(rng):
    plant = random_system(m=2, p=2, q=3, blocks=(1,), seed=3)
    u = rng.uniform(-1, 1, (200, 2))
    y = plant.system.simulate(u, np.ones(3)).y
    std = np.array([1e-3, 1e-4])
    y = y + std * rng.standard_normal(y.shape)
    plain = analyze(u, y, prior=Prior(q=3), noise=std).r_controllability
    scaled = analyze(u * [1e3, 1], y * [1, 1e6], prior=Prior(q=3), noise=std * [1, 1e6]).r_controllability
    assert scaled.margin == pytest.approx(plain.margin, abs=1e-3)
