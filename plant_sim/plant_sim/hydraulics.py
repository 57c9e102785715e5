# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""A steady state of a water network, computed by EPANET itself, in SI units."""

import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .errors import PlantError

# EPANET's own numbers for the kinds of nodes and links
JUNCTION, RESERVOIR, TANK = 0, 1, 2
WARNING = "EPANET warns at this hour: pressures below zero, or pumps or valves that cannot do what is asked"
TRIALS = 500  # of EPANET's solver; the file's own limit is often too small for this accuracy
CHECK_VALVE_PIPE, PIPE, PUMP, PRV, PSV, PBV, FCV, TCV, GPV = range(9)


@dataclass(frozen=True, slots=True, kw_only=True)
class Node:
    """A junction, reservoir or tank; elevation and head in m, area in m2 (0 unless a tank).

    ``relief`` is how much the outflow grows with the head [m2/s]: emitters, leaks, pressure-driven demands.
    """

    name: str
    kind: int
    elevation: float
    head: float
    area: float
    relief: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Link:
    """A pipe, pump or valve; flow in m3/s from node ``ends[0]`` to ``ends[1]`` (0-based), lengths in m.

    ``setting`` is a pump's relative speed, or what a valve holds (m or m3/s; 0 if it does not act). ``curve`` holds the
    points (m3/s, m) of a pump's head curve or of a GPV's loss, ``constant_power`` marks a pump without one.
    """

    name: str
    kind: int
    ends: tuple[int, int]
    flow: float
    open: bool
    length: float = 0.0
    diameter: float = 0.0
    roughness: float = 0.0
    minor_loss: float = 0.0
    setting: float = 0.0
    curve: tuple[tuple[float, float], ...] = ()
    constant_power: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Snapshot:
    """The network at one instant. ``formula`` is "HW", "DW" or "CM"; ``viscosity`` in m2/s."""

    nodes: tuple[Node, ...]
    links: tuple[Link, ...]
    formula: str
    viscosity: float
    hour: float
    warnings: tuple[str, ...] = field(default=())

    def index(self, name: str) -> int:
        """Index of the node called ``name``.

        Raises:
            PlantError: if there is none.
        """
        for i, node in enumerate(self.nodes):
            if node.name == name:
                return i
        raise PlantError(f"the network has no node {name!r}")


def epanet_toolkit() -> Any:
    """EPANET; imported late, so that plants without water do not need it.

    Raises:
        PlantError: if it is not installed.
    """
    try:
        from epanet import toolkit
    except ImportError:
        raise PlantError(
            "EPANET is not installed: pip install owa-epanet (on Python 3.13 it is compiled, which needs SWIG; "
            "`make demo` does that)"
        ) from None
    return toolkit


@contextmanager
def project(path: Path) -> Iterator[Any]:
    """An open EPANET project handle in SI units (m3/s, m); closed on leaving.

    Raises:
        PlantError: if the file is missing or EPANET rejects it.
    """
    toolkit = epanet_toolkit()
    if not path.is_file():
        raise PlantError(f"no such file: {path}")
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.txt"
        handle = toolkit.createproject()
        rejected = None
        try:
            toolkit.open(handle, str(path), str(report), "")
            toolkit.setflowunits(handle, toolkit.CMS)
            toolkit.setoption(handle, toolkit.PRESS_UNITS, toolkit.METERS)
        except Exception as error:
            rejected = str(error)
        if rejected is None:
            try:
                yield handle
            finally:
                toolkit.close(handle)
                toolkit.deleteproject(handle)
            return
        with suppress(Exception):  # what was never open cannot be closed; but only now is the report complete
            toolkit.close(handle)
        toolkit.deleteproject(handle)
        lines = [line.strip() for line in report.read_text(errors="replace").splitlines()] if report.is_file() else []
        found = [" ".join(lines[i : i + 2]) for i, line in enumerate(lines) if line.startswith("Error")]
        raise PlantError(f"EPANET cannot read {path.name}: {'; '.join(found[:3]) or rejected}")


def _advance(handle: Any, target: int) -> tuple[int, bool]:
    """Runs EPANET to ``target`` seconds; returns the time reached and whether EPANET warned there."""
    toolkit = epanet_toolkit()
    toolkit.openH(handle)
    toolkit.initH(handle, 0)
    while True:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            time = toolkit.runH(handle)
        if time >= target or toolkit.nextH(handle) <= 0:
            return int(time), bool(caught)


