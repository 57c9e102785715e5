# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The command tune, from a bag to settings that the controller takes."""

import pytest
import yaml

from ros2_deepc.nodes.controller_settings import settings_for

SMALL = ("-N", "2", "-N", "4", "-L", "5", "-L", "8", "-q", "0", "-q", "2", "-T", "60")


def test_finds_settings_draws_them_and_writes_what_the_controller_takes(deepc, record, make, tmp_path, monkeypatch):
    """Exact data of order 2 under white inputs: everything predicts alike, the simplest choice wins."""
    bag = record(K=300, collect=300).folder
    monkeypatch.setenv("FORCE_COLOR", "1")  # as on a terminal: progress is shown
    code, out, err = deepc("tune", bag, *SMALL, "--out", tmp_path / "tuned")
    assert (code, err) == (0, "")
    assert "trying" in out
    assert "100%" in out
    chosen = yaml.safe_load((tmp_path / "tuned" / "controller.yaml").read_text())["/**/controller"]["ros__parameters"]
    assert chosen == {"N": 2, "L": 8, "q": 2, "T": 60, "form": "absolute"}
    settings = settings_for(chosen, make.plant_info())
    assert (settings.N, settings.L, settings.q, settings.T) == (2, 8, 2, 60)
    picture = (tmp_path / "tuned" / "tuning.png").read_bytes()
    assert picture.startswith(b"\x89PNG")
    assert len(picture) > 10_000


def test_processes_change_nothing_and_other_bags_are_named_by_channel(deepc, record):
    pytest.importorskip("joblib")
    bag = record(K=300, collect=300).folder
    _, alone, _ = deepc("tune", bag, *SMALL)
    channels = [
        f"--{kind}put={topic}:values[{i}]"
        for kind, topic in (("in", "/grid/inputs"), ("out", "/grid/outputs"))
        for i in (0, 1)
    ]
    code, together, err = deepc("tune", bag, *SMALL, "--jobs", 2)
    assert (code, err) == (0, "")
    assert together == alone
    assert "best: N = 2, L = 8, q = 2, T = 60, form = absolute" in alone
    code, named, err = deepc("tune", bag, *SMALL, *channels)
    assert (code, err) == (0, "")
    assert "best: N = " in named


@pytest.mark.parametrize(
    ("how", "hint"),
    [
        (("-T", "5"), "needs T >= "),
        (("-T", "290"), "need a record of about "),
        (("-N", "0"), "N = 0: must be a whole number >= 1"),
        (("-L", "0"), "L = 0: must be a whole number >= 1"),
        (("-q", "-1"), "q = -1: must be a whole number >= 0"),
        (("--namespace", "/moon"), "/moon"),
        (("--input", "/grid/inputs:values[0]"), "one output channel"),
        (("--input", "/moon:values[0]", "--output", "/grid/outputs:values[0]"), "/moon"),
    ],
)
def test_bad_input_is_one_line(deepc, record, how, hint):
    code, _, err = deepc("tune", record(K=100, collect=100).folder, *how)
    assert code == 1
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    assert hint in err


def test_bags_that_are_none(deepc, tmp_path):
    for folds, bag, expected, hint in ((4, "nowhere", 1, "nowhere"), (0, "nowhere", 2, "folds")):
        code, _, err = deepc("tune", tmp_path / bag, "--folds", folds)
        assert code == expected
        assert hint in err
