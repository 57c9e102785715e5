# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Two messages field by field, to the bit."""

import struct
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True, slots=True, kw_only=True)
class Difference:
    """The first field in which what was computed differs from what was recorded.

    Attributes:
        topic: relative topic name.
        epoch, k: of the sample.
        field: dotted path, with an index for array elements, e.g. "values[1]".
        recorded, computed: the two values.
    """

    topic: str
    epoch: int
    k: int
    field: str
    recorded: Any
    computed: Any

    @property
    def by(self) -> float:
        """Absolute difference; NaN if the values are no numbers."""
        try:
            return abs(float(self.computed) - float(self.recorded))
        except (TypeError, ValueError):
            return float("nan")

    def __str__(self) -> str:
        where = f"{self.topic} of epoch {self.epoch} k = {self.k}"
        by = self.by
        amount = "" if np.isnan(by) else f", by {by:.3g}"
        return f"{where}: {self.field} was {self.recorded!r}, is {self.computed!r} now{amount}"


def first_difference(recorded: Any, computed: Any, skip: Collection[str] = ()) -> tuple[str, Any, Any] | None:
    """Compares a decoded message with any object that has the same attributes; floats must agree in every bit.

    Args:
        recorded: namespace, list, array or plain value.
        computed: the same, or a ROS message.
        skip: names of top-level fields to leave out.

    Returns:
        Path and both values of the first difference, or None. NaN equals NaN.
    """
    if hasattr(recorded, "__dict__"):
        for name, value in vars(recorded).items():
            if name not in skip:
                found = first_difference(value, getattr(computed, name, None))
                if found:
                    inner = found[0]
                    path = f"{name}{inner}" if not inner or inner.startswith("[") else f"{name}.{inner}"
                    return path, *found[1:]
        return None
    if isinstance(recorded, np.ndarray | list):
        return _first_element(recorded, computed)
    return None if same(recorded, computed) else ("", _plain(recorded), _plain(computed))


def _first_element(recorded: Any, computed: Any) -> tuple[str, Any, Any] | None:
    if computed is None or len(recorded) != len(computed):
        return "[]", f"{len(recorded)} values", "nothing" if computed is None else f"{len(computed)} values"
    for i, (a, b) in enumerate(zip(recorded, computed, strict=True)):
        found = first_difference(a, b)
        if found:
            return f"[{i}]{'.' if found[0] else ''}{found[0]}", *found[1:]
    return None


def same(a: Any, b: Any) -> bool:
    """Equality to the bit for floats (-0.0 differs from 0.0), any NaN equals any NaN."""
    if isinstance(a, float) and isinstance(b, float):
        return (a != a and b != b) or struct.pack("<d", a) == struct.pack("<d", b)
    return bool(a == b)


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value
