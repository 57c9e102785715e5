# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ros2_deepc.behavior import hankel


@given(T=st.integers(1, 12), d=st.integers(1, 3), L=st.integers(1, 12), seed=st.integers(0, 99))
def test_every_entry_is_the_sample_it_should_be(T, d, L, seed):
    w = np.random.Generator(np.random.PCG64(seed)).normal(size=(T, d))
    if L > T:
        with pytest.raises(ValueError, match=f"L = {L}"):
            hankel(w, L)
        return
    H = hankel(w, L)
    assert H.shape == (L * d, T - L + 1)
    for i in range(L):
        for j in range(T - L + 1):
            assert np.array_equal(H[i * d : (i + 1) * d, j], w[i + j])


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_names_the_bad_sample(bad):
    w = np.zeros((5, 2))
    w[3, 1] = bad
    with pytest.raises(ValueError, match=r"signal\[3, 1\]"):
        hankel(w, 2)


def test_shapes():
    assert hankel([1.0, 2.0, 3.0], 2).tolist() == [[1.0, 2.0], [2.0, 3.0]]
    with pytest.raises(ValueError, match="shape"):
        hankel(np.zeros((2, 2, 2)), 1)
    with pytest.raises(ValueError, match="L = 0"):
        hankel(np.zeros((4, 1)), 0)
