# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Parameters as one table: declaration, ranges, defaults and documentation come from the same rows."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import (
    InvalidParameterTypeException,
    InvalidParameterValueException,
    ParameterUninitializedException,
)
from rclpy.node import Node

_LARGEST = 2**62


class ConfigError(ValueError):
    """A setting that cannot work; the message is one line that says what, where and what to do."""


@dataclass(frozen=True, slots=True)
class Param:
    """One parameter: name, default (which fixes the type), meaning, unit, range, choices.

    Attributes:
        name: relative name, dots group.
        default: value when nothing is given; an empty list of strings or numbers needs ``kind``.
        description: one sentence, with shape where it is an array.
        unit: unit, empty for a pure number.
        low: smallest value allowed, or None.
        high: largest value allowed, or None.
        choices: the allowed strings; empty = any.
        live: may change while the node runs.
    """

    name: str
    default: bool | int | float | str | list[Any]
    description: str
    unit: str = ""
    low: float | None = None
    high: float | None = None
    choices: tuple[str, ...] = ()
    live: bool = False

    def text(self) -> str:
        """Description with unit and choices, for descriptors and documentation."""
        unit = f" [{self.unit}]" if self.unit else ""
        choices = f" ({' | '.join(self.choices)})" if self.choices else ""
        return f"{self.description}{unit}{choices}"

    def descriptor(self) -> ParameterDescriptor:
        """The ROS descriptor; rclpy then refuses values out of range by itself."""
        d = ParameterDescriptor(name=self.name, description=self.text(), read_only=not self.live)
        if self.low is not None or self.high is not None:
            if isinstance(self.default, int):
                low = -_LARGEST if self.low is None else int(self.low)
                high = _LARGEST if self.high is None else int(self.high)
                d.integer_range = [IntegerRange(from_value=low, to_value=high, step=0)]
            else:
                low_f = -1e308 if self.low is None else float(self.low)
                high_f = 1e308 if self.high is None else float(self.high)
                d.floating_point_range = [FloatingPointRange(from_value=low_f, to_value=high_f, step=0.0)]
        return d


def declare(node: Node, table: Iterable[Param]) -> dict[str, Any]:
    """Declares every parameter of a table on a node and returns the values in force.

    Raises:
        ConfigError: for a value of the wrong type, out of range or not among the choices.
    """
    values: dict[str, Any] = {}
    for row in table:
        try:
            value = node.declare_parameter(row.name, row.default, row.descriptor()).value
        except (InvalidParameterTypeException, ParameterUninitializedException):
            kind = type(row.default).__name__
            raise ConfigError(
                f"{node.get_name()}: parameter {row.name} must be of type {kind}, for example {row.default!r}"
            ) from None
        except InvalidParameterValueException:
            given = node._parameter_overrides[row.name].value  # rclpy keeps the refused value nowhere public
            raise ConfigError(
                f"{node.get_name()}: parameter {row.name} = {given!r} is out of range {row.low}..{row.high}: {row.text()}"
            ) from None
        if row.choices and value not in row.choices:
            raise ConfigError(
                f"{node.get_name()}: parameter {row.name} = {value!r} is not one of {', '.join(row.choices)}"
            )
        values[row.name] = list(value) if not isinstance(value, str) and hasattr(value, "__len__") else value
    return values


def markdown(table: Iterable[Param]) -> str:
    """The table as Markdown, for the documentation."""
    lines = ["| parameter | default | meaning |", "|---|---|---|"]
    for row in table:
        bounds = "" if row.low is None and row.high is None else f" Range {row.low}..{row.high}."
        lines.append(f"| `{row.name}` | `{row.default}` | {row.text()}.{bounds} |")
    return "\n".join(lines)
