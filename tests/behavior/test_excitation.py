# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ros2_deepc.behavior import excitation_order, hankel


def by_definition(u):
    """The definition, order by order, with the rank of another implementation."""
    T, m = u.shape
    order = 0
    for L in range(1, T + 1):
        if np.linalg.matrix_rank(hankel(u, L)) < m * L:
            break
        order = L
    return order


@settings(max_examples=60, deadline=None)
@given(T=st.integers(1, 40), m=st.integers(1, 3), seed=st.integers(0, 10_000))
def test_white_input_excites_as_far_as_columns_go(T, m, seed):
    u = np.random.Generator(np.random.PCG64(seed)).uniform(-1, 1, (T, m))
    assert excitation_order(u) == (T + 1) // (m + 1) == by_definition(u)


@pytest.mark.parametrize("tones", [1, 2, 5])
def test_a_sum_of_sines_excites_of_order_two_per_tone(tones):
    k = np.arange(200)
    u = sum(np.cos(0.3 * (i + 1) * k + i) for i in range(tones))
    assert excitation_order(u) == 2 * tones


@settings(max_examples=40, deadline=None)
@given(order=st.integers(1, 6), seed=st.integers(0, 1000))
def test_an_autonomous_input_excites_of_its_order(order, seed):
    rng = np.random.Generator(np.random.PCG64(seed))
    poles = np.exp(1j * np.linspace(0.3, 2.8, order))
    u = np.real(np.vander(poles, 60, increasing=True).T @ rng.uniform(0.5, 1, order))
    assert excitation_order(u) == 2 * order == by_definition(u[:, None])


def test_limits():
    assert excitation_order(np.zeros((10, 2))) == 0
    assert excitation_order(np.ones(10)) == 1
    assert excitation_order(np.empty((0, 1))) == 0
    rng = np.random.Generator(np.random.PCG64(1))
    u = rng.uniform(-1, 1, (104, 3))
    assert excitation_order(u) == 26
    assert excitation_order(u[:100]) == 25  # 78 rows of order 26 have only 75 columns
    assert excitation_order(u, at_most=7) == 7
    assert excitation_order(u * [1e9, 1.0, 1e-9]) == 26  # units do not matter
    assert excitation_order(np.column_stack([u[:, 0], u[:, 0]])) == 0  # twice the same input
    with pytest.raises(ValueError, match="nan"):
        excitation_order([1.0, np.nan])
