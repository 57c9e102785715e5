# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The command line as a stranger uses it: in a process of its own, bad input first."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

COMMAND = Path(sys.executable).parent / "ros2-deepc"


@pytest.fixture
def deepc(tmp_path, domain_id):
    """Runs ros2-deepc and returns the finished process."""

    def run(*arguments):
        env = dict(os.environ, ROS_DOMAIN_ID=str(domain_id))
        return subprocess.run(
            [str(COMMAND), *map(str, arguments)], capture_output=True, text=True, timeout=100, cwd=tmp_path, env=env
        )

    return run


@pytest.mark.parametrize(
    ("arguments", "hint"),
    [
        (["demo", "nosuch"], "unknown plant 'nosuch'; there are: net3, net3_epanet, wscc9, wscc9_swing"),
        (["demo", "--out", "/proc/nope"], "choose another folder with --out"),
        (["demo", "--set", "controller.T=60", "--out", "run"], "needs T >= 85"),
        (["demo", "--set", "controller.N=-3", "--out", "run"], "N = -3"),
        (["demo", "--set", "monitor.period=0", "--out", "run"], "out of range 1..1000000"),
        (["demo", "--set", "monitor.perio=5", "--out", "run"], "did you mean period?"),
        (["demo", "--set", "nonsense", "--out", "run"], "NODE.PARAMETER=VALUE"),
        (["demo", "--set", "controller.terminal=maybe", "--out", "run"], "not one of none, equilibrium, hard, soft"),
        (["demo", "--set", "operator.reference_values=[1.0]", "--out", "run"], "2 references of 2 outputs"),
        (["demo", "-o", "variant=foo", "--out", "run"], "no variant 'foo'"),
        (["demo", "-o", "foo", "--out", "run"], "KEY=VALUE"),
        (["demo", "--executor", "multi", "--out", "run"], "choose one of events, single"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing_behind(deepc, tmp_path, arguments, hint):
    done = deepc(*arguments)
    assert done.returncode == 1
    assert hint in done.stderr
    assert done.stderr.startswith("error: ")
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "run").exists()


def test_a_folder_in_use_is_not_touched(deepc, tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "mine.txt").write_text("mine")
    done = deepc("demo", "--out", "run")
    assert done.returncode == 1
    assert "not an empty folder" in done.stderr
    assert [file.name for file in (tmp_path / "run").iterdir()] == ["mine.txt"]


@pytest.mark.parametrize("arguments", [["nothing"], ["demo", "--steps", "0"], ["demo", "--nope"]])
def test_wrong_usage_exits_with_2(deepc, arguments):
    done = deepc(*arguments)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr


def test_help_teaches(deepc):
    done = deepc("demo", "--help")
    assert done.returncode == 0
    for word in ("--seed", "--steps", "--executor", "--processes", "Examples"):
        assert word in done.stdout


def test_a_demo_leaves_bag_figure_and_summary(deepc, tmp_path):
    done = deepc("demo", "wscc9", "--steps", "120", "--seed", "4", "--out", "run")
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert "CONTROLLING" in done.stdout
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert (summary["plant"], summary["seed"], summary["steps"]) == ("wscc9", 4, 120)
    assert (tmp_path / "run" / "figure.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "run" / "bag" / "metadata.yaml").exists()
    assert not (tmp_path / "run" / "FAILED").exists()


def test_a_demo_of_a_plant_from_a_file_takes_what_the_plant_suggests(deepc, tmp_path):
    """The example of docs/plants.md, as every command takes it."""
    page = (Path(__file__).parents[2] / "docs" / "plants.md").read_text(encoding="utf-8")
    text = next(part for part in page.split("```") if "name: two_tanks" in part).removeprefix("yaml\n")
    (tmp_path / "two tanks.yaml").write_text(text)
    done = deepc("demo", "two tanks.yaml", "--steps", "120", "--out", "run")
    assert (done.returncode, done.stderr) == (0, "")
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert (summary["plant"], summary["steps"]) == ("two_tanks", 120)
    assert summary["outputs"]["level"]["rmse"][-1] < 1e-6
    assert summary["verdicts"]["r_controllability"] == "PROVED"


def test_a_demo_tells_a_zone_from_a_plant(deepc, tmp_path):
    config = Path(__file__).parents[2] / "launch_scripts" / "config" / "wscc9.yaml"
    done = deepc("demo", config, "--out", "run")
    assert done.returncode == 1
    assert "holds the parameters of a zone, not a plant: ros2-deepc run" in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.fixture(scope="module")
def recorded(tmp_path_factory, domain_id):
    """The folder of a short run."""
    folder = tmp_path_factory.mktemp("recorded")
    env = dict(os.environ, ROS_DOMAIN_ID=str(domain_id))
    command = [str(COMMAND), "demo", "net3", "--steps", "120", "--out", str(folder / "run")]
    subprocess.run(command, check=True, capture_output=True, timeout=100, env=env)
    return folder / "run"


def test_a_replay_through_todays_code_is_the_same_to_the_bit(deepc, recorded):
    done = deepc("replay", recorded / "bag", "--recompute", "all")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "the same to the bit" in done.stdout
    assert json.loads((recorded / "summary.json").read_text())["loop_hash"] in done.stdout.replace("\n", "")


def test_a_replay_with_other_settings_names_the_first_difference(deepc, recorded, tmp_path):
    other = tmp_path / "other.yaml"
    other.write_text((recorded / "settings.yaml").read_text().replace("terminal: equilibrium", "terminal: none"))
    done = deepc("replay", recorded / "bag", "--recompute", "controller", "--settings", other)
    assert done.returncode == 1
    assert "inputs of epoch 1 k = 100" in done.stdout.replace("\n", " ")
    asked = deepc("replay", recorded / "bag", "--what-if", other, "--out", "both.png")
    assert asked.returncode == 0
    assert (tmp_path / "both.png").read_bytes().startswith(b"\x89PNG")


def test_a_replay_publishes_every_message(deepc, recorded):
    done = deepc("replay", recorded / "bag", "--rate", "0")
    assert done.returncode == 0
    assert "messages published" in done.stdout


def test_report_check_export_and_layout(deepc, recorded, tmp_path):
    assert deepc("report", recorded / "bag", "--out", "run.html").returncode == 0
    page = (tmp_path / "run.html").read_text(encoding="utf-8")
    assert "net3" in page
    assert "http://" not in page.replace("http://www.w3.org", "")
    assert deepc("check", recorded / "bag").returncode == 0
    assert deepc("export", recorded / "bag", "--out", "run.csv").returncode == 0
    assert (tmp_path / "run.csv").read_text(encoding="utf-8").count("\n") == 121
    assert deepc("layout", recorded / "bag", "--out", "run.json").returncode == 0
    assert json.loads((tmp_path / "run.json").read_text())


def test_plants_are_listed_and_described(deepc):
    listed = deepc("plants")
    assert listed.returncode == 0
    assert "wscc9" in listed.stdout
    assert "net3" in listed.stdout
    one = deepc("plants", "wscc9")
    assert "n = 12, q = 6, r = 6, s = 1" in one.stdout
    assert "R-controllable: NO, 5 of 6, lost at lambda = 1.000000" in one.stdout
    assert deepc("plants", "nosuch").stderr.startswith("error: unknown plant 'nosuch'")


@pytest.mark.parametrize("command", ["analyze", "replay", "report", "check", "export", "layout"])
def test_a_bag_that_is_not_there_is_one_line(deepc, command):
    extra = (
        ["--recompute", "all"] if command == "replay" else ["--out", "x.csv"] if command in ("export", "layout") else []
    )
    done = deepc(command, "nowhere", *extra)
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith("error: ")
