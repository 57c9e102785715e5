# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Nonlinear grids as plants: the WSCC 9-bus grid with physical lines, and any case."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .arrays import Array
from .errors import PlantError
from .grid_case import load_case
from .grid_events import parse_events
from .plant import Plant, StructurePrior
from .power import EACH_MACHINE, TRANSFERS, WSCC9_DAMPING, WSCC9_EDGES, WSCC9_INERTIA, machine_constants
from .swing_dae import SwingGrid
from .swing_stepper import SwingRun, SwingStepper

WSCC9_GENERATION = (0.67, 1.63, 0.85)
WSCC9_LOAD = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.25, 0.90, 1.00)
HERTZ = 1 / (2 * np.pi)


def _measured(outputs: str, grid: SwingGrid) -> tuple[tuple[str, ...], tuple[str, ...], Array]:
    """Names, units and rows of C from a list such as "f_1 f_2 theta_4"; every machine's frequency if empty."""
    g, buses = grid.machines, [str(bus) for bus in grid.buses]
    names = tuple(outputs.replace(",", " ").split()) or tuple(f"f_{bus}" for bus in buses[:g])
    C, units = np.zeros((len(names), g + len(buses))), []
    for row, name in zip(C, names, strict=True):
        kind, _, bus = name.partition("_")
        if kind not in ("f", "theta") or bus not in buses or (kind == "f" and bus not in buses[:g]):
            raise PlantError(f"no output {name!r}: ask for f_<bus> at a machine [Hz] or theta_<bus> at any bus [rad]")
        row[buses.index(bus) + (0 if kind == "f" else g)] = HERTZ if kind == "f" else 1.0
        units.append("Hz" if kind == "f" else "rad")
    return names, tuple(units), C


def _plant(
    name: str,
    variant: str,
    description: str,
    grid: SwingGrid,
    G: Array,
    input_names: tuple[str, ...],
    *,
    outputs: str,
    events: str,
    lag: float,
    noise: float,
    limit: float,
    tau: float,
    substeps: int,
    steps: int,
    notes: tuple[str, ...] = (),
) -> Plant:
    """What both makers share."""
    if not (lag >= 0 and noise >= 0 and limit > 0 and tau > 0 and substeps >= 0):
        raise PlantError("lag, noise and substeps must not be negative, limit and tau must be positive")
    names, units, C = _measured(outputs, grid)
    rows = np.where(np.array(units) == "Hz", HERTZ, 1.0)
    run = SwingRun(
        G=G, C=C, tau=tau, substeps=substeps, lag=lag, noise=noise * rows, events=parse_events(events)
    )  # fmt: skip
    SwingStepper(grid, run, None)  # so that mistakes show now
    m, p = len(input_names), len(names)
    # frequencies alone do not show where all angles are together
    q = 2 * grid.machines - (0 if "rad" in units else 1) + (m if lag else 0)
    return Plant(
        name=name,
        variant=variant,
        description=description,
        sample_time=tau,
        system=None,
        input_names=input_names,
        input_units=("pu",) * m,
        output_names=names,
        output_units=units,
        input_min=np.full(m, -limit),
        input_max=np.full(m, limit),
        prior=StructurePrior(q=q, s=1),
        D=np.zeros((p, m)),
        references=((0, np.zeros(p)),),
        settings={
            "N": 6,
            "L": 14,
            "T": 200,
            "Q": [1.0] * p,
            "R": [0.01] * m,
            "terminal": "none",
            "form": "incremental",
        },
        steps=steps,
        begin=lambda rng: SwingStepper(grid, run, rng),
        notes=notes,
    )


