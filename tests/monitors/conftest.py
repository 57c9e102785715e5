# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Random plants with planted structure, and their records."""

import numpy as np
import pytest

from plant_sim import random_system


def run(planted, K, rng, spread=1.0, u=None):
    """K outputs of a planted system under uniform inputs; u is s-1 samples longer than y."""
    if u is None:
        u = rng.uniform(-1, 1, (K + planted.s - 1, planted.system.m))
    trajectory = planted.system.simulate(u, spread * rng.standard_normal(planted.q))
    return u, trajectory.y


def draw(rng, **wanted):
    """A random plant of random size; keywords override, as for `random_system`."""
    s = wanted.pop("s", int(rng.integers(1, 4)))
    blocks = (s, *rng.integers(1, s + 1, rng.integers(0, 2)))
    size = {"m": int(rng.integers(1, 4)), "p": int(rng.integers(1, 4)), "q": int(rng.integers(2, 9)), "blocks": blocks}
    return random_system(**(size | wanted), seed=rng)


def length(planted, L, spare):
    """Outputs that make windows of L rich, and some to spare."""
    m = planted.system.m
    return (m + 1) * L + m * planted.s + planted.q + spare


@pytest.fixture
def rng():
    return np.random.Generator(np.random.PCG64(7))
