# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Electric grids: swing dynamics at the machines, power balance at every other bus."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .arrays import Array, matrix
from .descriptor import DescriptorSystem
from .errors import PlantError
from .grid_case import GridCase, load_case
from .plant import Plant, linear_start, suggested_settings, system_prior
from .swing import Discretisation, continuous, discretise, laplacian

WSCC9_INERTIA = (0.125, 0.034, 0.016)
WSCC9_DAMPING = (0.125, 0.068, 0.048)
# The published weights. They are the reactances of the lines, used as if they were susceptances.
WSCC9_EDGES = (
    (0, 3, 0.058), (1, 4, 0.063), (2, 5, 0.059), (3, 6, 0.085), (3, 7, 0.092),
    (4, 6, 0.161), (4, 8, 0.072), (5, 7, 0.170), (5, 8, 0.101),
)  # fmt: skip
EACH_MACHINE = (np.eye(3), ("P1", "P2", "P3"), "one power injection at each machine")
TRANSFERS = (
    np.array([[1.0, 1.0, 0.0], [-1.0, 0.0, 1.0], [0.0, -1.0, -1.0]]),
    ("P12", "P13", "P23"),
    "power transfers between machine pairs",
)
_WSCC9 = {
    "full": (*EACH_MACHINE, "x7", (5.0, 5.0)),
    "transfers": (*TRANSFERS, "c0", (5.0, 5.0)),
    "text": (*TRANSFERS, "x7", (5.0, 0.0)),
}


def _state_names(buses: Sequence[int], machines: int) -> tuple[str, ...]:
    return (*(f"omega_{b}" for b in buses[:machines]), *(f"theta_{b}" for b in buses))


def wscc9(variant: str = "transfers") -> Plant:
    """The paper's first case: the WSCC 9-bus grid with 3 machines, 0.1 s, published weights.

    x = (omega_1..3, theta_1..9). Output x1 is the speed of machine 1; x7 is the angle at bus 4;
    c0 = (sum M_i omega_i + sum D_i theta_i) / sum D_i is conserved by every transfer.

    Args:
        variant: "transfers" (inputs move power between machine pairs, outputs x1 and c0), "text" (the same inputs, the
            paper's outputs x1 and x7), or "full" (an input at each machine, outputs x1 and x7).

    Raises:
        PlantError: if the variant is not known.
    """
    if variant not in _WSCC9:
        raise PlantError(f"wscc9 has no variant {variant!r}: choose {', '.join(_WSCC9)}")
    G, inputs, story, second, Q = _WSCC9[variant]
    M, D = np.array(WSCC9_INERTIA), np.array(WSCC9_DAMPING)
    E, K, F = continuous(M, D, laplacian(9, WSCC9_EDGES), np.vstack([G, np.zeros((6, 3))]))
    C = np.zeros((2, 12))
    C[0, 0] = 1.0
    if second == "x7":
        C[1, 6] = 1.0
    else:
        C[1, :3], C[1, 3:6] = M / D.sum(), D / D.sum()
    system = DescriptorSystem(*discretise(E, K, F, 6, 0.1, "euler"), C)
    return Plant(
        name="wscc9",
        variant=variant,
        description=f"WSCC 9-bus grid, 3 machines and 6 load buses, with {story}.",
        sample_time=0.1,
        system=system,
        input_names=inputs,
        input_units=("pu",) * 3,
        output_names=("x1", second),
        output_units=("rad/s", "rad"),
        input_min=np.full(3, -1.0),
        input_max=np.full(3, 1.0),
        prior=system_prior(system),
        D=system.D,
        references=((0, np.array([3.0, 3.0])), (151, np.array([1.0, 5.0]))),
        settings={"N": 6, "L": 14, "T": 104, "Q": list(Q), "R": [1.0, 1.0, 1.0], "terminal": "none"},
        steps=200,
        begin=linear_start(system, lambda rng: np.concatenate([5.0 * rng.random(6), np.zeros(6)])),
        state_names=_state_names(range(1, 10), 3),
    )


