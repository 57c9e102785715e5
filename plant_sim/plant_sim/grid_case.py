# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Grids from case data: MATPOWER files, pypower dictionaries, pandapower nets."""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from .arrays import Array, matrix
from .errors import PlantError

# columns of MATPOWER's tables, version 2
BUS_I, BUS_TYPE, PD = 0, 1, 2
GEN_BUS, PG, GEN_MBASE, GEN_STATUS = 0, 1, 6, 7
F_BUS, T_BUS, BR_X, TAP, BR_STATUS = 0, 1, 3, 8, 10
REFERENCE, ISOLATED = 3, 4


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GridCase:
    """The part of a case that lossless models need; only what is in service.

    Attributes:
        name: short name.
        buses: numbers of the N buses, machines first.
        machines: how many of them carry machines.
        ratings: power base of the machines at each machine bus, per unit of the system base; shape (machines,).
        branches: (i, j, b): positions in ``buses`` and susceptance b = 1 / (x tap) in per unit.
        load: active power drawn at each bus, per unit; shape (N,).
        generation: active power of the machines at each machine bus, as scheduled in the case; shape (machines,).
        reference: position of the machine bus that balances the rest (type 3; the first one if the case names none).
    """

    name: str
    buses: tuple[int, ...]
    machines: int
    ratings: Array
    branches: tuple[tuple[int, int, float], ...]
    load: Array
    generation: Array
    reference: int


def parse_matpower(text: str) -> dict[str, Any]:
    """Tables baseMVA, bus, gen and branch of a MATPOWER case file (version 2).

    Raises:
        PlantError: if a table is missing or ragged.
    """
    text = re.sub(r"%.*", "", text)
    base = re.search(r"mpc\.baseMVA\s*=\s*([-+.\deE]+)", text)
    case: dict[str, Any] = {"baseMVA": float(base.group(1)) if base else 100.0}
    for table in ("bus", "gen", "branch"):
        found = re.search(rf"mpc\.{table}\s*=\s*\[(.*?)\]", text, re.DOTALL)
        if found is None:
            raise PlantError(f"the case file has no table mpc.{table}")
        lines = [line.replace(",", " ").split() for line in re.split(r"[;\n]", found.group(1)) if line.strip()]
        try:
            case[table] = np.array([[float(entry) for entry in line] for line in lines])
        except ValueError as error:
            raise PlantError(f"mpc.{table} is not a table of numbers: {error}") from None
    return case


def _read(path: Path) -> Mapping[str, Any]:
    if not path.is_file():
        raise PlantError(f"no such file: {path}")
    if path.suffix == ".m":
        return parse_matpower(path.read_text())
    if path.suffix == ".json":
        case = json.loads(path.read_text())
        if isinstance(case, dict) and "_module" in case:
            raise PlantError(f"{path.name} is a pandapower file: pass pandapower.from_json({str(path)!r}) instead")
        return dict(case)
    raise PlantError(f"{path.name}: case files are MATPOWER .m files, or .json files with baseMVA, bus, gen and branch")


def _from_pandapower(net: Any) -> Mapping[str, Any]:
    case = import_module("pandapower.converter.pypower.to_ppc").to_ppc(net, init="flat")
    return {key: np.real(case[key]) for key in ("baseMVA", "bus", "gen", "branch")}


def _islands_without(n: int, branches: list[tuple[int, int, float]], machines: int) -> list[int]:
    """Buses from which no machine can be reached."""
    reached, frontier = set(range(machines)), list(range(machines))
    neighbours: dict[int, list[int]] = {i: [] for i in range(n)}
    for i, j, _ in branches:
        neighbours[i].append(j)
        neighbours[j].append(i)
    while frontier:
        new = [j for j in neighbours[frontier.pop()] if j not in reached]
        reached.update(new)
        frontier += new
    return [i for i in range(n) if i not in reached]


def _columns(tables: Mapping[str, Any], key: str, columns: tuple[int, ...]) -> Array:
    """The given columns of a table, shape (rows, len(columns))."""
    if key not in tables:
        raise PlantError(f"the case has no table {key}: it must hold baseMVA, bus, gen and branch")
    table = np.asarray(tables[key], dtype=np.float64)
    if table.ndim != 2 or table.shape[1] <= max(columns):
        raise PlantError(f"table {key} must have at least {max(columns) + 1} columns (MATPOWER, version 2)")
    return table[:, columns]


def _branches(table: Array, position: Mapping[int, int]) -> list[tuple[int, int, float]]:
    """Branches in service between the given buses, as (i, j, b)."""
    branches = []
    for f, t, x, tap, status in matrix(table, "branch", (None, 5)):
        if status <= 0 or int(f) not in position or int(t) not in position:
            continue
        if x == 0:
            raise PlantError(f"branch {f:.0f}-{t:.0f} has no reactance: merge its buses or give it a small x")
        branches.append((position[int(f)], position[int(t)], float(1 / (x * (tap or 1.0)))))
    return branches


def load_case(source: str | Path | Mapping[str, Any] | Any, name: str | None = None) -> GridCase:
    """Reads a case.

    Args:
        source: a MATPOWER .m file, a .json file or dictionary with baseMVA, bus, gen and branch (pypower's tables), or
            a pandapower net.
        name: short name; by default the file's.

    Raises:
        PlantError: if the case is missing or incomplete, has no machine, a branch without reactance, or an island
            without a machine.
    """
    if isinstance(source, str | Path):
        name = name or Path(source).stem
        source = _read(Path(source))
    elif type(source).__module__.startswith("pandapower"):
        source = _from_pandapower(source)
    bus = matrix(_columns(source, "bus", (BUS_I, BUS_TYPE, PD)), "bus", (None, 3))
    gen = _columns(source, "gen", (GEN_BUS, PG, GEN_MBASE, GEN_STATUS))
    base = float(source.get("baseMVA", 100.0))

    alive = [int(number) for number, kind, _ in bus if kind != ISOLATED]
    rating: dict[int, float] = {}
    power: dict[int, float] = {}
    for number, pg, mbase, status in gen:
        if status > 0 and int(number) in alive:  # a missing mBase means the system base
            rating[int(number)] = rating.get(int(number), 0.0) + (mbase / base if mbase > 0 else 1.0)
            power[int(number)] = power.get(int(number), 0.0) + pg / base
    if not rating:
        raise PlantError("the case has no machine in service")
    buses = [b for b in alive if b in rating] + [b for b in alive if b not in rating]
    branches = _branches(
        _columns(source, "branch", (F_BUS, T_BUS, BR_X, TAP, BR_STATUS)), {number: i for i, number in enumerate(buses)}
    )
    drawn = {int(number): float(pd / base) for number, _, pd in bus}
    balancing = [int(number) for number, kind, _ in bus if kind == REFERENCE]
    dead = _islands_without(len(buses), branches, len(rating))
    if dead:
        names = ", ".join(str(buses[i]) for i in dead[:8])
        raise PlantError(f"no machine reaches {len(dead)} buses ({names}): remove them or give them type 4")
    return GridCase(
        name=name or "grid",
        buses=tuple(buses),
        machines=len(rating),
        ratings=np.array([rating[b] for b in buses[: len(rating)]]),
        branches=tuple(branches),
        load=np.array([drawn[b] for b in buses]),
        generation=np.array([power[b] for b in buses[: len(rating)]]),
        reference=next((i for i, b in enumerate(buses[: len(rating)]) if b in balancing), 0),
    )
