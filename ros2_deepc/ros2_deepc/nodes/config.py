# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The YAML of a zone: one ROS parameter file for all its nodes."""

from collections.abc import Mapping
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import yaml
from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

from ..ros.lifecycle import ManagedNode
from ..ros.parameters import ConfigError, check
from .controller_node import ControllerNode
from .monitor_node import MonitorNode
from .operator_node import OperatorNode
from .recorder_node import RecorderNode

Parameters = dict[str, dict[str, Any]]

_NODES: dict[str, type[ManagedNode]] = {
    "controller": ControllerNode,
    "monitor": MonitorNode,
    "operator": OperatorNode,
    "recorder": RecorderNode,
}
ROLES = ("plant", *_NODES)


def node_class(role: str) -> type[ManagedNode]:
    """The node of a role; the plant's comes from the entry point group `ros2_deepc.plant_node`.

    Raises:
        ConfigError: if no plant node is installed.
    """
    if role in _NODES:
        return _NODES[role]
    for entry in entry_points(group="ros2_deepc.plant_node", name=role):
        found: type[ManagedNode] = entry.load()
        return found
    raise ConfigError(
        "no plant node is installed: install plant_sim, or a package with the entry point ros2_deepc.plant_node"
    )


def shipped(name: str) -> Path:
    """Path of a YAML that comes with the package, e.g. wscc9.

    Raises:
        ConfigError: if there is none of that name.
    """
    try:
        folder = Path(get_package_share_directory("ros2_deepc")) / "config"
    except PackageNotFoundError:
        raise ConfigError("ros2_deepc is not installed here: run `pip install .` first") from None
    path = folder / f"{name}.yaml"
    if not path.is_file():
        there = ", ".join(sorted(file.stem for file in folder.glob("*.yaml")))
        raise ConfigError(f"unknown plant {name!r}; there are: {there}")
    return path


def load(path: Path) -> Parameters:
    """Parameters by role, from a file.

    Raises:
        ConfigError: if the file cannot be read or does not have the form of a ROS parameter file.
    """
    try:
        return parse(path.read_text(encoding="utf-8"), str(path))
    except OSError as error:
        raise ConfigError(f"cannot read {path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{path} is not a text file") from None


def parse(text: str, name: str) -> Parameters:
    """Parameters by role, from text that came from ``name``.

    Raises:
        ConfigError: if it does not have the form of a ROS parameter file.
    """
    try:
        tree = yaml.safe_load(text)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f", line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        raise ConfigError(f"{name}{where}: not valid YAML: {getattr(error, 'problem', error)}") from None
    parameters: Parameters = {}
    for pattern, body in (tree or {}).items() if isinstance(tree, dict) else ():
        role = str(pattern).rsplit("/", 1)[-1]
        if role not in ROLES or not isinstance(body, dict) or set(body) != {"ros__parameters"}:
            raise ConfigError(
                f"{name}: section {pattern!r} should be one of {', '.join('/**/' + r for r in ROLES)}, "
                "with everything under ros__parameters"
            )
        parameters[role] = dict(body["ros__parameters"] or {})
    if not parameters:
        raise ConfigError(f"{name}: no section for any node: {', '.join('/**/' + r for r in ROLES)}")
    return parameters


def validate(parameters: Parameters) -> None:
    """Checks every value against the table of its node.

    Raises:
        ConfigError: in one line, for the first that does not fit.
    """
    for role, values in parameters.items():
        check(role, node_class(role).parameters, values)


def text_of(parameters: Mapping[str, Mapping[str, Any]]) -> str:
    """Parameters by role as a ROS parameter file."""
    tree = {f"/**/{role}": {"ros__parameters": dict(values)} for role, values in parameters.items()}
    return yaml.safe_dump(tree, sort_keys=False, default_flow_style=None)


def merged(base: Parameters, changes: Mapping[str, Mapping[str, Any]]) -> Parameters:
    """A copy of ``base`` with the values of ``changes`` on top."""
    return {role: {**base.get(role, {}), **changes.get(role, {})} for role in (*base, *(set(changes) - set(base)))}
