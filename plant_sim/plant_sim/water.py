# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Water networks: linearised heads around a steady state that EPANET computed."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .arrays import Array
from .conductance import conductance
from .descriptor import DescriptorSystem
from .errors import PlantError
from .hydraulics import JUNCTION, RESERVOIR, TANK, Snapshot, snapshot
from .plant import Plant, linear_start, system_prior

FLOW_FLOOR = 1e-5  # m3/s: a link at rest would have infinite conductance
CONDUCTANCE_CAP = 1e3  # m2/s: a few very short pipes; time constants change by less than 0.01 %


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeadModel:
    """Deviation heads [m] of all nodes: storage_i dx_i/dt = sum_j g_ij (x_j - x_i) + injection_i, reservoirs constant.

    Attributes:
        names: the n nodes in the order of the states: reservoirs, tanks, junctions.
        storage: tank areas [m2], 1 for reservoirs, 0 for junctions; shape (n,).
        flow: right-hand side per head [m2/s], zero rows for reservoirs; shape (n, n).
        floored: links whose flow was below the floor.
        capped: links whose conductance was capped.
    """

    names: tuple[str, ...]
    storage: Array
    flow: Array
    floored: tuple[str, ...]
    capped: tuple[str, ...]

    def index(self, name: str) -> int:
        """State of the node ``name``.

        Raises:
            PlantError: if the model has no such node.
        """
        try:
            return self.names.index(name)
        except ValueError:
            raise PlantError(f"the network has no node {name!r}") from None

    def unit(self, name: str | None) -> Array:
        """Unit vector of a node, shape (n,); zero for None."""
        e = np.zeros(len(self.names))
        if name is not None:
            e[self.index(name)] = 1.0
        return e


def head_model(network: Snapshot, first: Sequence[str] = ()) -> HeadModel:
    """Linearises ``network``; the junctions named in ``first`` lead the others."""
    order = sorted(
        range(len(network.nodes)),
        key=lambda i: (
            (RESERVOIR, TANK, JUNCTION).index(network.nodes[i].kind),
            first.index(network.nodes[i].name) if network.nodes[i].name in first else len(first),
        ),
    )
    position = {node: state for state, node in enumerate(order)}
    nodes = [network.nodes[i] for i in order]
    flow = np.zeros((len(nodes), len(nodes)))
    floored, capped = [], []
    for link in network.links:
        g = conductance(link, network, FLOW_FLOOR)
        if link.open and abs(link.flow) < FLOW_FLOOR:
            floored.append(link.name)
        if g > CONDUCTANCE_CAP:
            capped.append(link.name)
            g = CONDUCTANCE_CAP
        i, j = position[link.ends[0]], position[link.ends[1]]
        flow[[i, j], [i, j]] -= g
        flow[[i, j], [j, i]] += g
    flow[[node.kind == RESERVOIR for node in nodes]] = 0.0
    return HeadModel(
        names=tuple(node.name for node in nodes),
        storage=np.array([1.0 if node.kind == RESERVOIR else node.area for node in nodes]),
        flow=flow,
        floored=tuple(floored),
        capped=tuple(capped),
    )


NET3 = Path(__file__).parent / "data" / "Net3.inp"
RIVER, LAKE = "River", "Lake"
_NET3_INPUTS = {
    "junction": (None, "60", None),
    "river": (RIVER, "60", None),
    "all": (RIVER, "60", LAKE),
}


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
    model = head_model(snapshot(NET3, hour), first=("60", "61"))
    E = np.diag(model.storage)
    B = np.column_stack([
        (tau if name == "60" else 1.0) * model.unit(name) for name in _NET3_INPUTS[inputs]
    ])  # fmt: skip
    system = DescriptorSystem(E, E + tau * model.flow, B, np.vstack([model.unit(LAKE), model.unit("3")]))
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
    )
