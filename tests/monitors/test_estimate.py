# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Structure read off the data."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plant_sim import random_system
from ros2_deepc.monitors import StructureEstimate, estimate_structure


def record(plant, K, rng, beyond=3):
    u = rng.uniform(-1, 1, (K + beyond, plant.system.m))
    return u, plant.system.simulate(u[: K + plant.s - 1], rng.standard_normal(plant.q)).y


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6), m=st.integers(1, 3), p=st.integers(1, 3), q=st.integers(1, 5), s=st.integers(1, 3))
def test_exact_data_show_the_structure(seed, m, p, q, s):
    rng = np.random.Generator(np.random.PCG64(seed))
    plant = random_system(m=m, p=p, q=q, blocks=(s,), seed=rng)
    found = estimate_structure(*record(plant, 150, rng), noise=0.0)
    assert (found.q, found.s) == (q, s)
    assert found.rho == tuple(max(s - j, 0) for j in range(1, 5))
    powers = [plant.C1 @ np.linalg.matrix_power(plant.A1, k) for k in range(q)]
    ranks = [np.linalg.matrix_rank(np.vstack(powers[: k + 1])) for k in range(q)]
    assert found.lag == ranks.index(q) + 1


@pytest.mark.parametrize("noise", [1e-3, None])
def test_noise_leaves_lower_bounds(rng, noise):
    right = 0
    for seed in range(10):
        plant = random_system(m=2, p=2, q=4, blocks=(2,), seed=seed)
        u, y = record(plant, 300, rng)
        found = estimate_structure(u, y + 1e-3 * rng.standard_normal(y.shape), noise=noise)
        assert found.q <= 4
        assert found.s <= 2
        right += (found.q, found.s) == (4, 2)
    assert right >= 7


def test_unobservable_and_unexcited_states_are_not_counted(rng):
    plant = random_system(m=2, p=2, q=5, blocks=(1,), unobservable=[0.5], uncontrollable=[0.8], seed=1)
    assert estimate_structure(*record(plant, 150, rng)).q == 4
    u = rng.uniform(-1, 1, (150, 2))
    at_rest = plant.system.simulate(u, np.zeros(5)).y
    assert estimate_structure(u, at_rest).q == 3


def test_poor_records_say_nothing(rng):
    assert estimate_structure(np.ones((80, 1)), np.ones((80, 1))) == StructureEstimate()
    assert estimate_structure(rng.uniform(-1, 1, (6, 1)), np.ones((6, 1))) == StructureEstimate()
    with pytest.raises(ValueError, match="s_max"):
        estimate_structure(np.ones((80, 1)), np.ones((80, 1)), s_max=0)
