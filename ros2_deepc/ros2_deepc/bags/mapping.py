# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Bags that others recorded: any number in any message becomes a channel of (u, y) data."""

import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import BagError
from .reader import BagReader

Array = NDArray[np.float64]
_STEP = re.compile(r"([A-Za-z_]\w*)|\[(-?\d+)\]")


@dataclass(frozen=True, slots=True)
class Channel:
    """One number of one topic over time.

    Attributes:
        topic: full topic name.
        path: field path within the message, e.g. "data[2]" or "pose.position.x"; "" means "data", as in std_msgs.
    """

    topic: str
    path: str = ""

    @classmethod
    def parse(cls, text: str) -> "Channel":
        """From "/topic", "/topic:field" or "/topic:field[2].x".

        Raises:
            BagError: if the text is none of these.
        """
        topic, _, path = text.partition(":")
        if not topic.startswith("/") or (path and "".join(m[0] for m in _STEP.finditer(path)) != path.replace(".", "")):
            raise BagError(f"channel {text!r}: write /topic, /topic:field or /topic:field[2].x")
        return cls(topic, path)

    def reader(self) -> Callable[[Any], float]:
        """Function from a decoded message to the number."""
        steps = [m[1] or int(m[2]) for m in _STEP.finditer(self.path or "data")]

        def read(message: Any) -> float:
            value = message
            for step in steps:
                value = value[step] if isinstance(step, int) else getattr(value, step)
            return float(value)

        return read


@dataclass(frozen=True, slots=True, kw_only=True)
class Signals:
    """Channels on one common clock.

    Attributes:
        t: sampling instants, shape (K,) [s] since the first.
        u: inputs, shape (K, m).
        y: outputs, shape (K, p).
        sample_time: [s].
        age: shape (K, m+p) [s], how old each value was at its instant.
    """

    t: Array
    u: Array
    y: Array
    sample_time: float
    age: Array


def load_signals(
    bag: str | os.PathLike[str] | BagReader,
    inputs: Sequence[str | Channel],
    outputs: Sequence[str | Channel],
    *,
    sample_time: float | None = None,
    phase: float = 0.0,
    stamps: str = "log",
) -> Signals:
    """Samples channels of any bag on a regular clock; each value is the newest one at that instant.

    The clock starts when every channel has a value. Rows in which a channel is older than it should be can be told by
    ``age``: cut the record there.

    Args:
        bag: folder, file or open reader.
        inputs: channels of u, see ``Channel.parse``.
        outputs: channels of y.
        sample_time: [s]; default: the median period of the first output.
        phase: how long after the first complete set the clock starts [s]; choose it larger than the jitter, so that all
            values of one period are in when they are sampled.
        stamps: "log" (when it was recorded), "publish" (when it was sent) or "header" (the message's own stamp).

    Raises:
        BagError: for a topic or field that is not there, a value that is not a number, an unknown clock.
    """
    reader = bag if isinstance(bag, BagReader) else BagReader(bag)
    channels = [c if isinstance(c, Channel) else Channel.parse(c) for c in (*inputs, *outputs)]
    if not inputs or not outputs:
        raise BagError("give at least one input and one output channel")
    if stamps not in ("log", "publish", "header"):
        raise BagError(f"clock {stamps!r}: one of log, publish, header")
    times, values = _collect(reader, channels, stamps)
    period = sample_time or _period(times[len(inputs)], channels[len(inputs)])
    first = max(t[0] for t in times) + round(phase * 1e9)
    last = max(times[len(inputs)][-1], first)
    grid = first + np.round(np.arange((last - first) // (period * 1e9) + 1) * period * 1e9).astype(np.int64)
    columns, ages = [], []
    for t, v in zip(times, values, strict=True):
        rows = np.searchsorted(t, grid, side="right") - 1
        columns.append(v[rows])
        ages.append(1e-9 * (grid - t[rows]))
    w = np.stack(columns, axis=1)
    m = len(inputs)
    return Signals(
        t=1e-9 * (grid - grid[0]), u=w[:, :m], y=w[:, m:], sample_time=float(period), age=np.stack(ages, axis=1)
    )


def _collect(reader: BagReader, channels: list[Channel], stamps: str) -> tuple[list[NDArray[np.int64]], list[Array]]:
    """Times [ns], in order, and values of each channel."""
    by_topic: dict[str, list[int]] = {}
    for i, channel in enumerate(channels):
        if channel.topic not in reader.topics:
            raise BagError(f"bag {reader.path} has no topic {channel.topic}; it has {', '.join(sorted(reader.topics))}")
        by_topic.setdefault(channel.topic, []).append(i)
    readers = [c.reader() for c in channels]
    times: list[list[int]] = [[] for _ in channels]
    values: list[list[float]] = [[] for _ in channels]
    for raw, message in reader.decoded(list(by_topic)):
        time = _stamp(message, raw.topic) if stamps == "header" else raw.log_time
        time = raw.publish_time if stamps == "publish" else time
        for i in by_topic[raw.topic]:
            times[i].append(time)
            values[i].append(_number(readers[i], message, channels[i]))
    out_t, out_v = [], []
    for channel, t, v in zip(channels, times, values, strict=True):
        if not t:
            raise BagError(f"topic {channel.topic} has no messages")
        order = np.argsort(np.array(t), kind="stable")
        out_t.append(np.array(t, dtype=np.int64)[order])
        out_v.append(np.array(v, dtype=np.float64)[order])
    return out_t, out_v


def _number(read: Callable[[Any], float], message: Any, channel: Channel) -> float:
    try:
        return read(message)
    except (AttributeError, IndexError, TypeError, ValueError) as error:
        what = f"there is no field {error.name}" if isinstance(error, AttributeError) else str(error)
        raise BagError(
            f"{channel.topic}:{channel.path or 'data'} is no number: {what}; the message has {', '.join(vars(message))}"
        ) from error


def _stamp(message: Any, topic: str) -> int:
    try:
        return int(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)
    except AttributeError:
        raise BagError(f"messages on {topic} have no header: use the log or publish clock") from None


def _period(times: NDArray[np.int64], channel: Channel) -> float:
    steps = np.diff(times)
    if not len(steps) or np.median(steps) <= 0:
        raise BagError(f"cannot tell the period of {channel.topic}: give a sample time")
    return float(np.median(steps)) * 1e-9