def machine_constants(
    grid: GridCase, inertia: ArrayLike, damping: ArrayLike, frequency: float
) -> tuple[Array, Array]:  # fmt: skip
    """M = 2 H rating / (2 pi f) and D = damping * M, both shape (g,), in per unit of the system base."""
    g = grid.machines
    H = matrix(np.broadcast_to(np.asarray(inertia, dtype=np.float64), (g,)), "inertia", (g,))
    ratio = matrix(np.broadcast_to(np.asarray(damping, dtype=np.float64), (g,)), "damping", (g,))
    if not (H > 0).all() or not (grid.ratings > 0).all():
        raise PlantError("every machine needs a positive inertia and a positive rating (column mBase of gen)")
    M = 2 * H * grid.ratings / (2 * np.pi * frequency)
    return M, ratio * M


def _output_row(name: str, grid: GridCase) -> tuple[Array, str]:
    """Row of C and unit of an output called omega_<bus> or theta_<bus>."""
    kind, _, number = name.partition("_")
    buses = [str(b) for b in grid.buses]
    row = np.zeros(grid.machines + len(buses))
    if kind not in ("omega", "theta") or number not in buses:
        raise PlantError(f"{grid.name} has no output {name!r}: ask for omega_<bus> at a machine or theta_<bus>")
    i = buses.index(number)
    if kind == "omega" and i >= grid.machines:
        raise PlantError(f"bus {number} of {grid.name} has no machine, so there is no {name}")
    row[i if kind == "omega" else grid.machines + i] = 1.0
    return row, "rad/s" if kind == "omega" else "rad"


def from_case(
    case: str | Path | Mapping[str, Any] | Any,
    *,
    inertia: ArrayLike = 4.0,
    damping: ArrayLike = 1.0,
    frequency: float = 60.0,
    inputs: Sequence[int] | None = None,
    outputs: Sequence[str] | None = None,
    tau: float = 0.1,
    discretisation: Discretisation = "exact",
    limit: float = 1.0,
    name: str | None = None,
) -> Plant:
    """Linear lossless model of any grid around its operating point, every bus kept.

    Machines sit at their buses (several at one bus are merged); susceptances are 1 / (x tap), as in a DC power flow.

    Args:
        case: MATPOWER .m file, .json file or dictionary with its tables (pypower), or a pandapower net.
        inertia: H in seconds on the machine's rating mBase, a number or one for each machine bus in the case's order.
        damping: D / M in 1/s, likewise.
        frequency: Hz.
        inputs: buses where the inputs inject power (per unit); by default every machine bus.
        outputs: "omega_<bus>" (rad/s) at machines, "theta_<bus>" (rad) anywhere; by default omega at every machine bus.
        tau: sample time, s.
        discretisation: "exact" (zero-order hold), "implicit" (backward Euler) or "euler" (the paper's).
        limit: input limit, per unit.
        name: short name; by default the file's.

    Raises:
        PlantError: if the case cannot be used; the message names the bus or the branch.

    Warns:
        UserWarning: if forward Euler is unstable at this tau.
    """
    grid = load_case(case, name)
    n, g = len(grid.buses), grid.machines
    M, D = machine_constants(grid, inertia, damping, frequency)
    inputs = grid.buses[:g] if inputs is None else tuple(inputs)
    unknown = [b for b in inputs if b not in grid.buses]
    if unknown:
        raise PlantError(f"{grid.name} has no bus {unknown[0]} to inject power at")
    outputs = tuple(f"omega_{b}" for b in grid.buses[:g]) if outputs is None else tuple(outputs)
    G = np.zeros((n, len(inputs)))
    G[[grid.buses.index(b) for b in inputs], np.arange(len(inputs))] = 1.0
    rows, units = zip(*(_output_row(output, grid) for output in outputs), strict=True)
    E, K, F = continuous(M, D, laplacian(n, grid.branches), G)
    system = DescriptorSystem(*discretise(E, K, F, 2 * g, tau, discretisation), np.vstack(rows))
    prior = system_prior(system)
    return Plant(
        name=grid.name,
        variant=discretisation,
        description=f"Linear lossless grid {grid.name}: {n} buses, {g} with machines, {len(grid.branches)} branches.",
        sample_time=tau,
        system=system,
        input_names=tuple(f"P_{b}" for b in inputs),
        input_units=("pu",) * len(inputs),
        output_names=outputs,
        output_units=tuple(units),
        input_min=np.full(len(inputs), -limit),
        input_max=np.full(len(inputs), limit),
        prior=prior,
        D=system.D,
        references=((0, np.zeros(len(outputs))),),
        settings=suggested_settings(system),
        steps=200,
        begin=linear_start(system, lambda _: np.zeros(system.n)),
        state_names=_state_names(grid.buses, g),
    )
