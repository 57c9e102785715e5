# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Both case studies end to end, against their reference values."""

import numpy as np
import pytest

SEEDS = range(10)


def seeded(seed, options=None):
    changes = {"plant": {"seed": seed}, "controller": {"seed": seed}}
    if options:
        changes["plant"]["options"] = [options]
    return changes


@pytest.mark.parametrize("seed", SEEDS)
def test_wscc9_tracks_the_speed_and_cannot_move_c0(demo, seed):
    summary, run, _ = demo("wscc9", changes=seeded(seed))
    assert all(rmse < 0.035 for rmse in summary["outputs"]["x1"]["rmse"])
    assert len(summary["outputs"]["x1"]["rmse"]) == 2
    assert summary["outputs"]["c0"]["peak_to_peak"] < 1e-10
    assert summary["controller"]["failures"] == 0
    assert summary["verdicts"]["r_controllability"] == "NOT_PROVED"
    assert summary["verdicts"]["r_observability"] == "PROVED"
    assert abs(run.reports.lambda_star[-1, 0] - 1.0) < 1e-6


@pytest.mark.parametrize("seed", SEEDS)
def test_net3_tank_follows_and_the_reservoir_does_not_move(demo, seed):
    summary, run, _ = demo("net3", changes=seeded(seed))
    lake, tank = run.y.T
    assert np.abs(tank[150:160] - 3.0).max() < 0.01
    assert np.abs(tank[190:200] - 5.0).max() < 0.01
    assert np.abs(lake - 4.0).max() < 1e-9
    assert summary["controller"]["failures"] == 0
    assert summary["verdicts"]["r_controllability"] == "NOT_PROVED"


@pytest.mark.parametrize(("plant", "options"), [("wscc9", "variant=full"), ("net3", "inputs=all")])
def test_with_all_inputs_controllability_is_proved(demo, plant, options):
    summary, _, _ = demo(plant, changes=seeded(0, options))
    assert summary["verdicts"]["r_controllability"] == "PROVED"
    assert summary["verdicts"]["r_observability"] == "PROVED"
    assert summary["controller"]["failures"] == 0
