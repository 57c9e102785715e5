# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Increments: proofs around an operating point that nobody knows, and none where a constant hides a mode."""

import numpy as np
import pytest

from plant_sim import random_system, wscc9
from plant_sim.random_systems import random_planted
from ros2_deepc.behavior import hankel
from ros2_deepc.monitors import Noise, Prior, Verdict, analyze_records, increments
from ros2_deepc.monitors.live import LiveMonitor


def record(planted, samples, rng, offset, std=0.0):
    """A record of the affine plant: constants of that size beside the inputs, in the states and on the outputs."""
    form = planted.system.weierstrass()
    m, p = form.B1.shape[1], form.C1.shape[0]
    markov = form.markov()
    u = rng.uniform(-1, 1, (samples + form.s - 1, m)) + offset * rng.normal(size=m)
    f, g = 0.1 * rng.normal(size=form.q), offset * rng.normal(size=p)
    z, y = rng.normal(size=form.q), np.empty((samples, p))
    for k in range(samples):
        y[k] = form.C1 @ z + g + sum(markov[i] @ u[k + i] for i in range(form.s))
        z = form.A1 @ z + form.B1 @ u[k] + f
    return u, y + std * rng.normal(size=y.shape)


def findings(u, y, prior, noise=0.0):
    records, level = increments([(u, y)], Noise(std=noise))
    report = analyze_records(records, prior=prior, noise=level)
    return report.r_controllability.verdict, report.r_observability.verdict


@pytest.mark.parametrize("offset", [0.0, 1.0, 100.0, 1e4])
@pytest.mark.parametrize("s", [1, 2, 3])
def test_what_holds_is_proved_whatever_the_operating_point(s, offset):
    rng = np.random.Generator(np.random.PCG64(s))
    for _ in range(5):
        planted = random_system(m=2, p=2, q=4, blocks=(s,), seed=rng)
        u, y = record(planted, 150, rng, offset)
        assert findings(u, y, Prior(q=4, s=s)) == (Verdict.PROVED, Verdict.PROVED)


def test_nothing_false_is_proved():
    rng = np.random.Generator(np.random.PCG64(7))
    proved = 0
    for i in range(150):
        planted = random_planted(rng)
        u, y = record(planted, 250, rng, 10.0 ** rng.uniform(-2, 4), std=(0.0, 1e-6)[i % 2])
        control, observe = findings(u, y, Prior(q=planted.q, s=planted.s), noise=(0.0, 1e-6)[i % 2])
        assert control is not Verdict.PROVED or planted.r_controllable
        assert observe is not Verdict.PROVED or planted.r_observable
        proved += (control is Verdict.PROVED) + (observe is Verdict.PROVED)
    assert proved > 60


def test_behind_a_conserved_quantity_nothing_is_proved():
    plant = wscc9()
    stepper, rng = plant.start(0), np.random.Generator(np.random.PCG64(0))
    u = rng.uniform(-1, 1, (200, 3))
    y = np.array([stepper.push(v) for v in u])
    assert np.ptp(y[:, 1]) < 1e-9  # c0 does not move, but for rounding
    assert Verdict.PROVED not in findings(u, y, Prior(q=6, s=1))


@pytest.mark.parametrize("noise", [Noise(std=[0.1, 2.0]), Noise(bound=[0.1, 2.0])])
def test_twice_the_bound_holds_for_the_noise_on_increments(noise):
    rng = np.random.Generator(np.random.PCG64(3))
    for _ in range(20):
        v = rng.normal(size=(200, 2)) if noise.bound is None else rng.uniform(-1, 1, (200, 2))
        ((_, dv),), level = increments([(rng.normal(size=(200, 1)), v * [0.1, 2.0])], noise)
        scale = np.array([0.1, 2.0])
        white = np.linalg.norm(hankel(v, 10), 2)
        assert np.linalg.norm(hankel(dv / scale, 10), 2) <= 2 * white
        np.testing.assert_allclose(level.per_output(scale), 2.0, rtol=1e-9)
        assert level.source == noise.source


def test_what_cannot_be_differenced_says_so():
    u, y = np.ones((5, 1)), np.ones((5, 1))
    with pytest.raises(ValueError, match="give its level"):
        increments([(u, y)], Noise(estimated=True))
    with pytest.raises(ValueError, match="noise is given for 3 outputs, the record has 1"):
        increments([(u, y)], Noise(std=[1.0, 1.0, 1.0]))
    with pytest.raises(ValueError, match="give its level"):
        LiveMonitor(Prior(q=1, s=1), form="incremental", window=10, period=5, noise=None)


@pytest.mark.parametrize("s", [1, 2])
def test_the_stream_says_what_the_batch_says(s):
    rng = np.random.Generator(np.random.PCG64(s))
    planted = random_system(m=2, p=2, q=3, blocks=(s,), seed=rng)
    u, y = record(planted, 121, rng, offset=50.0, std=1e-4)
    prior = Prior(q=3, s=s)
    live = LiveMonitor(prior, form="incremental", window=200, period=60, noise=1e-4)
    jobs, margins = [], []
    for k, v in enumerate(u):
        jobs += live.input(k, v)
        if k >= s - 1:
            if k - s + 1 == 70:  # these outputs are lost: no change is taken across the gap
                continue
            jobs += live.output(k - s + 1, y[k - s + 1])
        if jobs:
            live.analyse(jobs[-1])
            margins.append(live.indicator())
    assert [job.k for job in jobs] == [59, 119]
    report = live.analyse(jobs[-1]).report
    assert len(jobs[-1].records) == 2
    changes, level = increments(jobs[-1].records, Noise(std=1e-4))
    batch = analyze_records(changes, prior=prior, noise=level)
    assert report.r_controllability == batch.r_controllability
    assert report.r_controllability.verdict is Verdict.PROVED
    assert report.rank == report.rank_need  # a change across the gap would raise it
    assert margins[-1].rank == margins[-1].rank_need
