# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Parameters as one table: declaration, ranges, defaults and documentation come from the same rows."""

import difflib
import math
from collections.abc import Iterable, Mapping
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
_COMMON = ("use_sim_time", "autostart")  # parameters of every node


class ConfigError(ValueError):
    """A setting that cannot work; the message is one line that says what, where and what to do."""


@dataclass(frozen=True, slots=True)
class Param:
    """One parameter: name, default (which fixes the type), meaning, unit, range, choices.

    Attributes:
        name: relative name, dots group.
        default: value when nothing is given; a list needs an entry, which fixes the type of all.
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
        choices = f"; one of {', '.join(self.choices)}" if self.choices else ""
        return f"{self.description}{unit}{choices}"

    def complaint(self, value: Any) -> str:
        """What is wrong with a value, in one line; empty if nothing is."""
        values = value if isinstance(self.default, list) and isinstance(value, (list, tuple)) else [value]
        kind = type(self.default[0] if isinstance(self.default, list) else self.default)
        if isinstance(value, (list, tuple)) != isinstance(self.default, list) or not all(
            type(v) is kind for v in values
        ):
            hint = " (write a decimal point)" if kind is float and all(type(v) in (int, float) for v in values) else ""
            return f"{self.name} = {value!r} should be like {self.default!r}{hint}: {self.text()}"
        if self.choices and value not in self.choices:
            return f"{self.name} = {value!r} is not one of {', '.join(self.choices)}"
        low, high = -math.inf if self.low is None else self.low, math.inf if self.high is None else self.high
        if kind in (int, float) and not all(low <= v <= high for v in values):
            return f"{self.name} = {value!r} is out of range {low}..{high}: {self.text()}"
        return ""

    def range(self) -> str:
        """The allowed range as text; empty if there is none."""
        if self.low is None and self.high is None:
            return ""
        if self.high is None:
            return f"; at least {self.low}"
        return f"; {self.low} to {self.high}" if self.low is not None else f"; at most {self.high}"

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
        except (InvalidParameterTypeException, InvalidParameterValueException, ParameterUninitializedException):
            value = node._parameter_overrides[row.name].value  # rclpy keeps a refused value nowhere public
        value = value.tolist() if hasattr(value, "tolist") else value
        if complaint := row.complaint(value):
            raise ConfigError(f"{node.get_name()}: {complaint}")
        values[row.name] = value
    return values


def check(owner: str, table: Iterable[Param], given: Mapping[str, Any]) -> None:
    """Checks values against a table before any node exists.

    Raises:
        ConfigError: for a name that is not in the table (ROS itself ignores those) or a value that does not fit.
    """
    rows = {row.name: row for row in table}
    for name, value in given.items():
        if name in _COMMON:
            continue
        if name not in rows:
            near = difflib.get_close_matches(name, rows, n=1)
            advice = f"did you mean {near[0]}?" if near else f"it has {', '.join(rows)}"
            raise ConfigError(f"{owner} has no parameter {name!r}: {advice}")
        if complaint := rows[name].complaint(value):
            raise ConfigError(f"{owner}: {complaint}")


def markdown(table: Iterable[Param]) -> str:
    """The table as Markdown, for the documentation."""
    rows = (f"| `{row.name}` | `{row.default}` | {row.text()}{row.range()} |" for row in table)
    return "\n".join(["| parameter | default | meaning |", "|---|---|---|", *rows])
