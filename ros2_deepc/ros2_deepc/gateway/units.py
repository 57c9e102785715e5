# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Names and units of a tag map against those of a registered plant."""

from collections.abc import Sequence

from .errors import GatewayError
from .field import FieldPlant, find_plant
from .tags import ReadTag, TagMap, WriteTag


def check_registered(tags: TagMap) -> None:
    """Whether the tags are what the registered plant that the map names would say of itself.

    Raises:
        GatewayError: for the first name, unit, limit or sample time that differs.
    """
    if tags.plant.registered:
        compare(tags, find_plant(tags.plant.registered, tags.plant.options))


def compare(tags: TagMap, plant: FieldPlant) -> None:
    """See `check_registered`."""
    if tags.plant.sample_time != plant.sample_time:
        raise GatewayError(
            f"{tags.file}: plant.sample_time is {tags.plant.sample_time:g} s, {plant.name} has {plant.sample_time:g} s"
        )
    _same(tags, "outputs", tags.outputs, plant.output_names, plant.output_units)
    _same(tags, "inputs", tags.inputs, plant.input_names, plant.input_units)
    for i, tag in enumerate(tags.inputs):
        low, high = float(plant.input_min[i]), float(plant.input_max[i])
        if not low <= tag.low < tag.high <= high:
            _fail(tags, "inputs", i, f"limits [{tag.low:g}, {tag.high:g}] reach beyond the plant's [{low:g}, {high:g}]")


def _same(
    tags: TagMap, kind: str, mine: Sequence[ReadTag | WriteTag], names: Sequence[str], units: Sequence[str]
) -> None:
    if len(mine) != len(names):
        raise GatewayError(f"{tags.file}: {len(mine)} {kind}, the plant has {len(names)}: {', '.join(names)}")
    for i, (tag, name, unit) in enumerate(zip(mine, names, units, strict=True)):
        if tag.name != name:
            _fail(tags, kind, i, f"is called {tag.name}, the plant's is {name}")
        if tag.unit != unit:
            _fail(tags, kind, i, f"{name} is in {tag.unit!r}, the plant's is in {unit!r}: give raw_unit and scale")


def _fail(tags: TagMap, kind: str, i: int, problem: str) -> None:
    line, column = tags.places.get(f"{kind}.{i}", (0, 0))
    where = f", line {line}, column {column}" if line else ""
    raise GatewayError(f"{tags.file}{where}: {kind}[{i}]: {problem}")
