# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""EPANET itself as a running plant, one sample after the other through its toolkit."""

import warnings
import weakref
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .arrays import Array, matrix
from .demand import Demand
from .errors import PlantError
from .hydraulics import JUNCTION, PUMP, TANK, epanet_toolkit, project

HORIZON = 2_000_000_000  # s: about 63 years, the longest run that EPANET is asked for
BRIM = 1e-4  # m: a tank this near to its end is full or empty


@dataclass(frozen=True, slots=True)
class Tag:
    """An input or output: what ("pump", "valve", "inject"; "level", "pressure", "head", "flow", "demand") and where.

    Attributes:
        name: as asked for, such as "pump:10".
        what: the part before the colon.
        index: EPANET's number of the node or link; 0 for the network as a whole.
    """

    name: str
    what: str
    index: int


@dataclass(frozen=True, slots=True)
class Tank:
    """A tank: name, EPANET's number, lowest and highest level [m]."""

    name: str
    index: int
    low: float
    high: float


class LiveNetwork:
    """A network that EPANET solves sample by sample; the controls and rules of its file are switched off.

    Args:
        path: the .inp file.
        inputs: "pump:NAME" (relative speed), "valve:NAME" (setting, m or m3/s) or "inject:NODE" (m3/s).
        outputs: "level:TANK", "pressure:NODE", "head:NODE" (m), "flow:LINK" (m3/s) or "demand" (the total, m3/s).
        dt: sample time, whole seconds.
        demand: what the consumers draw.

    Raises:
        PlantError: if EPANET cannot read the file, or a name is wrong.
    """

    def __init__(
        self, path: str | Path, inputs: Sequence[str], outputs: Sequence[str], dt: int, demand: Demand
    ) -> None:
        self._tk: Any = epanet_toolkit()
        resources = ExitStack()
        self._handle = resources.enter_context(project(Path(path)))
        self.close = weakref.finalize(self, resources.close)
        self.name, self.dt, self._demand = Path(path).stem, dt, demand
        self.inputs = tuple(self._tag(name, ("pump", "valve", "inject")) for name in inputs)
        self.outputs = tuple(self._tag(name, ("level", "pressure", "head", "flow", "demand")) for name in outputs)
        self.tanks = self._tanks()
        measured = [tag.index for tag in self.outputs if tag.what in ("level", "pressure")]
        measured += [tank.index for tank in self.tanks]
        self._bottom = {index: self._node(index, "ELEVATION") for index in measured}
        self._prepare()

    def read(self) -> Array:
        """The outputs as last solved, shape (p,)."""
        return np.array([self._read(tag) for tag in self.outputs])

    def level(self, tank: Tank) -> float:
        """Level of a tank above its bottom, m."""
        return self._node(tank.index, "HEAD") - self._bottom[tank.index]

    def solve(self, u: ArrayLike, k: int) -> list[str]:
        """Sets the inputs and the demand of sample k and solves the heads and flows at its instant.

        Returns:
            EPANET's warnings, one line each.

        Raises:
            PlantError: if EPANET cannot solve the network.
        """
        factor = self._demand.factor(k) * self._multiplier
        self._tk.setoption(self._handle, self._tk.DEMANDMULT, factor)
        for tag, value in zip(self.inputs, np.asarray(u, dtype=np.float64), strict=True):
            if tag.what == "inject":
                self._tk.setbasedemand(self._handle, tag.index, self._category[tag.index], -float(value) / factor)
            else:
                self._tk.setlinkvalue(self._handle, tag.index, self._tk.SETTING, float(value))
        return self._solve(k)

    def advance(self, k: int) -> list[str]:
        """Moves the tanks by one sample; a tank that fills or empties on the way splits the step.

        Returns:
            EPANET's warnings on the way, one line each.
        """
        said: list[str] = []
        left = self.dt
        while True:
            took = self._tk.nextH(self._handle)
            left -= took
            if left <= 0 or took <= 0:
                return said
            said += self._solve(k)

    def total_demand(self, k: int) -> float:
        """What all consumers want at sample k, m3/s."""
        if not self._demand.own:
            return float(self._demand.factor(k) * self._multiplier * self._mean_demand)
        step = (k * self.dt + self._pattern_start) // self._pattern_step
        return float(self._multiplier * sum(base * pattern[step % len(pattern)] for base, pattern in self._consumers))

    # Inside

    def _tag(self, name: str, allowed: tuple[str, ...]) -> Tag:
        what, _, where = name.partition(":")
        if what not in allowed:
            raise PlantError(f"{name!r} is not understood: write {', '.join(f'{w}:NAME' for w in allowed)}")
        if what == "demand":
            return Tag(name, what, 0)
        node = what in ("inject", "level", "pressure", "head")
        try:
            index = (self._tk.getnodeindex if node else self._tk.getlinkindex)(self._handle, where)
        except Exception:
            raise PlantError(f"{self.name} has no {'node' if node else 'link'} {where!r}") from None
        kind = (self._tk.getnodetype if node else self._tk.getlinktype)(self._handle, index)
        wanted = {"pump": kind == PUMP, "valve": kind > PUMP, "level": kind == TANK, "inject": kind == JUNCTION}
        if not wanted.get(what, True):
            raise PlantError(f"{where!r} of {self.name} is no {'junction' if what == 'inject' else what}")
        return Tag(name, what, int(index))

    def _tanks(self) -> tuple[Tank, ...]:
        count, found = self._tk.getcount(self._handle, self._tk.NODECOUNT), []
        for index in range(1, count + 1):
            if self._tk.getnodetype(self._handle, index) == TANK:
                name = self._tk.getnodeid(self._handle, index)
                found.append(Tank(name, index, self._node(index, "MINLEVEL"), self._node(index, "MAXLEVEL")))
        return tuple(found)

    def _node(self, index: int, quantity: str) -> float:
        return float(self._tk.getnodevalue(self._handle, index, getattr(self._tk, quantity)))

    def _read(self, tag: Tag) -> float:
        if tag.what == "demand":
            return self.total_demand(self._k)
        if tag.what == "flow":
            return float(self._tk.getlinkvalue(self._handle, tag.index, self._tk.FLOW))
        head = self._node(tag.index, "HEAD")
        return head if tag.what == "head" else head - self._bottom[tag.index]

    def _prepare(self) -> None:
        """Switches off what would interfere, fixes time steps and demands, starts the hydraulics."""
        tk, handle = self._tk, self._handle
        while tk.getcount(handle, tk.CONTROLCOUNT):
            tk.deletecontrol(handle, 1)
        while tk.getcount(handle, tk.RULECOUNT):
            tk.deleterule(handle, 1)
        for parameter, seconds in ((tk.HYDSTEP, self.dt), (tk.REPORTSTEP, self.dt), (tk.DURATION, HORIZON)):
            tk.settimeparam(handle, parameter, seconds)
        tk.setoption(handle, tk.ACCURACY, 1e-6)
        tk.setoption(handle, tk.UNBALANCED, 10)  # rather a warning than a stop
        tk.setstatusreport(handle, tk.NO_REPORT)
        self._consumption()
        self._category: dict[int, int] = {}
        for tag in self.inputs:
            if tag.what == "inject":
                tk.adddemand(handle, tag.index, 0.0, self._unit_pattern(), "input")
                self._category[tag.index] = tk.getnumdemands(handle, tag.index)
        tk.openH(handle)
        tk.initH(handle, 0)
        self._k = 0

    def _unit_pattern(self) -> str:
        """Name of a pattern that is always one."""
        name = "_one"
        try:
            self._tk.getpatternindex(self._handle, name)
        except Exception:
            self._tk.addpattern(self._handle, name)
        return name

    def _consumption(self) -> None:
        """Reads the consumers; unless the file's own patterns are wanted, each becomes its mean."""
        tk, handle = self._tk, self._handle
        self._multiplier = tk.getoption(handle, tk.DEMANDMULT) * self._demand.multiplier
        self._pattern_step = int(tk.gettimeparam(handle, tk.PATTERNSTEP))
        self._pattern_start = int(tk.gettimeparam(handle, tk.PATTERNSTART))
        patterns: dict[int, list[float]] = {0: [1.0]}
        for i in range(1, tk.getcount(handle, tk.PATCOUNT) + 1):
            length = tk.getpatternlen(handle, i)
            patterns[i] = [tk.getpatternvalue(handle, i, j) for j in range(1, length + 1)]
            if not self._demand.own:
                patterns[i] = [float(np.mean(patterns[i]))]
                for j in range(1, length + 1):
                    tk.setpatternvalue(handle, i, j, patterns[i][0])
        patterns[0] = patterns[int(tk.getoption(handle, tk.DEMANDPATTERN))]  # consumers without one of their own
        nodes = range(1, tk.getcount(handle, tk.NODECOUNT) + 1)
        self._junctions = [node for node in nodes if tk.getnodetype(handle, node) == JUNCTION]
        self._consumers = []
        for node in self._junctions:
            for category in range(1, tk.getnumdemands(handle, node) + 1):
                base = tk.getbasedemand(handle, node, category)
                self._consumers.append((base, patterns[tk.getdemandpattern(handle, node, category)]))
        self._mean_demand = sum(base * pattern[0] for base, pattern in self._consumers)

    def _solve(self, k: int) -> list[str]:
        self._k = k
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                self._tk.runH(self._handle)
            except Exception as error:
                raise PlantError(f"EPANET cannot solve {self.name} at sample {k}: {error}") from None
        return [self._complaint()] if caught else []

    def _complaint(self) -> str:
        """What EPANET may have warned of: it says no more than that it does."""
        tk, handle = self._tk, self._handle
        error = tk.getstatistic(handle, tk.RELATIVEERROR)
        if error > tk.getoption(handle, tk.ACCURACY):
            return "EPANET: the hydraulics did not converge"
        dry = [node for node in self._junctions if tk.getnodevalue(handle, node, tk.PRESSURE) < 0]
        if dry:
            names = ", ".join(tk.getnodeid(handle, node) for node in dry[:3])
            return f"EPANET: pressure below zero at {names}" + (f" and {len(dry) - 3} more" if len(dry) > 3 else "")
        return "EPANET: pumps or valves that cannot do what is asked, or nodes that are cut off"