def wscc9_swing(
    inputs: str = "machines",
    outputs: str = "",
    events: str = "load 9 +0.3 @ 250",
    lag: float = 0.0,
    noise: float = 1e-3,
    limit: float = 0.6,
    substeps: int = 0,
) -> Plant:
    """The WSCC 9-bus grid as a nonlinear DAE: susceptances 1/x, sines, six algebraic buses, 0.1 s.

    Inertia, damping and reactances are the paper's (section 6.1), loads and generation those of the IEEE case. Outputs
    are frequency deviations in Hz; without control, a load step dP shifts them all by -dP / (2 pi sum D).

    Args:
        inputs: "machines" (an input at each), or "transfers" (power between machine pairs, net power zero).
        outputs: such as "f_1 f_2 f_3 theta_1"; by default the frequencies of all machines.
        events: such as "load 9 +0.3 @ 250; trip 4-7 @ 300; close 4-7 @ 320; limit 2 0 1.7 @ 0".
        lag: time constant of the turbines, s.
        noise: standard deviation of the measurement noise: rad/s on speeds, rad on angles.
        limit: input limit, per unit.
        substeps: steps of the integrator per sample; 0 chooses them from the fastest mode.

    Raises:
        PlantError: if an option is not understood.
    """
    if inputs not in ("machines", "transfers"):
        raise PlantError(f"wscc9_swing has no inputs {inputs!r}: choose machines or transfers")
    G, names = (EACH_MACHINE if inputs == "machines" else TRANSFERS)[:2]
    grid = SwingGrid(
        buses=tuple(range(1, 10)),
        M=np.array(WSCC9_INERTIA),
        D=np.array(WSCC9_DAMPING),
        branches=tuple((i, j) for i, j, _ in WSCC9_EDGES),
        b=1 / np.array([x for _, _, x in WSCC9_EDGES]),
        generation=np.array(WSCC9_GENERATION),
        load=np.array(WSCC9_LOAD),
    )
    return _plant(
        "wscc9_swing",
        inputs,
        "WSCC 9-bus grid as a nonlinear DAE: swing equations with sines, six algebraic load buses, physical lines.",
        grid,
        G,
        names,
        outputs=outputs,
        events=events,
        lag=lag,
        noise=noise,
        limit=limit,
        tau=0.1,
        substeps=substeps,
        steps=400,
    )


def swing_from_case(
    case: str | Path | Mapping[str, Any] | Any,
    *,
    inertia: ArrayLike = 4.0,
    damping: ArrayLike = 1.0,
    frequency: float = 60.0,
    outputs: str = "",
    events: str = "",
    lag: float = 0.0,
    noise: float = 1e-3,
    limit: float = 0.5,
    tau: float = 0.1,
    substeps: int = 0,
    name: str | None = None,
) -> Plant:
    """Nonlinear lossless model of any grid at its scheduled powers, nominal voltages, an input at each machine bus.

    Args:
        case: MATPOWER .m file, .json file or dictionary with its tables (pypower), or a pandapower net.
        inertia: H in seconds on the machine's rating mBase, a number or one for each machine bus in the case's order.
        damping: D / M in 1/s, likewise.
        frequency: Hz.
        outputs: as in `wscc9_swing`.
        events: as in `wscc9_swing`.
        lag: time constant of the turbines, s.
        noise: as in `wscc9_swing`.
        limit: input limit, per unit.
        tau: sample time, s.
        substeps: steps of the integrator per sample; 0 chooses them from the fastest mode.
        name: short name; by default the file's.

    Raises:
        PlantError: if the case cannot be used or has no operating point.
    """
    read = load_case(case, name)
    M, D = machine_constants(read, inertia, damping, frequency)
    generation = read.generation.copy()
    missing = float(read.load.sum() - generation.sum())
    generation[read.reference] += missing
    balancing = read.buses[read.reference]
    grid = SwingGrid(
        buses=read.buses,
        M=M,
        D=D,
        branches=tuple((i, j) for i, j, _ in read.branches),
        b=np.array([b for *_, b in read.branches]),
        generation=generation,
        load=read.load,
    )
    g = grid.machines
    return _plant(
        read.name,
        "swing",
        f"Grid {read.name} as a nonlinear DAE: {len(read.buses)} buses, {g} with machines, {len(grid.b)} branches.",
        grid,
        np.eye(g),
        tuple(f"P_{bus}" for bus in read.buses[:g]),
        outputs=outputs,
        events=events,
        lag=lag,
        noise=noise,
        limit=limit,
        tau=tau,
        substeps=substeps,
        steps=400,
        notes=(f"the machine at bus {balancing} takes the {missing:.4g} pu that the schedule leaves open",),
    )
