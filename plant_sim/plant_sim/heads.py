# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The linear equations of the heads of a water network around one of its steady states."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .arrays import Array, frozen
from .conductance import conductance, holds
from .errors import PlantError
from .hydraulics import JUNCTION, RESERVOIR, TANK, Link, Snapshot

FLOW_FLOOR = 1e-5  # m3/s: a link at rest would have infinite conductance
CONDUCTANCE_CAP = 1e3  # m2/s: a few very short pipes; time constants change by less than 0.01 %


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeadModel:
    """Deviation heads [m]: storage dx/dt = flow x + carry injection, reservoirs constant.

    Attributes:
        names: the n nodes in the order of the states: reservoirs, tanks, junctions.
        dynamic: number of reservoirs and tanks.
        storage: tank areas [m2], 1 for reservoirs, 0 for junctions; shape (n,).
        flow: net inflow of each node per head [m2/s]; zero rows for reservoirs; shape (n, n).
        carry: which balance an injection at a node enters: its own, or that of the other end of a valve that holds the
            node's head, and none at a reservoir; shape (n, n).
        floored: links whose flow was below the floor.
        capped: links whose conductance was capped.
        left_out: nodes that closed links cut off from every reservoir and tank.
    """

    names: tuple[str, ...]
    dynamic: int
    storage: Array
    flow: Array
    carry: Array
    floored: tuple[str, ...]
    capped: tuple[str, ...]
    left_out: tuple[str, ...]

    def head(self, name: str) -> Array:
        """Unit vector of a node's head, shape (n,).

        Raises:
            PlantError: if the model has no such node.
        """
        if name in self.left_out:
            raise PlantError(f"node {name} is cut off by closed links at this hour")
        if name not in self.names:
            raise PlantError(f"the network has no node {name!r}")
        e = np.zeros(len(self.names))
        e[self.names.index(name)] = 1.0
        return e


def _conductances(network: Snapshot) -> tuple[list[float], tuple[str, ...], tuple[str, ...]]:
    """Capped conductances of all links; names of the floored and of the capped ones."""
    values, floored, capped = [], [], []
    for link in network.links:
        g = conductance(link, network, FLOW_FLOOR)
        if g > 0 and abs(link.flow) < FLOW_FLOOR:
            floored.append(link.name)
        if g > CONDUCTANCE_CAP:
            capped.append(link.name)
        values.append(min(g, CONDUCTANCE_CAP))
    return values, tuple(floored), tuple(capped)


def _held(network: Snapshot) -> dict[int, int]:
    """Junctions whose head a valve holds, and the node at the valve's other end (0-based)."""
    held = {}
    for link in network.links:
        what = holds(link, network)
        if what == "downstream":
            held[link.ends[1]] = link.ends[0]
        elif what == "upstream":
            held[link.ends[0]] = link.ends[1]
    return {node: other for node, other in held.items() if network.nodes[node].kind == JUNCTION}


def _anchored(network: Snapshot, conductances: list[float], held: dict[int, int]) -> set[int]:
    """Nodes whose heads are determined: connected to a reservoir, a tank or a held head."""
    neighbours: dict[int, list[int]] = {}
    for link, g in zip(network.links, conductances, strict=True):
        if g > 0:
            neighbours.setdefault(link.ends[0], []).append(link.ends[1])
            neighbours.setdefault(link.ends[1], []).append(link.ends[0])
    frontier = [i for i, node in enumerate(network.nodes) if node.kind != JUNCTION or i in held]
    found = set(frontier)
    while frontier:
        new = [j for j in neighbours.get(frontier.pop(), []) if j not in found]
        found.update(new)
        frontier += new
    return found


def _laplacian(links: Sequence[Link], conductances: Sequence[float], position: Mapping[int, int]) -> Array:
    """Net inflow of each node per head [m2/s], shape (n, n); ``position`` maps nodes of the network to states."""
    flow = np.zeros((len(position), len(position)))
    for link, g in zip(links, conductances, strict=True):
        if g > 0 and link.ends[0] in position:
            i, j = position[link.ends[0]], position[link.ends[1]]
            flow[[i, j], [i, j]] -= g
            flow[[i, j], [j, i]] += g
    return flow


def _carry(held: Mapping[int, int], position: Mapping[int, int]) -> Array:
    """Which balance the inflow of a node enters: a held node hands it on through its valve, or valves in series."""
    carry = np.eye(len(position))
    for node in held:
        end, seen = held[node], {node}
        while end in held and end not in seen:
            seen.add(end)
            end = held[end]
        carry[position[node]] = 0.0
        if end in position and end not in held:
            carry[position[end], position[node]] = 1.0
    return carry


def head_model(network: Snapshot, first: Sequence[str] = ()) -> HeadModel:
    """Linearises ``network``; the junctions named in ``first`` lead the others."""
    conductances, floored, capped = _conductances(network)
    held = _held(network)
    # The flow of a valve that holds a head is no function of the heads: it couples the ends only through `carry`.
    free = [
        0.0 if holds(link, network) in ("downstream", "upstream") else g
        for link, g in zip(network.links, conductances, strict=True)
    ]
    anchored = _anchored(network, free, held)
    rank = {name: i for i, name in enumerate(first)}
    kinds = (RESERVOIR, TANK, JUNCTION)
    order = sorted(
        anchored,
        key=lambda i: (kinds.index(network.nodes[i].kind), rank.get(network.nodes[i].name, len(rank)), i),
    )
    position = {node: state for state, node in enumerate(order)}
    nodes = [network.nodes[i] for i in order]
    reservoirs = [node.kind == RESERVOIR for node in nodes]
    carry = _carry(held, position)
    flow = _laplacian(network.links, free, position) - np.diag([node.relief for node in nodes])
    flow = carry @ flow if held else flow  # a large dense product that most networks do not need
    for node in held:
        flow[position[node], position[node]] = -1.0
    flow[reservoirs], carry[reservoirs] = 0.0, 0.0
    return HeadModel(
        names=tuple(node.name for node in nodes),
        dynamic=sum(node.kind != JUNCTION for node in nodes),
        storage=frozen(np.array([1.0 if node.kind == RESERVOIR else node.area for node in nodes])),
        flow=frozen(flow),
        carry=frozen(carry),
        floored=floored,
        capped=capped,
        left_out=tuple(node.name for i, node in enumerate(network.nodes) if i not in anchored),
    )
