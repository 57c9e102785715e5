# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""A plant in words and numbers, for people."""

from collections.abc import Iterator, Sequence

import numpy as np

from .arrays import Array
from .descriptor import DescriptorSystem
from .errors import PlantError
from .plant import Plant
from .reach import Reach
from .steady import SteadyStates, steady_states

SHOWN = 12  # longer lists are cut


def _number(x: float) -> str:
    return f"{0.0 if abs(x) < 1e-9 else x:.6g}"


def _complex(z: complex) -> str:
    real = f"{z.real:.6f}"
    return real if abs(z.imag) < 5e-7 else f"{real} +- {abs(z.imag):.6f}i"


def _modes(values: Sequence[complex]) -> str:
    upper = sorted((z for z in values if z.imag >= 0), key=lambda z: -abs(z))
    text = ", ".join(_complex(z) for z in upper[:SHOWN])
    return text + (f", ... ({len(upper)} in all)" if len(upper) > SHOWN else "")


def _duration(seconds: float) -> str:
    if seconds < 60:
        return f"{seconds:g} s"
    return f"{seconds:g} s ({seconds / 60:g} min)" if seconds < 3600 else f"{seconds:g} s ({seconds / 3600:g} h)"


def _reach(what: str, reach: Reach) -> str:
    verdict = "yes" if reach.full else "NO"
    line = f"R-{what}: {verdict}, {reach.rank} of {reach.required}"
    if reach.full:
        return f"{line}, margin {reach.margin:.1e}"
    return f"{line}, lost at lambda = {_modes(reach.modes)}"


def _combination(row: Array, names: Sequence[str]) -> str:
    terms = [
        ("" if abs(value - 1) < 1e-9 else f"{value:.4g} ") + (names[i] if names else f"x{i + 1}")
        for i, value in enumerate(row) if value != 0
    ]  # fmt: skip
    return " + ".join(terms[:SHOWN]).replace("+ -", "- ") + (" + ..." if len(terms) > SHOWN else "")


def _structure(system: DescriptorSystem, names: Sequence[str]) -> Iterator[str]:
    form, found = system.weierstrass(), system.structure()
    yield f"structure     n = {system.n}, q = {form.q}, r = {form.r}, s = {form.s}"
    yield f"eigenvalues   {_modes([complex(z) for z in np.linalg.eigvals(form.A1)])}"
    yield f"              {_reach('controllable', found.controllability)}"
    yield f"              {_reach('observable', found.observability)}"
    for word, whole, finite in (
        ("controllable", found.c_controllable, found.r_controllable),
        ("observable", found.c_observable, found.r_observable),
    ):
        why = "" if whole or not finite else " (the algebraic part is not)"
        yield f"              C-{word}: {'yes' if whole else 'NO'}{why}"
    for row in found.conserved:
        yield f"conserved     {_combination(row, names)}"


def _rest(plant: Plant, system: DescriptorSystem) -> Iterator[str]:
    """Resting ranges from rest, and how far each reference is from what the run can hold (started with seed 0)."""
    stepper = plant.start(0)
    z10 = getattr(stepper, "z1", None)
    states: SteadyStates = steady_states(system, plant.input_min, plant.input_max, z10)
    try:
        low, high = states.output_range()
    except PlantError as error:
        yield f"at rest       {error}"
        return
    resting = list(zip(plant.output_names, plant.output_units, low, high, strict=True))
    for name, unit, a, b in resting[:SHOWN]:
        text = "any value" if np.isinf([a, b]).all() else f"{_number(a)} to {_number(b)}"
        if abs(b - a) < 1e-9 * max(1.0, abs(a)):
            text = f"{_number(a)} only"
        yield f"at rest       {name}: {text} {unit} (seed 0, inputs within limits)"
    for k, values in plant.references:
        _, _, distance = states.nearest(values)
        held = "can be held" if distance < 1e-6 else f"is no steady state, {_number(distance)} away from one"
        yield f"reference     from k = {k}: ({', '.join(_number(v) for v in values)}) {held}"


def describe(plant: Plant) -> str:
    """Everything a plant tells about itself, as text of a few dozen lines."""
    lines = [f"{plant.name} ({plant.variant})", plant.description, ""]
    lines.append(f"sample time   {_duration(plant.sample_time)}, suggested run {plant.steps} samples")
    for i, (name, unit) in enumerate(zip(plant.input_names, plant.input_units, strict=True)):
        if i == SHOWN:
            lines.append(f"input         ... ({len(plant.input_names)} in all)")
            break
        lines.append(f"input         {name} [{unit}] in [{plant.input_min[i]:g}, {plant.input_max[i]:g}]")
    for i, (name, unit) in enumerate(zip(plant.output_names, plant.output_units, strict=True)):
        if i == SHOWN:
            lines.append(f"output        ... ({len(plant.output_names)} in all)")
            break
        lines.append(f"output        {name} [{unit}]")
    if plant.system is None:
        n, q, r, s = plant.prior
        lines.append(f"structure     nonlinear; prior n = {n}, q = {q}, r = {r}, s = {s} (0 = not known)")
    else:
        lines += _structure(plant.system, plant.state_names)
        lines += _rest(plant, plant.system)
    lines.append("controller    " + ", ".join(f"{key} = {value}" for key, value in plant.settings.items()))
    lines += [f"note          {note}" for note in plant.notes]
    return "\n".join(lines)
