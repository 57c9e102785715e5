# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Water networks: linearised heads around a steady state that EPANET computed."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from .arrays import Array
from .conductance import speed_gain
from .descriptor import DescriptorSystem
from .errors import PlantError
from .heads import CONDUCTANCE_CAP, FLOW_FLOOR, HeadModel, head_model
from .hydraulics import PUMP, RESERVOIR, TANK, Link, Snapshot, snapshot
from .plant import Plant, linear_start, suggested_settings, system_prior
from .swing import Discretisation, discretise


def _pump(network: Snapshot, name: str) -> Link:
    for link in network.links:
        if link.kind == PUMP and link.name == name:
            return link
    raise PlantError(f"the network has no pump {name!r}")


def _input_column(model: HeadModel, network: Snapshot, name: str) -> tuple[Array, str]:
    """Inflow that a unit of an input causes at each node [m3/s], shape (n,), and the input's unit."""
    if not name.startswith("pump:"):
        column = model.carry @ model.head(name)
        if network.nodes[network.index(name)].kind == RESERVOIR:
            raise PlantError(f"{name} is a reservoir, whose level nothing moves: inject at a junction or a tank")
        return column, "m3/s"
    pump = _pump(network, name.removeprefix("pump:"))
    ends = [model.head(network.nodes[i].name) for i in pump.ends]
    return speed_gain(pump, network, FLOW_FLOOR) * (model.carry @ (ends[1] - ends[0])), "1"


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")


def _notes(model: HeadModel, network: Snapshot) -> tuple[str, ...]:
    notes = [
        (model.floored, f"links at rest, flow taken as {FLOW_FLOOR:g} m3/s"),
        (model.capped, f"links with conductance capped at {CONDUCTANCE_CAP:g} m2/s"),
        (model.left_out, "nodes left out, cut off by closed links"),
    ]
    return tuple(f"{what}: {_some(names)}" for names, what in notes if names) + network.warnings


def from_inp(
    path: str | Path,
    hour: float = 0.0,
    *,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    tau: float = 3600.0,
    discretisation: Discretisation = "exact",
    limit: float = 0.1,
    first: Sequence[str] = (),
) -> Plant:
    """Linear model of the heads of any EPANET network around its own steady state at ``hour``.

    Args:
        path: the .inp file.
        hour: instant of the file's own schedule, h.
        inputs: nodes to inject water at (m3/s), or "pump:NAME" for the relative speed of a running pump; by default all
            running pumps that have a head curve.
        outputs: nodes whose heads (m) are measured; by default the tanks.
        tau: sample time, s.
        discretisation: "exact" (zero-order hold), "implicit" or "euler".
        limit: input limit, in the units of the inputs.
        first: junctions that come first among the states.

    Raises:
        PlantError: if EPANET cannot read or solve the file, or an input or output does not exist.

    Warns:
        UserWarning: if forward Euler is unstable at this tau.
    """
    network = snapshot(path, hour)
    model = head_model(network, first)
    name = Path(path).stem
    if inputs is None:
        inputs = [
            f"pump:{link.name}" for link in network.links
            if link.kind == PUMP and link.open and link.setting > 0 and not link.constant_power
        ]  # fmt: skip
    if outputs is None:
        outputs = [node.name for node in network.nodes if node.kind == TANK]
    if not inputs or not outputs:
        raise PlantError(f"{name} has no running pump or no tank at hour {hour:g}: name nodes as inputs and as outputs")
    columns, units = zip(*(_input_column(model, network, node) for node in inputs), strict=True)
    C = np.vstack([model.head(node) for node in outputs])
    E, A, B = discretise(
        np.diag(model.storage), -model.flow, np.column_stack(columns), model.dynamic, tau, discretisation
    )
    system = DescriptorSystem(E, A, B, C)
    return Plant(
        name=name,
        variant=f"hour {hour:g}",
        description=(
            f"EPANET network {name} at hour {hour:g}, linearised: {model.dynamic} reservoirs and tanks, "
            f"{system.n - model.dynamic} junctions; deviation heads."
        ),
        sample_time=tau,
        system=system,
        input_names=tuple(inputs),
        input_units=tuple(units),
        output_names=tuple(outputs),
        output_units=("m",) * len(outputs),
        input_min=np.full(len(inputs), -limit),
        input_max=np.full(len(inputs), limit),
        prior=system_prior(system),
        D=system.D,
        references=((0, np.zeros(len(outputs))),),
        settings=suggested_settings(system),
        steps=200,
        begin=linear_start(system, lambda _: np.zeros(system.n)),
        state_names=model.names,
        notes=_notes(model, network),
    )


NET3 = Path(__file__).parent / "data" / "Net3.inp"
RIVER, LAKE = "River", "Lake"
_NET3_INPUTS = {"junction": (None, None), "river": (RIVER, None), "all": (RIVER, LAKE)}


def net3(hour: int = 5, inputs: str = "junction") -> Plant:
    """The paper's second case: EPANET's Net3, linearised at ``hour`` of its own schedule, one sample each 0.1 day.

    States are deviation heads [m]: River (R2), Lake (R1), tanks 1, 2, 3, junctions 60, 61, the other 90. Both
    reservoirs are constants unless an input moves them. u2 = 1 is an injection of 1 m3/s at junction 60.

    Args:
        hour: 5 (all pipes flow) or 2 (both pumps on); others work as far as EPANET goes.
        inputs: "junction" (the paper: only u2 acts), "river" (u1 also raises the River, by u1 metres a sample), or
            "all" (and u3 the Lake).

    Raises:
        PlantError: if ``inputs`` is not known or EPANET finds no steady state at ``hour``.
    """
    if inputs not in _NET3_INPUTS:
        raise PlantError(f"net3 has no inputs {inputs!r}: choose {', '.join(_NET3_INPUTS)}")
    tau = 8640.0
    network = snapshot(NET3, hour)
    model = head_model(network, first=("60", "61"))
    E, A, B = discretise(
        np.diag(model.storage), -model.flow, np.column_stack([model.head("60")] * 3), model.dynamic, tau, "euler"
    )
    for column, reservoir in zip((0, 2), _NET3_INPUTS[inputs], strict=True):
        B[:, column] = 0.0 if reservoir is None else model.head(reservoir)
    system = DescriptorSystem(E, A, B, np.vstack([model.head(LAKE), model.head("3")]))
    start = np.zeros(system.n)
    start[:5] = 2.0, 4.0, 3.0, 2.5, 2.0
    return Plant(
        name="net3",
        variant=inputs,
        description=(
            f"EPANET Net3 at hour {hour}: 2 reservoirs, 3 tanks, 92 junctions; deviation heads of the Lake (R1) and of "
            "tank 3 (T3), driven by an injection at junction 60."
        ),
        sample_time=tau,
        system=system,
        input_names=("R2", "60", "R1"),
        input_units=("m/sample", "m3/s", "m/sample"),
        output_names=("R1", "T3"),
        output_units=("m", "m"),
        input_min=np.full(3, -1.0),
        input_max=np.full(3, 1.0),
        prior=system_prior(system),
        D=system.D,
        references=((0, np.array([5.0, 3.0])), (160, np.array([3.0, 5.0]))),
        settings={"N": 5, "L": 12, "T": 100, "Q": [5.0, 5.0], "R": [1.0, 1.0, 1.0], "terminal": "equilibrium"},
        steps=200,
        begin=linear_start(system, lambda _: start),
        state_names=model.names,
        notes=_notes(model, network),
    )
