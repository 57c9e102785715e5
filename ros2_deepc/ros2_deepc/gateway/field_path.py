# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Numbers inside messages, by the path of their field."""

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from .errors import GatewayError

_PART = re.compile(r"([a-zA-Z_]\w*)|\[(\d+)\]")


def steps(path: str) -> list[str | int]:
    """The steps of a path: ``a.b[2].c`` is a, b, 2, c."""
    return [name or int(index) for name, index in _PART.findall(path)]


def look_up(message: Any, path: Sequence[str | int]) -> float:
    """The number at a path; NaN if there is none (an array that is too short, a text)."""
    here = message
    for step in path:
        if isinstance(step, str):
            here = getattr(here, step, None)
        else:
            here = here[step] if _is_array(here) and step < len(here) else None
    return float(here) if isinstance(here, (bool, int, float, np.number)) else np.nan


def put(message: Any, path: Sequence[str | int], number: float) -> None:
    """Sets the number at a path; arrays grow with zeros up to it.

    Raises:
        GatewayError: if there is no such field or it is no number.
    """
    holder, last = message, path[-1]
    for step in path[:-1]:
        holder = _into(holder, step, path)
    if isinstance(last, int):
        raise GatewayError("an element has no field of its own")  # put_array is for those
    before = getattr(holder, last, None)
    if not isinstance(before, (bool, int, float)):
        raise GatewayError(f"{_text(path)} is not a number of {type(message).__name__}")
    setattr(holder, last, type(before)(round(number) if isinstance(before, int) else number))


def put_array(message: Any, path: Sequence[str | int], numbers: Sequence[float]) -> None:
    """Sets a whole array of numbers.

    Raises:
        GatewayError: if there is no such field, or it does not take these numbers.
    """
    holder, last = message, path[-1]
    for step in path[:-1]:
        holder = _into(holder, step, path)
    if not isinstance(last, str) or not _is_array(getattr(holder, last, None)):
        raise GatewayError(f"{_text(path)} is not an array of {type(message).__name__}")
    try:
        setattr(holder, last, [float(number) for number in numbers])
    except (AssertionError, TypeError, ValueError):
        raise GatewayError(f"{_text(path)} of {type(message).__name__} does not take {len(numbers)} numbers") from None


def _into(holder: Any, step: str | int, path: Sequence[str | int]) -> Any:
    if isinstance(step, int):
        if _is_array(holder) and step < len(holder):
            return holder[step]
    elif hasattr(holder, step):
        return getattr(holder, step)
    raise GatewayError(f"there is no field {_text(path)}")


def _is_array(value: Any) -> bool:
    return hasattr(value, "__len__") and hasattr(value, "__getitem__") and not isinstance(value, (str, dict))


def _text(path: Sequence[str | int]) -> str:
    text = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in path)
    return text.lstrip(".")
