# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The answers on the power grid and the water network."""

import numpy as np
import pytest

from plant_sim import net3, wscc9, wscc9_swing
from ros2_deepc.monitors import Prior, Verdict, analyze


def record(plant, K, seed, tail=False):
    """K samples under random inputs; with a tail, slow equal inputs from sample 104 on, as a controller would give."""
    rng = np.random.Generator(np.random.PCG64([seed, 1]))
    u = rng.uniform(plant.input_min, plant.input_max, (K, len(plant.input_names)))
    if tail:
        u[104:] = np.clip(0.3 * np.sin(np.arange(K - 104) / 9), -1, 1)[:, None]
    stepper = plant.start(seed)
    return u, np.array([stepper.push(v) for v in u])


def prior(plant):
    return Prior(q=plant.prior.q, s=plant.prior.s, n=plant.prior.n)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("K", "tail"), [(60, False), (104, False), (200, True)])
def test_power_transfers_cannot_change_net_power(seed, K, tail):
    plant = wscc9()
    report = analyze(*record(plant, K, seed, tail), prior=prior(plant))
    finding = report.r_controllability
    assert finding.verdict == Verdict.NOT_PROVED
    assert abs(finding.lambda_star - 1) < 1e-6
    assert finding.rank == finding.required - 1
    assert report.r_observability.verdict == Verdict.PROVED
    assert [m.place for m in report.modes if m.at_fault] == ["on"]
    assert report.c_controllability.verdict == report.c_observability.verdict == Verdict.REFUTED


@pytest.mark.parametrize("seed", range(4))
def test_full_inputs_control_the_grid(seed):
    plant = wscc9("full")
    report = analyze(*record(plant, 104, seed), prior=prior(plant))
    assert report.r_controllability.verdict == Verdict.PROVED
    assert report.r_observability.verdict == Verdict.PROVED
    assert report.printed[1].holds
    assert report.printed[3].holds
    assert not report.printed[2].holds
    assert not report.printed[4].holds


@pytest.mark.parametrize("seed", range(4))
def test_literal_outputs_of_the_grid(seed):
    plant = wscc9("text")
    report = analyze(*record(plant, 104, seed), prior=prior(plant))
    assert report.r_controllability.verdict == Verdict.NOT_PROVED
    assert abs(report.r_controllability.lambda_star - 1) < 1e-6


@pytest.mark.parametrize(
    ("inputs", "control", "observe", "theorem_3"),
    [
        ("junction", Verdict.NOT_PROVED, Verdict.NOT_PROVED, False),
        ("river", Verdict.NOT_PROVED, Verdict.PROVED, True),
        ("all", Verdict.PROVED, Verdict.PROVED, True),
    ],
)
def test_water_network(inputs, control, observe, theorem_3):
    plant = net3(inputs=inputs)
    for L in (None, 12):
        report = analyze(*record(plant, 100, 0), prior=prior(plant), L=L)
        assert report.r_controllability.verdict == control
        assert report.r_observability.verdict == observe
        assert report.printed[3].holds == theorem_3
        assert report.printed[3].rank == 3 * report.L + (5 if theorem_3 else 4)
        assert report.c_controllability.verdict == report.c_observability.verdict == Verdict.REFUTED
        if control != Verdict.PROVED:
            assert abs(report.r_controllability.lambda_star - 1) < 1e-6


@pytest.mark.parametrize("seed", range(2))
def test_an_undeclared_nonlinearity_is_noticed_from_the_first_window_on(seed):
    plant = wscc9_swing()
    u, y = record(plant, 45, seed)
    for K in range(18, 45):
        report = analyze(u[:K], y[:K], prior=prior(plant))
        assert report.r_controllability.verdict in (Verdict.UNDECIDED, Verdict.PRIOR_VIOLATED)
        assert report.r_observability.verdict in (Verdict.UNDECIDED, Verdict.PRIOR_VIOLATED)
    assert report.r_controllability.verdict == Verdict.PRIOR_VIOLATED


@pytest.mark.parametrize("decibel", [40, 80, 120])
def test_undeclared_noise_proves_nothing_however_short_the_window(decibel):
    plant = wscc9("full")
    u, clean = record(plant, 60, 0)
    rng = np.random.Generator(np.random.PCG64(decibel))
    y = clean + np.sqrt(np.mean(clean**2, axis=0)) * 10 ** (-decibel / 20) * rng.standard_normal(clean.shape)
    for K in range(15, 60):
        report = analyze(u[:K], y[:K], prior=prior(plant))
        assert report.r_controllability.verdict != Verdict.PROVED
        assert report.r_observability.verdict != Verdict.PROVED


def test_exact_data_prove_as_soon_as_one_column_could_have_contradicted():
    plant = wscc9("full")
    u, y = record(plant, 60, 0)
    first = next(K for K in range(60) if K and _proved(u[:K], y[:K], plant))
    assert first == 3 * 5 + 6 + 1 + 4  # m (L+s) + q columns, one more, L outputs; L = 4 is the lag
    assert not _proved(u[: first - 1], y[: first - 1], plant)


def _proved(u, y, plant):
    return analyze(u, y, prior=prior(plant)).r_controllability.verdict == Verdict.PROVED


def test_early_run_says_what_is_missing():
    plant = wscc9()
    report = analyze(*record(plant, 12, 0), prior=prior(plant))
    assert report.r_controllability.verdict == Verdict.UNDECIDED
    assert "more samples needed" in report.r_controllability.reason
