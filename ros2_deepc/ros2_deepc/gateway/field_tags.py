# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The tag map of a plant served as a field device, as YAML, for a start."""

from collections.abc import Callable

from . import modbus_codec as codec
from .field import FieldPlant
from .field_modbus import FIRST_INPUT, FIRST_OUTPUT

_HEAD = """\
# How the zone sees {name} behind {kind}. `ros2-deepc gateway THIS --check` reads every tag once and writes nothing.
plant:
  name: {name}
  variant: {variant!r}
  sample_time: {Ts}
  registered: {registered}
  options: {{{options}}}
  prior: {{n: {n}, q: {q}, r: {r}, s: {s}}}
"""


def tag_map(
    plant: FieldPlant, link: str, places: Callable[[str, int], str], *, registered: str, options: dict[str, str],
    speed: float = 1.0, rate: float | None = None,
) -> str:  # fmt: skip
    """A tag map as YAML.

    Args:
        plant: what is served.
        link: the section ``link``, one line.
        places: (role, i) -> place, one line; roles are output, input, scan, echo and beat.
        registered: name under which the plant is registered.
        options: of the plant.
        speed: how many times faster than its own time the plant is run.
        rate: largest change of every input per second of the plant; default: the whole range within one sample.
    """
    prior = plant.prior
    kind = link.split("kind:")[1].split(",")[0].strip(" {}")
    lines = [
        _HEAD.format(
            name=plant.name, variant=plant.variant, Ts=plant.sample_time, registered=registered, kind=kind,
            options=", ".join(f"{key}: {value}" for key, value in options.items()),
            n=prior.n, q=prior.q, r=prior.r, s=prior.s,
        ).rstrip(),
        f"link: {link}",
        f"sampling: {{by: scan, speed: {speed:g}, counter: {places('scan', 0)}}}",
        f"heartbeat: {{write: {places('beat', 0)}, echo: {places('echo', 0)}}}",
        f"fallback: {{policy: ramp, seconds: {20 * plant.sample_time / speed:g}}}",
        "outputs:",
    ]  # fmt: skip
    for i, (name, unit) in enumerate(zip(plant.output_names, plant.output_units, strict=True)):
        lines.append(f"  - {{name: {name}, unit: {unit!r}, at: {places('output', i)}}}")
    lines.append("inputs:")
    for i, (name, unit) in enumerate(zip(plant.input_names, plant.input_units, strict=True)):
        low, high = float(plant.input_min[i]), float(plant.input_max[i])
        fastest = (rate or (high - low) / plant.sample_time) * speed
        safe = min(max(0.0, low), high)
        lines.append(
            f"  - {{name: {name}, unit: {unit!r}, limits: [{low:g}, {high:g}], max_rate: {fastest:g}, "
            f"safe: {safe:g}, at: {places('input', i)}}}"
        )
    return "\n".join(lines) + "\n"


def modbus_places(kind: str) -> Callable[[str, int], str]:
    """Places of `field_modbus`, for `tag_map`."""
    size = codec.size(kind)

    def place(role: str, i: int) -> str:
        table, address = {
            "scan": ("input", 0),
            "echo": ("input", 1),
            "output": ("input", FIRST_OUTPUT + i * size),
            "beat": ("holding", 0),
            "input": ("holding", FIRST_INPUT + i * size),
        }[role]
        number = kind if role in ("output", "input") else "uint16"
        return f"{{table: {table}, address: {address}, type: {number}}}"

    return place
