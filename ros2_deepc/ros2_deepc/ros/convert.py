# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Between messages and arrays."""

import math

import numpy as np
from builtin_interfaces.msg import Time
from deepc_msgs.msg import Sample
from numpy.typing import NDArray

NANOSECONDS = 1_000_000_000


def stamp(nanoseconds: int) -> Time:
    """A ROS time stamp from integer nanoseconds."""
    sec, nanosec = divmod(nanoseconds, NANOSECONDS)
    return Time(sec=sec, nanosec=nanosec)


def nanoseconds(time: Time) -> int:
    """Integer nanoseconds of a ROS time stamp."""
    return int(time.sec) * NANOSECONDS + int(time.nanosec)


def period_ns(sample_time: float) -> int:
    """A sample time [s] in whole nanoseconds."""
    return round(sample_time * NANOSECONDS)


def sample(
    frame: str, epoch: int, k: int, values: NDArray[np.float64], time_ns: int, held: int = 0, sender: int = 0
) -> Sample:
    """A Sample message; the float64 bits of ``values`` are kept."""
    msg = Sample(epoch=epoch, k=k, held=held, sender=sender)
    msg.header.frame_id = frame
    msg.header.stamp = stamp(time_ns)
    msg.values = np.ascontiguousarray(values, dtype=np.float64).ravel().tolist()
    return msg


def refusal(msg: Sample, size: int) -> str:
    """Why the values of a sample, or of a `wire.Reading` of one, cannot be used, in one line; empty if they can."""
    if len(msg.values) != size:
        return f"{len(msg.values)} values where {size} are expected"
    for i, value in enumerate(msg.values):
        if not math.isfinite(value):
            return f"values[{i}] is {value}"
    if len(msg.quality) not in (0, size):
        return f"{len(msg.quality)} quality flags for {size} values"
    for i, flag in enumerate(msg.quality):
        if flag != Sample.GOOD:
            return f"quality[{i}] is {flag}, not GOOD"
    return ""
