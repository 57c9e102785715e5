# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""What the controller may be doing, and who may change it."""

from dataclasses import dataclass
from enum import IntEnum
from typing import Literal, get_args

FallbackPolicy = Literal["hold", "ramp", "release"]


class Mode(IntEnum):
    """What the controller is doing; the numbers are those of deepc_msgs/ControllerState."""

    IDLE = 0
    """Waits for a plant."""
    COLLECTING = 1
    """Excites within the input limits until the data describe the plant."""
    CONTROLLING = 2
    """DeePC."""
    HOLDING = 3
    """Samples are missing: holds the input until the recent past is known again."""
    FALLBACK = 4
    """Gave up; latched until an operator resets or acknowledges."""
    SHADOW = 5
    """Computes and reports, moves nothing."""


# What an operator may ask for, from which mode. The controller itself moves between COLLECTING, CONTROLLING and
# HOLDING as the data allow, and from each of them to FALLBACK.
REQUESTS: dict[Mode, frozenset[Mode]] = {
    Mode.COLLECTING: frozenset(Mode) - {Mode.IDLE},  # starts over with an empty window
    Mode.CONTROLLING: frozenset(
        {Mode.HOLDING, Mode.FALLBACK, Mode.SHADOW, Mode.CONTROLLING}
    ),  # acknowledges, takes over
    Mode.FALLBACK: frozenset(Mode) - {Mode.IDLE},
    Mode.SHADOW: frozenset(Mode) - {Mode.IDLE, Mode.FALLBACK},
}


def refusal(now: Mode, wanted: int) -> str:
    """Why a mode cannot be asked for now, in one line; empty if it can."""
    try:
        mode = Mode(wanted)
    except ValueError:
        return f"there is no mode {wanted}"
    allowed = REQUESTS.get(mode)
    if allowed is None:
        return f"{mode.name} is entered by the controller itself, not on request"
    if now not in allowed:
        return f"{mode.name} cannot be entered from {now.name}; from there: {_from(now)}"
    return ""


def _from(now: Mode) -> str:
    return ", ".join(mode.name for mode, allowed in REQUESTS.items() if now in allowed) or "nothing, there is no plant"


@dataclass(frozen=True, slots=True, kw_only=True)
class Safety:
    """When to give up, and what to do then.

    Attributes:
        max_gap: longest run of lost samples that is bridged by holding.
        max_hold: longest time in HOLDING, in samples.
        max_failures: unsolved optimisations in a row before the fallback.
        fallback: "hold" the last input, "ramp" to the safe one, or "release": publish no inputs any more.
        ramp: samples of the ramp.

    Raises:
        ValueError: for a number that cannot work.
    """

    max_gap: int = 5
    max_hold: int = 100
    max_failures: int = 5
    fallback: FallbackPolicy = "hold"
    ramp: int = 20

    def __post_init__(self) -> None:
        for name, least in (("max_gap", 0), ("max_hold", 1), ("max_failures", 1), ("ramp", 1)):
            if getattr(self, name) < least:
                raise ValueError(f"{name} = {getattr(self, name)}: must be at least {least}")
        if self.fallback not in get_args(FallbackPolicy):
            raise ValueError(f"fallback {self.fallback!r}: choose one of {', '.join(get_args(FallbackPolicy))}")
