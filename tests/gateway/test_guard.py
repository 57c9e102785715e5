# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Nothing that should not reaches the field, and every refusal is counted with its reason."""

import math
from collections import Counter

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ros2_deepc.gateway import Refusal

GOOD = (0.1, 0.6)
CASES = {
    Refusal.ZONE: {"zone": "other"},
    Refusal.PERMIT: {"source": "viewer"},
    Refusal.EPOCH: {"epoch": 1},
    Refusal.SIZE: {"values": [0.1]},
    Refusal.QUALITY: {"quality": [0, 3]},
    Refusal.NOT_FINITE: {"values": [math.nan, 0.6]},
    Refusal.RANGE: {"values": [1.0000001, 0.6]},
    Refusal.RATE: {"values": [0.61, 0.6]},
}


@pytest.mark.parametrize("reason", CASES)
def test_one_reason_at_a_time(bench, reason):
    b = bench().start()
    b.controller = False
    k = b.samples[-1].k + 1
    before, reached = b.gateway.guard.counts.refused.copy(), len(b.reached)
    b.command(k)
    b.flush()
    b.run(0.1)
    assert b.command(k + 1, **({"values": GOOD} | CASES[reason])) is reason
    assert b.gateway.guard.counts.refused - before == Counter({reason: 1})
    b.flush()
    assert len(b.reached) <= reached + 1


def test_late_early_and_stale(bench):
    b = bench().start()
    b.controller = False
    b.run(0.1)
    k = b.samples[-1].k
    assert b.command(k) is Refusal.LATE
    assert b.command(k + 2) is Refusal.EARLY
    b.scanning = False
    b.run(0.3)
    assert b.command(k + 1) is Refusal.LATE  # its scan may have happened by now
    assert b.command(k + 2) is None  # while this one may still be in time
    b.run(0.5)
    assert b.command(k + 2) in (Refusal.MODE, Refusal.STALE)  # nothing is passed on without samples


def test_what_comes_after_the_last_moment_of_its_sample_is_late(bench):
    b = bench().start()
    b.controller = False
    b.run(0.1)
    k, now = b.samples[-1].k, b.now
    b.now = now + 0.079
    assert b.command(k + 1) is None
    b.now = now + 0.081
    assert b.command(k + 1) is Refusal.LATE


def test_clamping_brings_the_value_to_what_is_allowed_and_is_counted(bench, text):
    b = bench(text.replace("on_violation: clamp,", "on_violation: clamp, permit: [controller, operator],")).start()
    b.controller = False
    b.run(0.1)
    assert b.command(b.samples[-1].k + 1, (0.1, 99.0)) is None
    b.flush()
    assert tuple(b.reached[-1][1]) == (0.1, 2.0)
    assert b.gateway.guard.counts.clamped == 1


def test_who_may_write_one_input_only_may_write_none(bench, text):
    b = bench(text.replace("on_violation: clamp,", "on_violation: clamp, permit: [operator],"))
    b.run(0.5)
    b.gateway.auto(b.now)
    b.run(1.0)
    assert b.gateway.state == "RUN"
    assert b.command(0) is Refusal.PERMIT
    b.flush()
    assert b.reached == []


ATTACKS = 10_000
number = st.one_of(st.floats(), st.floats(-1.5, 1.5), st.sampled_from([math.nan, math.inf, -math.inf, 1e308, -0.0]))


def attack(rng, epoch, k):
    """A command that is wrong in any number of ways, or in none."""
    numbers = [math.nan, math.inf, -math.inf, 1e308, -5e-324, *rng.uniform(-1.2, 1.2, 8), *rng.uniform(-0.3, 0.3, 12)]
    size = rng.choice([2, 2, 2, 2, 2, 2, 2, 0, 1, 3])
    return {
        "zone": rng.choice(["tank"] * 9 + ["other"]),
        "source": rng.choice(["controller"] * 9 + ["viewer"]),
        "epoch": int(rng.choice([epoch] * 9 + [0, 1, epoch + 1, 2**32 - 1])),
        "k": int(k + rng.choice([1] * 9 + [0, -1, 2, 10**9, -(10**9)])),
        "values": [float(rng.choice(numbers)) for _ in range(size)],
        "quality": [(), (), (), (), (), (0, 0), (1, 0), (0,), (0, 3)][rng.integers(9)],
    }


def test_ten_thousand_hostile_writes(coarse):
    rng = np.random.Generator(np.random.PCG64(8))
    verdicts = Counter()
    while verdicts.total() < ATTACKS:
        b = coarse().start()
        b.controller = False
        guard, last = b.gateway.guard, b.reached[-1][1]
        before, mine = Counter(guard.counts.refused), Counter()
        passed = guard.counts.passed + guard.counts.clamped
        while b.gateway.state != "FALLBACK" and mine.total() < 500:
            if rng.random() < 0.1:
                b.run(0.1)
            n, k = len(b.reached), b.samples[-1].k
            verdict = b.command(**attack(rng, b.gateway.epoch, k))
            b.flush()
            mine[verdict] += 1
            for _, u in b.reached[n:]:
                assert verdict is None
                assert np.isfinite(u).all()
                assert (np.abs(u) <= [1, 2]).all()
                assert (np.abs(u - last) <= np.array([0.5, 4.0]) * (1 + 1e-6)).all()
                last = u
        assert guard.counts.passed + guard.counts.clamped - passed == mine.pop(None, 0)
        assert Counter(guard.counts.refused) - before == mine
        verdicts += mine
    assert set(verdicts) >= set(Refusal) - {Refusal.STALE, Refusal.MODE, Refusal.FOREIGN}


@given(st.lists(number, min_size=2, max_size=2), st.lists(number, min_size=2, max_size=2))
@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
def test_what_passes_is_in_range_and_within_rate_of_what_was_written(coarse, first, second):
    b = coarse().start()
    b.controller = False
    b.run(0.1)
    last = b.reached[-1][1]
    for values in (first, second):
        n = len(b.reached)
        b.command(b.samples[-1].k + 1, values)
        b.flush()
        if len(b.reached) > n:
            u = b.reached[-1][1]
            assert (np.abs(u) <= [1, 2]).all()
            assert (np.abs(u - last) <= np.array([0.5, 4.0]) * (1 + 1e-6)).all()
            assert u[0] == values[0]  # refused or passed on as it is, never bent
            last = u
        b.run(0.1)


def test_things_that_are_not_numbers_at_all(bench):
    b = bench().start()
    b.controller = False
    b.run(0.1)
    for values in (["a", "b"], [[1], [2]], [None, 1.0], [1j, 0], ["1", "0.6"]):
        verdict = b.command(b.samples[-1].k + 1, values)
        assert verdict in (Refusal.NOT_FINITE, Refusal.SIZE, Refusal.RATE, None)
        assert np.isfinite(b.gateway.guard.last).all()
