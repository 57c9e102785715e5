# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Many messages in one buffer: what a chunk of a bag holds, without an object for each."""

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

_HEAD = struct.Struct("<BQ").unpack_from
_HEADER = np.dtype([("channel", "<u2"), ("sequence", "<u4"), ("log_time", "<u8"), ("publish_time", "<u8")])  # packed


@dataclass(frozen=True, slots=True, eq=False)
class Messages:
    """Serialized messages, one a row.

    Attributes:
        data: the buffer.
        start, size: where each message's bytes are in it, shape (n,).
        channel: id of its channel, shape (n,).
        log_time, publish_time: [ns], shape (n,), unsigned.
    """

    data: bytes
    start: NDArray[np.int64]
    size: NDArray[np.int64]
    channel: NDArray[np.uint16]
    log_time: NDArray[np.uint64]
    publish_time: NDArray[np.uint64]

    def __len__(self) -> int:
        return len(self.start)

    def __iter__(self) -> Iterator[tuple[int, int, int, bytes]]:
        """Yields channel, log time, publish time and bytes of each message."""
        columns = (self.channel, self.log_time, self.publish_time, self.start, self.start + self.size)
        for channel, log_time, publish_time, a, b in zip(*(c.tolist() for c in columns), strict=True):
            yield channel, log_time, publish_time, self.data[a:b]

    @property
    def last(self) -> bytes:
        """Bytes of the last message; empty if there is none."""
        return self.data[self.start[-1] : self.start[-1] + self.size[-1]] if len(self) else b""

    def rows(self, which: NDArray[Any]) -> Self:
        """Some of the messages: indices or a mask."""
        columns = (self.start, self.size, self.channel, self.log_time, self.publish_time)
        return type(self)(self.data, *(column[which] for column in columns))

    def in_order(self) -> Self:
        """The messages in the order of log time; those of the same time stay as they are."""
        if (self.log_time[1:] >= self.log_time[:-1]).all():
            return self
        return self.rows(np.argsort(self.log_time, kind="stable"))

    @classmethod
    def found(cls, data: bytes, at: Sequence[int], size: Sequence[int]) -> Self:
        """From message records in a buffer.

        Args:
            data: the buffer.
            at: where the content of each record starts, behind its opcode and length.
            size: length of that content.

        Raises:
            ValueError: if a record is too short for a message.
        """
        places, sizes = np.array(at, dtype=np.int64), np.array(size, dtype=np.int64)
        if len(sizes) and sizes.min() < _HEADER.itemsize:
            raise ValueError(f"a message record of {sizes.min()} bytes")
        head = np.frombuffer(data, np.uint8)[places[:, None] + np.arange(_HEADER.itemsize)].view(_HEADER).reshape(-1)
        columns = (head[name].copy() for name in ("channel", "log_time", "publish_time"))
        return cls(data, places + _HEADER.itemsize, sizes - _HEADER.itemsize, *columns)

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """All messages of several buffers."""
        if len(parts) == 1:
            return parts[0]
        offsets = np.cumsum([0, *(len(part.data) for part in parts)])
        start = np.concatenate([part.start + offset for part, offset in zip(parts, offsets, strict=False)])
        names = ("size", "channel", "log_time", "publish_time")
        columns = (np.concatenate([getattr(part, name) for part in parts]) for name in names)
        return cls(b"".join(part.data for part in parts), start, *columns)


def split(data: bytes) -> tuple[list[tuple[int, int, int]], Messages]:
    """The records of an opened chunk: (opcode, start of the content, length) of all others, and the messages.

    Raises:
        ValueError or struct.error: if the records do not fill the chunk.
    """
    others, starts, sizes = [], [], []
    at, end, message = 0, len(data), int(Opcode.MESSAGE)
    while at < end:
        opcode, length = _HEAD(data, at)
        at += 9
        if opcode == message:
            starts.append(at)
            sizes.append(length)
        else:
            others.append((opcode, at, length))
        at += length
    if at != end:
        raise ValueError("a record runs over the end of its chunk")
    return others, Messages.found(data, starts, sizes)
