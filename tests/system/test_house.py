# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The house keeps its promises: one set of names in every build, YAML that fits its tables, launch files that load."""

import ast
import subprocess
import sys
import tomllib
import types
from configparser import ConfigParser
from dataclasses import fields
from importlib.metadata import entry_points
from pathlib import Path

import pytest
from deepc_msgs.msg import ControllerState, MonitorReport
from deepc_msgs.msg import Verdict as VerdictMsg

from ros2_deepc import dashboard
from ros2_deepc.bags import run
from ros2_deepc.control import Status
from ros2_deepc.control.modes import Mode
from ros2_deepc.monitors import Report, Verdict, live
from ros2_deepc.nodes.config import ROLES, load, node_class, shipped, validate
from ros2_deepc.ros import topics

ROOT = Path(__file__).parents[2]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def setup_arguments(package):
    """The keyword arguments of setup() in a setup.py, those that are literals."""
    tree = ast.parse((ROOT / package / "setup.py").read_text(encoding="utf-8"))
    (call,) = [n for n in ast.walk(tree) if isinstance(n, ast.Call) and getattr(n.func, "id", "") == "setup"]
    found = {}
    for keyword in call.keywords:
        try:
            found[keyword.arg] = ast.literal_eval(keyword.value)
        except ValueError:
            continue
    return found


def test_colcon_and_pip_install_the_same_entry_points():
    points = {}
    for package in ("ros2_deepc", "plant_sim"):
        for group, lines in setup_arguments(package)["entry_points"].items():
            for line in lines:
                name, target = (part.strip() for part in line.split("="))
                points.setdefault(group, {})[name] = target
    scripts = points.pop("console_scripts")
    project = PYPROJECT["project"]
    assert points == project["entry-points"]
    # ros2 run knows a node as <role>_node, the shell as ros2-deepc-<role>
    short = {name.removesuffix("_node").removeprefix("ros2-deepc-"): target for name, target in scripts.items()}
    assert short == {name.removeprefix("ros2-deepc-"): target for name, target in project["scripts"].items()}


def test_one_version_everywhere():
    version = PYPROJECT["project"]["version"]
    for package in ("msgs", "ros2_deepc", "plant_sim"):
        assert f"<version>{version}</version>" in (ROOT / package / "package.xml").read_text(encoding="utf-8")
    for package in ("ros2_deepc", "plant_sim"):
        assert setup_arguments(package)["version"] == version


def test_setup_cfg_puts_executables_where_ros2_run_looks():
    for package in ("ros2_deepc", "plant_sim"):
        config = ConfigParser()
        config.read(ROOT / package / "setup.cfg")
        assert config["install"]["install_scripts"] == config["develop"]["script_dir"] == f"$base/lib/{package}"


@pytest.mark.parametrize("path", sorted((ROOT / "launch_scripts" / "config").glob("*.yaml")), ids=lambda p: p.stem)
def test_every_yaml_fits_the_tables_of_its_nodes(path):
    parameters = load(path)
    assert set(parameters) == set(ROLES)
    validate(parameters)
    info = node_class("plant").info(parameters["plant"])
    for role, values in parameters.items():
        node_class(role).check(values, info)


@pytest.mark.parametrize("name", ["wscc9", "net3"])
def test_the_yaml_says_what_the_plant_suggests(name):
    parameters = load(shipped(name))
    plant = node_class("plant").plant_of(parameters["plant"])
    controller, operator = parameters["controller"], parameters["operator"]
    assert {key: controller[key] for key in plant.settings} == dict(plant.settings)
    assert operator["reference_k"] == [k for k, _ in plant.references]
    assert operator["reference_values"] == [v for _, values in plant.references for v in values]
    assert parameters["plant"]["steps"] == plant.steps


def test_the_installed_yaml_is_the_one_in_the_tree():
    for path in (ROOT / "launch_scripts" / "config").glob("*.yaml"):
        assert shipped(path.stem).read_text(encoding="utf-8") == path.read_text(encoding="utf-8")


def test_plants_and_their_node_are_found_by_entry_point():
    assert {"wscc9", "net3"} <= {entry.name for entry in entry_points(group="ros2_deepc.plants")}
    assert node_class("plant").__name__ == "PlantNode"


