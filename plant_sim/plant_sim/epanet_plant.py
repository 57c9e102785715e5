# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Water networks with EPANET's own hydraulics as plants: Net3, and any .inp file."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from .arrays import Array, matrix
from .demand import parse_demand
from .epanet_live import EpanetStepper, LiveNetwork
from .errors import PlantError
from .plant import Plant, StructurePrior
from .water import NET3

UNITS = {"pump": "1", "valve": "m", "inject": "m3/s", "level": "m", "pressure": "m", "head": "m", "flow": "m3/s",
         "demand": "m3/s"}  # fmt: skip


def epanet_from_inp(
    path: str | Path,
    *,
    inputs: Sequence[str],
    outputs: Sequence[str],
    input_min: ArrayLike,
    input_max: ArrayLike,
    dt: int = 900,
    demand: str = "constant",
    multiplier: float = 1.0,
    swing: float = 0.1,
    noise: ArrayLike = 0.0,
    references: Sequence[tuple[int, Mapping[str, float]]] = (),
    steps: int = 400,
    name: str | None = None,
) -> Plant:
    """Any EPANET network, solved by EPANET sample by sample.

    Args:
        path: the .inp file; its controls and rules are switched off.
        inputs: "pump:NAME" (relative speed), "valve:NAME" (its setting) or "inject:NODE" (m3/s).
        outputs: "level:TANK", "pressure:NODE", "head:NODE" (m), "flow:LINK" or "demand" (m3/s).
        input_min: shape (m,).
        input_max: shape (m,).
        dt: sample time, whole seconds.
        demand: "constant", "diurnal", "file" (the network's own patterns), or a text file of factors.
        multiplier: on the demand.
        swing: amplitude of the daily sine of "diurnal".
        noise: standard deviation of the measurement noise, one or one an output.
        references: (k, values by output name): they hold from sample k on; without any, the outputs at the start.
        steps: suggested length of a run.
        name: short name; by default the file's.

    Raises:
        PlantError: if EPANET cannot read the file, or an option is wrong.
    """
    if not inputs or not outputs:
        raise PlantError("a network needs at least one input and one output")
    if int(dt) != dt or dt < 1:
        raise PlantError(f"dt = {dt}: EPANET steps in whole seconds")
    m, p = len(inputs), len(outputs)
    drawn = parse_demand(demand, multiplier, swing, dt)
    std = matrix(np.broadcast_to(np.asarray(noise, dtype=np.float64), (p,)), "noise", (p,))
    if (std < 0).any():
        raise PlantError("noise must not be negative")
    low, high = matrix(input_min, "input_min", (m,)), matrix(input_max, "input_max", (m,))

    def network() -> LiveNetwork:
        return LiveNetwork(path, inputs, outputs, int(dt), drawn)

    first = network()
    tanks = len(first.tanks)
    at_start = EpanetStepper(first, np.zeros(p), np.random.default_rng(0)).push((low + high) / 2)
    first.close()
    levels = all(tag.what in ("level", "demand") for tag in first.outputs)
    weights = [float(tag.what != "demand") for tag in first.outputs]
    kinds = [name.partition(":")[0] for name in (*inputs, *outputs)]
    return Plant(
        name=name or first.name,
        variant=f"{'own' if demand == 'file' else Path(demand).stem} demand",
        description=f"EPANET network {first.name}, solved by EPANET itself: {tanks} tanks, {dt} s a sample.",
        sample_time=float(dt),
        system=None,
        input_names=tuple(inputs),
        input_units=tuple(UNITS[kind] for kind in kinds[:m]),
        output_names=tuple(outputs),
        output_units=tuple(UNITS[kind] for kind in kinds[m:]),
        input_min=low,
        input_max=high,
        prior=StructurePrior(q=tanks + 2 * ("demand" in outputs), s=1),  # a daily wave has two states
        D=np.zeros((p, m)) if levels else None,
        references=_schedule(references, outputs, at_start),
        settings={"N": 6, "L": 16, "T": 150, "Q": weights, "R": [0.01] * m, "terminal": "none", "form": "incremental"},
        steps=steps,
        begin=lambda rng: EpanetStepper(network(), std, rng),
    )  # fmt: skip


def _schedule(
    references: Sequence[tuple[int, Mapping[str, float]]], outputs: Sequence[str], at_start: Array
) -> tuple[tuple[int, Array], ...]:
    """References for all outputs: each keeps what it last was, the outputs at the start to begin with."""
    held, schedule = at_start.copy(), []
    for k, values in references:
        for name, value in values.items():
            held[outputs.index(name)] = value
        schedule.append((k, held.copy()))
    return tuple(schedule) or ((0, at_start),)


def net3_epanet(
    demand: str = "constant",
    multiplier: float = 1.2,
    swing: float = 0.1,
    outputs: str = "level:3",
    noise: float = 0.0,
    steps: int = 400,
) -> Plant:
    """EPANET's Net3 live: the level of tank 3 by the speeds of both pumps, 15 minutes a sample.

    Args:
        demand: "constant", "diurnal", "file" (Net3's own patterns), or a text file of factors.
        multiplier: on the demand; 1.2 keeps all tanks off their ends.
        swing: amplitude of the daily sine of "diurnal".
        outputs: such as "level:3 pressure:61 demand".
        noise: standard deviation of the measurement noise, m.
        steps: suggested length of a run.

    Raises:
        PlantError: if an option is not understood.
    """
    measured = outputs.replace(",", " ").split()
    goals = ((0, {"level:3": 9.4}), (275, {"level:3": 9.2})) if "level:3" in measured else ()
    return epanet_from_inp(
        NET3,
        inputs=("pump:335", "pump:10"),
        outputs=measured,
        input_min=(0.4, 0.8),
        input_max=(0.8, 1.2),
        dt=900,
        demand=demand,
        multiplier=multiplier,
        swing=swing,
        noise=noise,
        references=goals,
        steps=steps,
        name="net3_epanet",
    )
