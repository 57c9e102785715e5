# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""How much the flow of a link changes with the head across it: g = dQ/dh [m2/s] at a given flow."""

from math import inf, log, log10, pi

from .errors import PlantError
from .hydraulics import CHECK_VALVE_PIPE, FCV, GPV, PBV, PIPE, PRV, PSV, PUMP, Link, Snapshot

FOOT = 0.3048
GRAVITY = 9.81456  # 32.2 ft/s2, EPANET's
HELD = 1e-3  # m: a valve that holds a head is this close to its setting


def _darcy_weisbach(link: Link, flow: float, viscosity: float) -> float:
    """Friction head loss [m]; Swamee-Jain above Re = 4000, laminar below 2000, linear in Re between."""
    reynolds = 4 * flow / (pi * link.diameter * viscosity)

    def turbulent(Re: float) -> float:
        relative = link.roughness / 1000 / link.diameter
        return 0.25 / log10(relative / 3.7 + 5.74 / Re**0.9) ** 2

    if reynolds <= 2000:
        friction = 64 / reynolds
    elif reynolds >= 4000:
        friction = turbulent(reynolds)
    else:
        weight = (reynolds - 2000) / 2000
        friction = (1 - weight) * 0.032 + weight * turbulent(4000.0)
    return friction * link.length * 8 * flow**2 / (GRAVITY * pi**2 * link.diameter**5)


def pipe_slope(link: Link, flow: float, formula: str, viscosity: float) -> float:
    """dh/dQ [s/m2] of a pipe at ``flow`` > 0 [m3/s], friction plus minor loss."""
    minor = 2 * link.minor_loss * 8 * flow / (GRAVITY * pi**2 * link.diameter**4)
    if formula == "DW":
        step = 1e-5 * flow
        rise = _darcy_weisbach(link, flow + step, viscosity) - _darcy_weisbach(link, flow - step, viscosity)
        return rise / (2 * step) + minor
    length, diameter = link.length / FOOT, link.diameter / FOOT
    if formula == "HW":
        exponent, resistance = 1.852, 4.727 * length / (link.roughness**1.852 * diameter**4.871)
    else:  # Chezy-Manning
        exponent = 2.0
        resistance = (4 * link.roughness / (1.49 * pi * diameter**2)) ** 2 * (diameter / 4) ** -1.333 * length
    cfs = flow / FOOT**3
    return float(exponent * resistance * cfs ** (exponent - 1) / FOOT**2 + minor)


def pump_slope(link: Link, flow: float, gain: float) -> float:
    """-dh/dQ [s/m2] of a pump's head curve at ``flow`` > 0 [m3/s] and head gain ``gain`` [m]."""
    if link.constant_power:
        return gain / flow
    points = link.curve
    if len(points) == 1:
        (q1, h1), exponent = points[0], 2.0
        factor = h1 / 3 / q1**2
    elif len(points) == 3 and points[0][0] == 0:
        (_, h0), (q1, h1), (q2, h2) = points
        exponent = log((h0 - h2) / (h0 - h1)) / log(q2 / q1)
        factor = (h0 - h1) / q1**exponent
    else:
        return -_segment_slope(link, flow / link.setting) * link.setting  # head grows with the square of the speed
    return float(factor * exponent * link.setting ** (2 - exponent) * flow ** (exponent - 1))


def _segment_slope(link: Link, at: float) -> float:
    """Slope of the segment of the link's curve at ``at`` [m3/s]; the outer segments go on beyond their ends."""
    for (q1, h1), (q2, h2) in zip(link.curve, link.curve[1:], strict=False):
        if at <= q2 or (q2, h2) == link.curve[-1]:
            return (h2 - h1) / (q2 - q1)
    raise PlantError(f"the curve of link {link.name} needs at least two points")


def conductance(link: Link, network: Snapshot, flow_floor: float = 1e-5) -> float:
    """dQ/dh [m2/s] of a link at the network's steady state, |Q| floored at ``flow_floor``.

    0 if the link is closed or holds its flow (FCV); infinite if it holds its head loss (PBV).
    """
    if not link.open or holds(link, network) == "flow":
        return 0.0
    flow = max(abs(link.flow), flow_floor)
    heads = [network.nodes[i].head for i in link.ends]
    if link.kind == PUMP:
        slope = pump_slope(link, flow, heads[1] - heads[0])
    elif link.kind in (PIPE, CHECK_VALVE_PIPE):
        slope = pipe_slope(link, flow, network.formula, network.viscosity)
    elif holds(link, network) == "loss":
        slope = 0.0
    elif link.kind == GPV:
        slope = _segment_slope(link, flow)
    else:  # an open valve: its loss grows with the square of the flow
        slope = 2 * abs(heads[1] - heads[0]) / flow
    return 1 / slope if slope > 0 else inf


def holds(link: Link, network: Snapshot) -> str:
    """What a valve holds just now: "downstream" or "upstream" head, "flow", head "loss", or "" for nothing."""
    if not link.open or link.setting <= 0:
        return ""
    upstream, downstream = (network.nodes[i] for i in link.ends)
    if link.kind == PRV and abs(downstream.head - downstream.elevation - link.setting) < HELD:
        return "downstream"
    if link.kind == PSV and abs(upstream.head - upstream.elevation - link.setting) < HELD:
        return "upstream"
    if link.kind == FCV and abs(link.flow - link.setting) < 1e-6 + 1e-4 * link.setting:
        return "flow"
    return "loss" if link.kind == PBV else ""


def speed_gain(link: Link, network: Snapshot, flow_floor: float = 1e-5) -> float:
    """Flow gained per relative speed [m3/s] at fixed heads, by the affinity laws h = w^2 f(Q / w).

    Raises:
        PlantError: if the pump is off or runs at constant power.
    """
    if not link.open or link.setting <= 0:
        raise PlantError(f"pump {link.name} is off at this hour, so its speed has no effect")
    if link.constant_power:
        raise PlantError(f"pump {link.name} runs at constant power, so its speed is not an input")
    flow = max(abs(link.flow), flow_floor)
    head = network.nodes[link.ends[1]].head - network.nodes[link.ends[0]].head
    slope = pump_slope(link, flow, head)
    return (2 * head + flow * slope) / link.setting / slope