def test_executables_and_index_entries_are_installed():
    prefix = Path(sys.prefix)
    assert (prefix / "lib" / "plant_sim" / "plant_node").stat().st_mode & 0o111
    for role in ("controller", "monitor", "recorder", "operator"):
        assert (prefix / "lib" / "ros2_deepc" / f"{role}_node").stat().st_mode & 0o111
    for package in ("ros2_deepc", "plant_sim", "deepc_msgs"):
        assert (prefix / "share" / "ament_index" / "resource_index" / "packages" / package).exists()
        assert (prefix / "share" / package / "package.xml").exists()


@pytest.mark.parametrize("module", ["ros2_deepc.behavior", "ros2_deepc.monitors", "ros2_deepc.control", "plant_sim"])
def test_the_pure_parts_import_without_ros(module):
    code = f"import sys; sys.modules['rclpy'] = None; sys.modules['deepc_msgs'] = None; import {module}"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


class Action:
    """Stands in for the classes of `launch`, which is not on PyPI: keeps what it was given."""

    def __init__(self, *args, **kwargs):
        self.args, self.kwargs = args, kwargs


class LaunchModule(types.ModuleType):
    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        return type(name, (Action,), {})


@pytest.fixture
def launch(monkeypatch):
    for name in (
        "launch", "launch.actions", "launch.conditions", "launch.substitutions",
        "launch_ros", "launch_ros.actions", "launch_ros.parameter_descriptions", "launch_ros.substitutions",
    ):  # fmt: skip
        monkeypatch.setitem(sys.modules, name, LaunchModule(name))

    def describe(name):
        scope = {}
        exec(compile((ROOT / "launch_scripts" / f"{name}.launch.py").read_text(), name, "exec"), scope)
        return scope["generate_launch_description"]().args[0]

    return describe


def test_the_zone_launch_file_starts_every_node_with_an_installed_executable(launch):
    actions = launch("zone")
    nodes = [action.kwargs for action in actions if type(action).__name__ == "Node"]
    assert [node["name"] for node in nodes] == ["plant", "controller", "monitor", "operator", "recorder"]
    for node in nodes:
        assert (Path(sys.prefix) / "lib" / node["package"] / node["executable"]).exists()
        known = {row.name for row in node_class(node["name"]).parameters} | {"use_sim_time"}
        assert set(node["parameters"][1]) <= known
    arguments = [action.args[0] for action in actions if type(action).__name__ == "DeclareLaunchArgument"]
    assert {"namespace", "params_file", "seed", "mode", "record"} <= set(arguments)


@pytest.mark.parametrize("plant", ["wscc9", "net3"])
def test_each_plant_has_a_launch_file_of_its_own(launch, plant):
    (include,) = launch(plant)
    assert dict(include.kwargs["launch_arguments"]) == {"plant": plant}


def test_every_message_field_says_its_meaning():
    for path in sorted((ROOT / "msgs").glob("*/*.*")):
        for line in path.read_text(encoding="utf-8").splitlines():
            if line.strip() and not line.startswith(("#", "---")) and "=" not in line:
                assert "#" in line, f"{path.name}: {line}"


def test_the_topic_table_names_types_that_exist():
    for topic in topics.ALL:
        package, kind, name = topic.type_name.split("/")
        assert (Path(sys.prefix) / "share" / package / kind / f"{name}.msg").exists()


def test_modes_and_verdicts_have_the_same_numbers_everywhere():
    modes = {mode.name: int(mode) for mode in Mode}
    assert {name: getattr(ControllerState, name) for name in modes} == modes
    assert [mode.name for mode in Mode] == list(run.MODES) == list(dashboard._MODES)
    verdicts = {verdict.name: int(verdict) for verdict in Verdict}
    assert {name: getattr(VerdictMsg, name) for name in verdicts} == verdicts
    assert [verdict.name for verdict in Verdict] == list(run.VERDICTS)
    assert [verdict.name.replace("_", " ") for verdict in Verdict] == [text for text, _ in dashboard._VERDICTS]
    statuses = {f"STATUS_{status.name}": int(status) + 1 for status in Status}
    assert {name: getattr(ControllerState, name) for name in statuses} == statuses


def test_the_properties_are_those_of_report_and_message():
    assert run.PROPERTIES == live.PROPERTIES
    for name in live.PROPERTIES:
        assert hasattr(MonitorReport(), name)
        assert name in {field.name for field in fields(Report)}
