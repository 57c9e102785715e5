# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Parameters that change while a node works: checked together at once, taken at a sample boundary."""

from collections.abc import Callable
from typing import Any

from rcl_interfaces.msg import SetParametersResult

from .lifecycle import ManagedNode


class LiveParameters:
    """What was asked for and is not in force yet.

    Args:
        node: whose parameters they are; until cleanup.
        check: takes all parameters as they would be, and raises a ValueError with one line if they cannot work.
    """

    def __init__(self, node: ManagedNode, check: Callable[[dict[str, Any]], None]) -> None:
        self._node, self._check = node, check
        self._rows = {row.name: row for row in node.parameters}
        self._wanted: dict[str, Any] = {}
        node.add_on_set_parameters_callback(self._on_change)
        node.resources.callback(node.remove_on_set_parameters_callback, self._on_change)

    def take(self) -> dict[str, Any]:
        """What is to come into force now."""
        wanted, self._wanted = self._wanted, {}
        return wanted

    def _on_change(self, changed: list[Any]) -> SetParametersResult:
        given = {parameter.name: _plain(parameter.value) for parameter in changed if parameter.name in self._rows}
        complaint = next(filter(None, (self._rows[name].complaint(value) for name, value in given.items())), "")
        try:
            if not complaint:
                self._check(self._node.p | self._wanted | given)
        except ValueError as error:
            complaint = str(error)
        if not complaint:
            self._wanted |= given
        return SetParametersResult(successful=not complaint, reason=complaint)


def _plain(value: Any) -> Any:
    return value.tolist() if hasattr(value, "tolist") else value
