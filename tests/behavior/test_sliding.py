# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ros2_deepc.behavior import SlidingFactor, SlidingGram, hankel


def samples(n, channels, seed):
    return np.random.Generator(np.random.PCG64(seed)).normal(size=(n, channels))


@settings(max_examples=60, deadline=None)
@given(
    channels=st.integers(1, 3),
    blocks=st.integers(1, 4),
    columns=st.integers(1, 30),
    chunk=st.integers(0, 9),
    n=st.integers(1, 120),
)
def test_factor_has_the_gram_of_the_window_after_every_push(channels, blocks, columns, chunk, n):
    w = samples(n, channels, 1)
    sliding = SlidingFactor(channels, blocks, columns, chunk)
    for k in range(n):
        sliding.push(w[k])
        R = sliding.factor()
        held = min(max(0, k + 2 - blocks), columns)
        assert sliding.held == held
        assert sliding.full == (held == columns)
        if held:
            H = hankel(w[: k + 1], blocks)[:, -held:]
            assert np.abs(R.T @ R - H @ H.T).max() < 1e-12 * max(1, held)
        else:
            assert R.shape == (0, channels * blocks)


@settings(max_examples=60, deadline=None)
@given(
    blocks=st.integers(1, 4),
    columns=st.integers(1, 30),
    cuts=st.lists(st.integers(0, 99), max_size=6),
    chunk=st.integers(0, 5),
    rows=st.permutations(range(4)),
)
def test_no_column_spans_a_cut_and_rows_come_as_ordered(blocks, columns, cuts, chunk, rows):
    w = samples(100, 2, 6)
    order = [i for i in rows if i < 2 * blocks]
    sliding = SlidingFactor(2, blocks, columns, chunk, order)
    for k in range(100):
        if k in cuts:
            sliding.cut()
        sliding.push(w[k])
    begin = 100 - columns - blocks + 1
    edges = [begin, *sorted({cut for cut in cuts if cut > begin}), 100]
    pieces = [hankel(w[a:b], blocks) for a, b in pairwise(edges) if b - a >= blocks]
    H = np.hstack(pieces)[order] if pieces else np.zeros((len(order), 0))
    R = sliding.factor()
    assert sliding.held == H.shape[1]
    assert np.abs(R.T @ R - H @ H.T).max(initial=0) < 1e-12 * columns
    assert np.all(np.tril(R, -1) == 0)


@settings(max_examples=60, deadline=None)
@given(channels=st.integers(1, 3), blocks=st.integers(1, 5), columns=st.integers(1, 30), extra=st.integers(0, 80))
def test_gram_is_the_windows(channels, blocks, columns, extra):
    length = columns + blocks - 1
    w = samples(length + extra, channels, 2)
    gram = SlidingGram(channels, blocks, columns)
    for k, sample in enumerate(w):
        assert gram.full == (k >= length)
        gram.push(sample)
    H = hankel(w[extra:], blocks)
    assert np.abs(gram.matrix - H @ H.T).max() < 1e-12 * columns


def test_a_new_record_forgets_the_old_one():
    w = samples(40, 2, 3)
    gram, sliding = SlidingGram(2, 3, 10), SlidingFactor(2, 3, 10)
    for sample in w[:25]:
        gram.push(sample)
        sliding.push(sample)
    gram.clear()
    sliding.clear()
    with pytest.raises(ValueError, match="0 of 12 samples"):
        gram.matrix  # noqa: B018
    for sample in w[25:]:
        gram.push(sample)
        sliding.push(sample)
    H = hankel(w[-12:], 3)
    assert np.allclose(gram.matrix, H @ H.T, rtol=0, atol=1e-12)
    R = sliding.factor()
    assert np.allclose(R.T @ R, H @ H.T, rtol=0, atol=1e-12)


@pytest.mark.parametrize("kind", [SlidingGram, SlidingFactor])
def test_a_spike_leaves_nothing_behind(kind):
    """20 000 pushes with a 1e5-fold spike: as good as fresh once it has left; benchmarks/sliding.py pushes 1e5."""
    channels, blocks, columns, n = 3, 4, 60, 20_000
    w = samples(n, channels, 4)
    w[n - 2 * columns - 5] *= 1e5
    sliding = kind(channels, blocks, columns)
    for sample in w:
        sliding.push(sample)
    H = hankel(w[-(columns + blocks - 1) :], blocks)
    S = sliding.matrix if kind is SlidingGram else sliding.factor().T @ sliding.factor()
    assert np.abs(S - H @ H.T).max() < 1e-13 * np.abs(S).max()


def test_factor_keeps_what_a_gram_matrix_cannot_hold():
    """One direction is 1e-9 as strong as the rest: rounding of the factor leaves six digits of it, of the Gram none."""
    n, blocks, columns = 3000, 3, 50
    rng = np.random.Generator(np.random.PCG64(5))
    common = rng.normal(size=n)
    w = np.column_stack([common, common + 1e-9 * rng.normal(size=n)])
    sliding = SlidingFactor(2, blocks, columns)
    for sample in w:
        sliding.push(sample)
    fresh = np.linalg.svd(hankel(w[-(columns + blocks - 1) :], blocks), compute_uv=False)
    kept = np.linalg.svd(sliding.factor(), compute_uv=False)
    assert np.abs(kept / fresh - 1).max() < 1e-5
    assert fresh[-1] / fresh[0] < 1e-8
