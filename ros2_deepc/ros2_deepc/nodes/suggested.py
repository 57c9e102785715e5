# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The parameters of a zone for any plant: those that come with the package, else what the plant itself suggests."""

import re
from pathlib import Path
from typing import Any

import numpy as np

from ..ros.parameters import ConfigError
from .config import Parameters, load, merged, node_class, shipped

PLANT_FILES = (".yaml", ".yml")


def zone_of(plant: str, options: list[str] | None = None) -> Parameters:
    """Parameters by role for a run in lockstep.

    Args:
        plant: name of a registered plant, or a plant's YAML file.
        options: of the plant, KEY=VALUE strings; None: those of the YAML that comes with the package.

    Raises:
        ConfigError: if there is no such plant, or it does not have these options.
    """
    file = Path(plant) if Path(plant).suffix in PLANT_FILES else None
    try:
        parameters = load(file or shipped(plant))
    except ConfigError:  # a plant's own file, or one that is registered but comes without parameters
        return _suggested(plant, options or [])
    if file is not None:
        raise ConfigError(f"{file} holds the parameters of a zone, not a plant: ros2-deepc run {file}")
    return parameters if options is None else merged(parameters, {"plant": {"options": options}})


def title_of(plant: str) -> str:
    """A short name for folders and namespaces: that of the plant, or of its file without what ROS does not take."""
    word = re.sub(r"\W", "_", Path(plant).stem if Path(plant).suffix in PLANT_FILES else plant, flags=re.ASCII)
    return word if not word[:1].isdigit() else f"plant_{word}"


def _suggested(name: str, options: list[str]) -> Parameters:
    plant = node_class("plant").plant_of({"plant": name, "options": options or [""]})  # type: ignore[attr-defined]
    lockstep: dict[str, Any] = {"use_sim_time": True}
    controller = {key: _plain(value) for key, value in plant.settings.items()}
    references = plant.references or ((0, np.zeros(len(plant.output_names))),)
    operator = {
        "reference_k": [k for k, _ in references],
        "reference_values": [float(v) for _, values in references for v in values],
    }
    return {
        "plant": {"plant": name, "options": options or [""], "mode": "lockstep", "seed": 0, "steps": plant.steps},
        "controller": lockstep | controller,
        "monitor": dict(lockstep),
        "operator": lockstep | operator,
        "recorder": dict(lockstep),
    }


def _plain(value: Any) -> Any:
    """A setting as a ROS parameter file holds it: one weight for all outputs is a list of one."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    return [float(v) for v in value] if isinstance(value, (list, tuple)) else value