class EpanetStepper:
    """A network that runs: takes u(0), u(1), ... and returns the outputs of the same instant.

    Args:
        network: at its start.
        noise: standard deviation of the measurement noise, shape (p,).
        rng: for the noise.
    """

    def __init__(self, network: LiveNetwork, noise: Array, rng: np.random.Generator) -> None:
        self.network, self._noise, self._rng = network, noise, rng
        self.log: list[tuple[int, str]] = []
        """What happened so far: (k, a tank full or empty, a new warning of EPANET)."""
        self.status = ""
        """What is wrong since the last sample, in one line; empty if nothing is."""
        self._ends: dict[str, str] = {}
        self._warned: tuple[str, ...] = ()
        self._k = 0

    def push(self, u: ArrayLike) -> Array:
        """Takes u(k), shape (m,); returns y(k), shape (p,): levels as they are, pressures and flows as u(k) makes them.

        Raises:
            ShapeError: if ``u`` has another shape or is not finite.
            PlantError: if EPANET cannot solve the network.
        """
        u = matrix(u, "u", (len(self.network.inputs),))
        said = self.network.solve(u, self._k)
        y = self.network.read()
        if self._noise.any():
            y = y + self._noise * self._rng.standard_normal(len(y))
        said += self.network.advance(self._k)
        self._report(tuple(dict.fromkeys(said)))
        self._k += 1
        return y

    def forecast(self, k: int, count: int) -> Array:
        """Total demand at samples k, k+1, ..., shape (count, 1), m3/s: a disturbance known ahead."""
        return np.array([[self.network.total_demand(j)] for j in range(k, k + count)])

    def _report(self, said: tuple[str, ...]) -> None:
        """Takes note of tanks that reached an end or left it, and of warnings that are new."""
        for tank in self.network.tanks:
            level = self.network.level(tank)
            end = "full" if level > tank.high - BRIM else "empty" if level < tank.low + BRIM else ""
            if end != self._ends.get(tank.name, ""):
                self._ends[tank.name] = end
                self.log.append((self._k, f"tank {tank.name} is {end or 'between its ends again'}"))
        self.log += [(self._k, text) for text in said if text not in self._warned]
        self._warned = said
        self.status = "; ".join([f"tank {name} is {end}" for name, end in self._ends.items() if end] + list(said))
