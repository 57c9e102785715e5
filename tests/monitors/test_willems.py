# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The extended fundamental lemma on data."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plant_sim import random_system
from ros2_deepc.behavior import excitation_order
from ros2_deepc.monitors import Prior, parameterize, required_length, richness


def respond(plant, u, z):
    return plant.system.simulate(u, z).y


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10**6), m=st.integers(1, 3), q=st.integers(1, 5), s=st.integers(1, 3), L=st.integers(1, 6))
def test_required_length_is_the_least(seed, m, q, s, L):
    rng = np.random.Generator(np.random.PCG64(seed))
    L = max(L, q)  # never shorter than the lag
    need = required_length(m, q, s, L)
    plant = random_system(m=m, p=2, q=q, blocks=(s,), seed=rng)
    u = rng.uniform(-1, 1, (need.excitation, m))
    y = respond(plant, u, rng.standard_normal(q))
    prior = Prior(q=q, s=s)
    found = richness(u, y, prior=prior, L=L)
    assert found.by_excitation
    assert found.samples_missing == 0
    assert excitation_order(u) == found.excitation_need
    T = need.rank
    assert richness(u[:T], y[: T - s + 1], prior=prior, L=L).by_rank
    less = richness(u[: T - 1], y[: T - s], prior=prior, L=L)
    assert not less.by_rank
    assert less.samples_missing == need.excitation - T + 1


@pytest.mark.parametrize("s", [1, 2, 3])
def test_later_windows_of_an_uncontrollable_run_are_parameterizable(rng, s):
    plant = random_system(m=2, p=2, q=4, blocks=(s,), uncontrollable=[1.0, 1.0], seed=4)
    L, z = 6, rng.standard_normal(4)
    T = required_length(2, 4, s, L).excitation
    u = rng.uniform(-1, 1, (T + 40, 2))
    y = respond(plant, u, z)
    past = slice(0, T - s + 1)
    for t in (T, T + 20):
        found = parameterize(u[t : t + L], y[t : t + L], u[past], y[past])
        assert found.holds
        assert found.residual < 1e-9
    other = respond(plant, u, rng.standard_normal(4))  # one run excites one ray of two uncontrollable modes
    assert not parameterize(u[T : T + L], other[T : T + L], u[past], y[past]).holds


def test_residual_tells_a_foreign_trajectory(rng):
    plant = random_system(m=1, p=1, q=2, blocks=(1,), seed=1)
    u = rng.uniform(-1, 1, (60, 1))
    y = respond(plant, u, np.ones(2))
    strange = parameterize(u[:5], y[:5] + np.array([[0], [0], [0], [0], [1.0]]), u, y)
    assert not strange.holds
    assert strange.residual > 1e-3
    assert strange.g.shape == (56,)
    assert parameterize(np.zeros((5, 1)), np.zeros((5, 1)), u, y).residual == 0


def test_wrong_arguments_raise(rng):
    u = rng.uniform(-1, 1, (20, 1))
    with pytest.raises(ValueError, match="does not fit"):
        parameterize(u, u, u[:5], u[:5])
    with pytest.raises(ValueError, match="at least 1"):
        required_length(0, 1, 1, 1)
