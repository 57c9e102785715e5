# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Poor data give UNDECIDED with a reason that says what to do; wrong data raise."""

import pickle
import re

import numpy as np
import pytest

from plant_sim import random_system
from ros2_deepc.monitors import Prior, Verdict, analyze, analyze_factor, analyze_records, indicate

PRIOR = Prior(q=4, s=2, n=6)


@pytest.fixture(scope="module")
def plant():
    return random_system(m=2, p=2, q=4, blocks=(2,), seed=3)


def record(plant, K, seed=0):
    rng = np.random.Generator(np.random.PCG64(seed))
    u = rng.uniform(-1, 1, (K + 1, 2))
    return u, plant.system.simulate(u, rng.standard_normal(4)).y.copy() if K else np.zeros((0, 2))


def findings(report):
    return report.r_controllability, report.c_controllability, report.r_observability, report.c_observability


@pytest.mark.parametrize("K", [0, 1, 5, 12])
def test_short_record_says_how_many_samples_are_missing_and_is_right(plant, K):
    report = analyze(*record(plant, K), prior=PRIOR)
    assert all(f.verdict == Verdict.UNDECIDED for f in findings(report)[::2])
    missing = int(re.match(r"(\d+) more samples needed", report.r_controllability.reason)[1])
    again = analyze(*record(plant, K + missing), prior=PRIOR, L=report.L)
    assert "more samples" not in again.r_controllability.reason
    one_less = analyze(*record(plant, K + missing - 1), prior=PRIOR, L=report.L)
    assert "1 more samples needed" in one_less.r_controllability.reason


@pytest.mark.parametrize("u", [np.zeros((80, 2)), np.ones((80, 2)), np.outer(np.sin(np.arange(80)), [1, 1])])
def test_poor_excitation_is_named_with_its_order(plant, u):
    y = plant.system.simulate(u, np.ones(4)).y
    report = analyze(u, y, prior=PRIOR)
    for f in findings(report):
        assert f.verdict == Verdict.UNDECIDED
    assert "persistently exciting of order" in report.r_controllability.reason
    assert report.excitation_order < report.excitation_need


def test_excitation_lost_after_a_good_start_is_said_as_such(plant):
    u, y = record(plant, 200)
    u[100:] = u[100]
    rng = np.random.Generator(np.random.PCG64(0))
    y = plant.system.simulate(u, rng.standard_normal(4)).y
    assert analyze(u, y, prior=PRIOR).r_controllability.verdict == Verdict.PROVED
    late = analyze(u[120:], y[120:], prior=PRIOR)
    assert late.r_controllability.verdict == Verdict.UNDECIDED
    assert late.excitation_order <= 1
    assert f"of order {late.excitation_order} only" in late.r_controllability.reason


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_value_that_is_not_finite_raises_and_says_where(plant, bad):
    u, y = record(plant, 60)
    y[7, 1] = bad
    with pytest.raises(ValueError, match=r"y\[7, 1\]"):
        analyze(u, y, prior=PRIOR)


def test_wrong_shapes_raise(plant):
    u, y = record(plant, 60)
    with pytest.raises(ValueError, match="shape"):
        analyze(u[None], y, prior=PRIOR)
    with pytest.raises(ValueError, match="both at least 1"):
        analyze(u[:, :0], y, prior=PRIOR)
    with pytest.raises(ValueError, match="same"):
        analyze_records([(u, y), (u, y[:, :1])], prior=PRIOR)
    with pytest.raises(ValueError, match="no record"):
        analyze_records([], prior=PRIOR)
    with pytest.raises(ValueError, match="L = 0"):
        analyze(u, y, prior=PRIOR, L=0)
    with pytest.raises(ValueError, match="multiple of m"):
        analyze_factor(np.ones((7, 9)), 2, 2, 9, prior=PRIOR)
    with pytest.raises(ValueError, match="not finite"):
        analyze_factor(np.full((8, 9), np.nan), 2, 2, 9, prior=PRIOR)


def test_outputs_without_their_later_inputs_are_left_out(plant):
    u, y = record(plant, 80)
    assert analyze(u[:-1], y, prior=PRIOR).samples == 79
    assert analyze(u[:-1], y, prior=PRIOR).r_controllability.verdict == Verdict.PROVED


def test_window_shorter_than_the_lag_is_not_taken_for_uncontrollable(plant):
    report = analyze(*record(plant, 80), prior=PRIOR, L=1)
    assert report.r_controllability.verdict == Verdict.UNDECIDED


