# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""C-controllability and C-observability."""

import numpy as np
import pytest

from plant_sim import random_system
from ros2_deepc.monitors import Prior, Verdict, analyze


def report(rng, plant, *, D=True, n=None, noise=0.0, K=250):
    u = rng.uniform(-1, 1, (K + plant.s - 1, plant.system.m))
    y = plant.system.simulate(u, rng.standard_normal(plant.q)).y
    prior = Prior(q=plant.q, s=plant.s, n=n or plant.q + plant.r, D=plant.D if D else None)
    return analyze(u, y, prior=prior, noise=noise)


@pytest.mark.parametrize("blocks", [(1,), (2,), (1, 1), (2, 1), (3,), (2, 2)])
def test_theorems_2_and_4_star_prove_with_known_feed_through(rng, blocks):
    for seed in range(4):
        plant = random_system(m=2, p=2, q=3, blocks=blocks, seed=seed)
        r = report(rng, plant)
        assert plant.c_controllable
        assert plant.c_observable
        assert r.c_controllability.verdict == Verdict.PROVED
        assert r.c_observability.verdict == Verdict.PROVED
        assert (r.c_controllability.theorem, r.c_observability.theorem) == ("2*", "4*")


@pytest.mark.parametrize(
    "lost",
    [
        {"uncontrollable_blocks": 1},
        {"unobservable_blocks": 1},
        {"uncontrollable": [0.5]},
        {"unobservable": [0.5]},
    ],
)
@pytest.mark.parametrize("blocks", [(2,), (2, 1)])
def test_what_is_lost_is_never_proved(rng, lost, blocks):
    for seed in range(4):
        plant = random_system(m=2, p=2, q=3, blocks=blocks, seed=seed, **lost)
        for known in (True, False):
            r = report(rng, plant, D=known)
            assert (r.c_controllability.verdict == Verdict.PROVED) <= (plant.c_controllable and plant.r_observable)
            assert (r.c_observability.verdict == Verdict.PROVED) <= plant.c_observable


def test_unknown_feed_through_is_decided_where_the_responses_need_every_fast_state(rng):
    plant = random_system(m=2, p=2, q=3, blocks=(2,), seed=1)  # rho_1 = 1: r = 2 rho_1 - rho_2
    r = report(rng, plant, D=False)
    assert r.estimate.rho == (1, 0)
    assert r.c_controllability.verdict == Verdict.PROVED
    assert r.c_observability.verdict == Verdict.PROVED
    noisy = report(rng, plant, D=False, noise=1e-4)
    assert noisy.c_controllability.verdict == Verdict.PROVED
    more = report(rng, plant, D=False, n=plant.q + plant.r + 1)
    assert more.c_controllability.verdict == Verdict.NOT_DECIDABLE
    larger = random_system(m=2, p=2, q=3, blocks=(2, 2), seed=1)
    assert report(rng, larger, D=False, n=3 + 3).c_controllability.verdict == Verdict.PRIOR_VIOLATED


def test_index_one_with_unknown_feed_through_is_not_decidable(rng):
    r = report(rng, random_system(m=2, p=2, q=3, blocks=(1,), seed=1), D=False)
    assert r.c_controllability.verdict == Verdict.NOT_DECIDABLE
    assert "give D" in r.c_controllability.reason


def test_dimensions_refute(rng):
    r = report(rng, random_system(m=1, p=2, q=2, blocks=(1, 1), seed=1))
    assert r.c_controllability.verdict == Verdict.REFUTED
    assert (r.c_controllability.rank, r.c_controllability.required) == (1, 2)
    assert r.c_observability.verdict == Verdict.NOT_DECIDABLE  # what no input reaches never moves
    r = report(rng, random_system(m=2, p=1, q=2, blocks=(1, 1), seed=1))
    assert r.c_observability.verdict == Verdict.REFUTED
    assert r.c_controllability.verdict == Verdict.NOT_DECIDABLE


@pytest.mark.parametrize("blocks", [(2, 1), (3,)])
def test_few_slow_states_beside_many_fast_ones(rng, blocks):
    r = report(rng, random_system(m=2, p=2, q=1, blocks=blocks, seed=2))
    assert r.c_controllability.verdict == Verdict.PROVED
    assert r.c_observability.verdict == Verdict.PROVED


def test_without_fast_part_c_is_r(rng):
    plant = random_system(m=2, p=2, q=4, seed=5)
    r = report(rng, plant)
    assert r.c_controllability == r.r_controllability
    assert r.c_observability == r.r_observability


def test_unknown_dimension_is_said(rng):
    plant = random_system(m=2, p=2, q=3, blocks=(1,), seed=1)
    u = rng.uniform(-1, 1, (80, 2))
    r = analyze(u, plant.system.simulate(u, np.ones(3)).y, prior=Prior(q=3))
    assert r.c_controllability.verdict == Verdict.UNDECIDED
    assert "give n" in r.c_controllability.reason


def test_feed_through_of_wrong_shape_is_refused(rng):
    plant = random_system(m=2, p=2, q=3, blocks=(1,), seed=1)
    u = rng.uniform(-1, 1, (80, 2))
    y = plant.system.simulate(u, np.ones(3)).y
    with pytest.raises(ValueError, match=r"shape \(p, m\) = \(2, 2\)"):
        analyze(u, y, prior=Prior(q=3, n=4, D=np.zeros((1, 2))))


@pytest.mark.parametrize("wrong", [{"q": -1}, {"q": 2, "s": 0}, {"q": 3, "n": 2}, {"q": 3, "n": 4, "s": 3}])
def test_contradicting_prior_is_refused(wrong):
    with pytest.raises(ValueError, match="prior"):
        Prior(**wrong)
