# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Registered plants, found by entry point and never by import: nobody here knows their models."""

from collections.abc import Mapping
from importlib.metadata import entry_points
from typing import Any

GROUP = "ros2_deepc.plants"


def find_plant(name: str, options: Mapping[str, str]) -> Any:
    """Makes a registered plant.

    Args:
        name: its entry point in the group `ros2_deepc.plants`.
        options: of the plant; numbers may be given as text.

    Raises:
        ValueError: in one line, for an unknown name or an option that the plant does not have.
    """
    found = {entry.name: entry for entry in entry_points(group=GROUP)}
    if name not in found:
        raise ValueError(f"unknown plant {name!r}; there are: {', '.join(sorted(found))}")
    try:
        return found[name].load()(**{key: as_number(value) for key, value in options.items()})
    except (TypeError, ValueError) as error:
        raise ValueError(f"plant {name}: {error}") from None


def as_number(text: str) -> Any:
    """Text as an integer or a float where it is one, else as it is."""
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