def test_dead_channels_do_no_harm():
    rng = np.random.Generator(np.random.PCG64(2))
    u = rng.uniform(-1, 1, (80, 1))
    y = np.zeros((80, 2))
    for k in range(79):
        y[k + 1, 0] = 0.5 * y[k, 0] + u[k, 0]
    assert analyze(u, y, prior=Prior(q=1)).r_controllability.verdict == Verdict.PROVED
    silent = analyze(u, np.zeros((80, 2)), prior=Prior(q=1))
    assert silent.r_observability.verdict == Verdict.NOT_PROVED
    assert silent.r_controllability.verdict == Verdict.UNDECIDED


def test_report_travels_between_processes(plant):
    report = analyze(*record(plant, 80), prior=PRIOR)
    again = pickle.loads(pickle.dumps(report))
    assert again.r_controllability.reason == report.r_controllability.reason
    assert repr(again.printed[3]) == repr(report.printed[3])
    assert list(report.printed) == [1, 2, 3, 4]
    with pytest.raises(KeyError):
        report.printed[5]


def test_level_that_cannot_be_estimated_is_undecided(plant):
    cut = analyze(*record(plant, 40), prior=Prior(q=4, s=2, n=6, D=plant.D), L=2, noise=None)
    for f in findings(cut):
        assert f.verdict == Verdict.UNDECIDED
        assert "estimate the noise" in f.reason


def test_plant_without_slow_part():
    rng = np.random.Generator(np.random.PCG64(2))
    u = rng.uniform(-1, 1, (80, 2))
    report = analyze(u, u @ [[1.0], [2.0]], prior=Prior(q=0))
    assert report.r_controllability.verdict == Verdict.PROVED
    assert report.r_observability.verdict == Verdict.PROVED
    y = np.cumsum(u, axis=0)[:, :1]
    assert analyze(u, y, prior=Prior(q=0)).r_controllability.verdict == Verdict.PRIOR_VIOLATED


def test_over_estimated_prior_is_never_wrongly_proved(plant):
    cut = random_system(m=2, p=2, q=4, blocks=(2,), uncontrollable=[0.5], seed=3)
    for p in (plant, cut):
        more = analyze(*record(p, 120), prior=Prior(q=5, s=2))
        assert more.r_controllability.verdict in (Verdict.UNDECIDED, Verdict.NOT_PROVED)
        later = analyze(*record(p, 120), prior=Prior(q=4, s=3))
        assert later.r_controllability.verdict == (Verdict.PROVED if p is plant else Verdict.NOT_PROVED)


def test_indicator_agrees_with_the_analysis_and_says_what_is_missing(plant):
    u, y = record(plant, 120)
    full, quick = analyze(u, y, prior=PRIOR, L=6), indicate(u, y, prior=PRIOR, L=6)
    assert quick.controllability >= full.r_controllability.margin - 1e-6
    assert quick.observability == pytest.approx(full.r_observability.margin)
    assert quick.rank == quick.rank_need == full.rank
    assert "more samples" in indicate(u[:9], y[:8], prior=PRIOR, L=6).reason
    assert "exciting" in indicate(np.ones((81, 2)), y[:80], prior=PRIOR, L=6).reason
    assert "no direction" in indicate(u, np.zeros((120, 2)), prior=PRIOR, L=6).reason
    assert indicate(u, y, prior=Prior(q=5, s=2), L=6).controllability == -np.inf


def test_rounding_of_large_hidden_states_is_not_held_against_the_prior():
    for seed in range(5):
        for cut in ([], [0.9]):
            p = random_system(m=2, p=2, q=5, blocks=(2, 1), uncontrollable=cut, conditioning=1e3, seed=seed)
            rng = np.random.Generator(np.random.PCG64(seed))
            u, z, y = rng.uniform(-1, 1, (121, 2)), rng.standard_normal(5), np.empty((120, 2))
            for k in range(120):
                y[k] = p.C1 @ z + p.D @ u[k] - p.C2 @ (p.B2 @ u[k] + p.N @ p.B2 @ u[k + 1])
                z = p.A1 @ z + p.B1 @ u[k]
            verdict = analyze(u, y, prior=Prior(q=5, s=2)).r_controllability.verdict
            assert verdict == (Verdict.NOT_PROVED if cut else Verdict.PROVED)