def _solve(handle: Any, hour: float, name: str) -> tuple[str, ...]:
    """Runs EPANET's own schedule up to ``hour``; returns what EPANET warns of at that instant."""
    toolkit = epanet_toolkit()
    toolkit.setoption(handle, toolkit.ACCURACY, 1e-8)
    toolkit.setoption(handle, toolkit.TRIALS, TRIALS)
    target = round(hour * 3600)
    toolkit.settimeparam(handle, toolkit.DURATION, target)
    try:
        time, warned = _advance(handle, target)
    except Exception as error:
        raise PlantError(f"EPANET finds no steady state of {name} up to hour {hour:g}: {error}") from None
    if time != target:
        raise PlantError(f"{name} has no solution at hour {hour:g}: its steps lead to hour={time / 3600:.6g} instead")
    relative = toolkit.getstatistic(handle, toolkit.RELATIVEERROR)
    if not relative <= 1e-6:
        raise PlantError(f"EPANET does not converge on {name} at hour {hour:g}: relative flow change {relative:.1e}")
    return (WARNING,) if warned else ()


def _curve(handle: Any, index: int) -> tuple[tuple[float, float], ...]:
    toolkit = epanet_toolkit()
    count = toolkit.getcurvelen(handle, index)
    return tuple(tuple(toolkit.getcurvevalue(handle, index, i)) for i in range(1, count + 1))


def _link(handle: Any, index: int) -> Link:
    toolkit = epanet_toolkit()

    def value(name: str) -> float:
        return float(toolkit.getlinkvalue(handle, index, getattr(toolkit, name)))

    kind = toolkit.getlinktype(handle, index)
    first, second = toolkit.getlinknodes(handle, index)
    common: dict[str, Any] = {
        "name": toolkit.getlinkid(handle, index), "kind": kind, "ends": (first - 1, second - 1),
        "flow": value("FLOW"), "open": value("STATUS") != 0,
    }  # fmt: skip
    if kind == PUMP:
        constant = toolkit.getpumptype(handle, index) == toolkit.CONST_HP
        curve = () if constant else _curve(handle, toolkit.getheadcurveindex(handle, index))
        return Link(**common, setting=value("SETTING"), curve=curve, constant_power=constant)
    pipe: dict[str, Any] = {"length": value("LENGTH"), "roughness": value("ROUGHNESS")}
    if kind not in (PIPE, CHECK_VALVE_PIPE):
        pipe = {"setting": value("SETTING")}
    if kind == GPV:
        pipe["curve"] = _curve(handle, int(value("GPV_CURVE")))
    return Link(**common, **pipe, diameter=value("DIAMETER") / 1000, minor_loss=value("MINORLOSS"))


def _relief(handle: Any, index: int) -> float:
    """Slope of emitter flow C p^e and of a demand D ((p - p0) / (p1 - p0))^e at the present pressure p [m2/s]."""
    toolkit = epanet_toolkit()
    pressure = toolkit.getnodevalue(handle, index, toolkit.PRESSURE)
    relief = 0.0
    if pressure > 0:
        flow = toolkit.getnodevalue(handle, index, toolkit.EMITTERFLOW)
        relief += toolkit.getoption(handle, toolkit.EMITEXPON) * flow / pressure
    model, least, enough, exponent = toolkit.getdemandmodel(handle)
    if model == toolkit.PDA and least < pressure < enough:
        delivered = toolkit.getnodevalue(handle, index, toolkit.DEMANDFLOW)
        relief += exponent * delivered / (pressure - least)
    return float(relief)


def _node(handle: Any, index: int) -> Node:
    toolkit = epanet_toolkit()
    kind = toolkit.getnodetype(handle, index)
    diameter = toolkit.getnodevalue(handle, index, toolkit.TANKDIAM) if kind == TANK else 0.0
    return Node(
        name=toolkit.getnodeid(handle, index),
        kind=kind,
        elevation=toolkit.getnodevalue(handle, index, toolkit.ELEVATION),
        head=toolkit.getnodevalue(handle, index, toolkit.HEAD),
        relief=_relief(handle, index) if kind == JUNCTION else 0.0,
        area=3.141592653589793 * diameter**2 / 4,
    )


def snapshot(path: str | Path, hour: float) -> Snapshot:
    """EPANET's steady state at ``hour`` of the file's own schedule.

    Raises:
        PlantError: if the file is missing, broken, or EPANET does not converge.
    """
    path = Path(path)
    with project(path) as handle:
        toolkit = epanet_toolkit()
        warned = _solve(handle, hour, path.name)
        nodes = tuple(_node(handle, i + 1) for i in range(toolkit.getcount(handle, toolkit.NODECOUNT)))
        links = tuple(_link(handle, i + 1) for i in range(toolkit.getcount(handle, toolkit.LINKCOUNT)))
        formula = ("HW", "DW", "CM")[int(toolkit.getoption(handle, toolkit.HEADLOSSFORM))]
        viscosity = toolkit.getoption(handle, toolkit.SP_VISCOS) * 1.02193e-6
    return Snapshot(
        nodes=nodes, links=links, formula=formula, viscosity=viscosity, hour=hour, warnings=warned
    )  # fmt: skip
