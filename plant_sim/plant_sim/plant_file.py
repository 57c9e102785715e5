# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""A plant of your own from a YAML file: matrices, a grid case, or a water network."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from .arrays import Array, matrix
from .descriptor import DescriptorSystem
from .errors import PlantError
from .plant import Plant, linear_start, suggested_settings, system_prior
from .power import from_case
from .water import from_inp

MATRICES = ("E", "A", "B", "C", "D")
COMMON = {"name", "description", "references", "settings", "steps", "input_min", "input_max", "initial"}
OWN = COMMON | {"sample_time", "input_names", "input_units", "output_names", "output_units", "state_names", *MATRICES}


def _only(data: Mapping[str, Any], allowed: set[str], where: str) -> None:
    unknown = sorted(set(data) - allowed)
    if unknown:
        raise PlantError(f"{where} has an unknown key {unknown[0]!r}: it may hold {', '.join(sorted(allowed))}")


def _channels(data: Mapping[str, Any], side: str, letter: str, count: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names and units of the inputs or outputs; u1, u2, ... and "1" by default."""
    names = data.get(f"{side}_names") or [f"{letter}{i + 1}" for i in range(count)]
    units = data.get(f"{side}_units") or ["1"] * count
    return tuple(map(str, names)), tuple(map(str, units))


def _initial(data: Mapping[str, Any], n: int) -> tuple[Array, Array]:
    """Bounds of x(0), both shape (n,): a fixed vector, or low and high to draw between."""
    initial = data.get("initial", [0.0] * n)
    if isinstance(initial, Mapping):
        _only(initial, {"low", "high"}, "initial")
        return matrix(initial["low"], "initial.low", (n,)), matrix(initial["high"], "initial.high", (n,))
    fixed = matrix(initial, "initial", (n,))
    return fixed, fixed


def _from_matrices(data: Mapping[str, Any]) -> Plant:
    _only(data, OWN, "the file")
    missing = [key for key in ("A", "B", "C", "sample_time") if key not in data]
    if missing:
        raise PlantError(f"the file lacks {', '.join(missing)} (or a section grid or water)")
    A = matrix(data["A"], "A", (None, None))
    system = DescriptorSystem(data.get("E", np.eye(len(A))), A, data["B"], data["C"], data.get("D"))
    input_names, input_units = _channels(data, "input", "u", system.m)
    output_names, output_units = _channels(data, "output", "y", system.p)
    return Plant(
        name="plant",
        variant="matrices",
        description="",
        sample_time=float(data["sample_time"]),
        system=system,
        input_names=input_names,
        input_units=input_units,
        output_names=output_names,
        output_units=output_units,
        input_min=np.full(system.m, -1.0),
        input_max=np.full(system.m, 1.0),
        prior=system_prior(system),
        D=system.D,
        references=((0, np.zeros(system.p)),),
        settings=suggested_settings(system),
        steps=200,
        begin=linear_start(system, lambda _: np.zeros(system.n)),
        state_names=tuple(map(str, data.get("state_names", ()))),
    )


def _from_section(data: Mapping[str, Any], section: str, folder: Path) -> Plant:
    _only(data, COMMON | {section}, "the file")
    options = dict(data[section])
    if "file" not in options:
        raise PlantError(
            f"section {section} lacks file, the path of the case" + (" (.inp)" if section == "water" else "")
        )
    path = folder / options.pop("file")
    try:
        return from_inp(path, **options) if section == "water" else from_case(path, **options)
    except TypeError as error:
        raise PlantError(f"section {section}: {error}") from None


def _overridden(plant: Plant, data: Mapping[str, Any], system: DescriptorSystem) -> Plant:
    """The plant with whatever the file says about its run."""
    changes: dict[str, Any] = {key: str(data[key]) for key in ("name", "description") if key in data}
    for key in ("input_min", "input_max"):
        if key in data:
            changes[key] = np.broadcast_to(np.asarray(data[key], dtype=np.float64), (system.m,))
    if "references" in data:
        changes["references"] = tuple((item["k"], item["values"]) for item in data["references"])
    if "settings" in data:
        own = data["settings"]
        suited = suggested_settings(system, int(own.get("N", 0)), int(own.get("L", 0)))  # T follows from N and L
        changes["settings"] = {**plant.settings, **suited, **own}
    if "steps" in data:
        changes["steps"] = int(data["steps"])
    if "initial" in data:
        low, high = _initial(data, system.n)
        changes["begin"] = linear_start(system, lambda rng: low + (high - low) * rng.random(system.n))
    return replace(plant, **changes)


def load(path: str | Path) -> Plant:
    """Loads a plant from YAML.

    Either matrices (A, B, C and sample_time; E and D are optional), or a section ``grid`` or ``water`` with ``file``
    and the options of `plant_sim.power.from_case` or `plant_sim.water.from_inp`; relative paths start at the YAML
    file. In each case also name, description, input_min, input_max, initial (x(0), or low and high to draw between),
    references (k, values), settings and steps; for matrices input_names, input_units, output_names, output_units and
    state_names too.

    Raises:
        PlantError: if the file is missing, not YAML, has unknown or missing keys, or matrices that do not fit; the
            message starts with the file's name.
    """
    path = Path(path)
    try:
        data = yaml.safe_load(path.read_text())
    except OSError as error:
        raise PlantError(f"{path}: {error.strerror}") from None
    except yaml.YAMLError as error:
        raise PlantError(f"{path.name} is not YAML: {' '.join(str(error).split())}") from None
    if not isinstance(data, Mapping):
        raise PlantError(f"{path.name} must hold keys and values at its top level")
    try:
        section = next((key for key in ("grid", "water") if key in data), None)
        plant = _from_matrices(data) if section is None else _from_section(data, section, path.parent)
        assert plant.system is not None
        return _overridden(plant, data, plant.system)
    except (ValueError, KeyError, TypeError) as error:
        what = f"a key {error} is missing" if isinstance(error, KeyError) else str(error)
        raise PlantError(f"{path.name}: {what}") from None
