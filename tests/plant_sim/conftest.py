# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Random systems with planted structure, drawn once and shared."""

import numpy as np
import pytest

from plant_sim.random_systems import order, random_system

UNCONTROLLABLE = ([], [0.5], [1.0], [0.5 + 0.3j], [1.1, -0.4], [1.0, 1.0])
UNOBSERVABLE = ([], [0.7], [1.0], [0.2 + 0.8j])


def draw(index, conditioning=10.0):
    """System number ``index`` over m, p in 1..4, q in 0..12, s in 1..3, about half with something planted as lost."""
    rng = np.random.Generator(np.random.PCG64([index, 7]))
    m, p = (int(v) for v in rng.integers(1, 5, 2))
    q, s = int(rng.integers(0, 13)), int(rng.integers(1, 4))
    count = int(rng.integers(0 if q else 1, 4))
    blocks = [s, *(int(b) for b in rng.integers(1, s + 1, count - 1))] if count else []
    bad = UNCONTROLLABLE[rng.integers(6)] if rng.random() < 0.5 else []
    blind = UNOBSERVABLE[rng.integers(4)] if rng.random() < 0.5 else []
    if order(bad) + order(blind) > q or (p == 1 and (bad == [1.0, 1.0] or (1.0 in bad and 1.0 in blind))):
        bad, blind = [], []
    if m == 1 and 1.0 in bad and 1.0 in blind:
        blind = []
    cut = int(rng.integers(0, count + 1)) if rng.random() < 0.3 else 0
    hidden = int(rng.integers(0, count + 1)) if rng.random() < 0.3 else 0
    return random_system(
        m=m, p=p, q=q, blocks=blocks, uncontrollable=bad, unobservable=blind, uncontrollable_blocks=cut,
        unobservable_blocks=hidden, conditioning=conditioning, seed=rng,
    )  # fmt: skip


@pytest.fixture(scope="session")
def planted_systems():
    """Sixty systems."""
    return [draw(i) for i in range(60)]
