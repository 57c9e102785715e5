# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Verdicts on a small plant whose properties are known by construction."""

import numpy as np
import pytest

from ros2_deepc.monitors import Prior, Verdict, analyze

A = np.diag([0.9, -0.4, 0.5]) + np.diag([0.3, 0.2], 1)
C = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def simulate(A, B, C, u, x):
    y = np.empty((len(u), len(C)))
    for k, v in enumerate(u):
        y[k], x = C @ x, A @ x + B @ v
    return y


@pytest.fixture
def rng():
    return np.random.Generator(np.random.PCG64(7))


def record(rng, B, T=60, C=C):
    u = rng.uniform(-1, 1, (T, B.shape[1]))
    return u, simulate(A, B, C, u, rng.uniform(-1, 1, 3))


def test_controllable_and_observable_plant_is_proved(rng):
    u, y = record(rng, np.array([[0.0], [0.0], [1.0]]))
    report = analyze(u, y, prior=Prior(q=3))
    assert report.r_controllability.verdict == Verdict.PROVED
    assert report.r_observability.verdict == Verdict.PROVED
    assert report.rank == report.rank_need
    np.testing.assert_allclose(sorted(m.lambda_.real for m in report.modes), [-0.4, 0.5, 0.9], atol=1e-9)


def test_uncontrollable_mode_is_named(rng):
    u, y = record(rng, np.array([[1.0], [1.0], [0.0]]))
    report = analyze(u, y, prior=Prior(q=3))
    assert report.r_controllability.verdict == Verdict.NOT_PROVED
    assert report.r_controllability.lambda_star == pytest.approx(0.5, abs=1e-9)
    assert report.r_controllability.rank == report.r_controllability.required - 1
    assert report.r_observability.verdict == Verdict.PROVED
    assert [m.at_fault for m in report.modes] == [True, False, False]
    assert report.modes[0].place == "inside"


def test_unobservable_plant_is_not_proved(rng):
    u, y = record(rng, np.array([[0.0], [0.0], [1.0]]), C=np.array([[0.0, 0.0, 1.0]]))
    report = analyze(u, y, prior=Prior(q=3))
    assert report.r_observability.verdict == Verdict.NOT_PROVED
    assert report.r_controllability.verdict == Verdict.UNDECIDED


def test_short_record_says_how_many_samples_are_missing(rng):
    u, y = record(rng, np.array([[0.0], [0.0], [1.0]]), T=6)
    report = analyze(u, y, prior=Prior(q=3))
    need = int(report.r_controllability.reason.split()[0]) + 6
    assert report.r_controllability.verdict == Verdict.UNDECIDED
    u, y = record(rng, np.array([[0.0], [0.0], [1.0]]), T=need)
    assert analyze(u, y, prior=Prior(q=3)).r_controllability.verdict == Verdict.PROVED


def test_prior_too_small_is_noticed(rng):
    u, y = record(rng, np.array([[0.0], [0.0], [1.0]]))
    report = analyze(u, y, prior=Prior(q=2))
    assert report.r_controllability.verdict == Verdict.PRIOR_VIOLATED
    assert report.estimate.q == 3


@pytest.mark.parametrize("noise", [0.0, 1e-4])
def test_margins_over_the_plane_are_never_below_the_least(rng, noise):
    u, y = record(rng, np.array([[0.0], [0.0], [1.0]]), T=200)
    y += noise * rng.standard_normal(y.shape)
    report = analyze(u, y, prior=Prior(q=3), noise=noise)
    finding = report.r_controllability
    assert report.margins(finding.lambda_star) == pytest.approx(finding.margin, abs=1e-6)
    axis = np.linspace(-1.5, 1.5, 41)
    plane = axis + 1j * axis[:, None]
    margins = report.margins(plane)
    assert margins.shape == plane.shape
    assert margins.min() > finding.margin - 0.5  # the search ends within a tenth of the value
    np.testing.assert_allclose(margins, report.margins(plane.conj()), atol=1e-6)
    assert np.isfinite(report.margins(np.inf))
    short = analyze(u[:5], y[:5], prior=Prior(q=3), noise=noise)
    assert np.isnan(short.margins([0.0, 1j])).all()
