# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Samples as they go over the wire, without the detour over message objects.

The Python layer of rosidl needs 10 to 25 us to build and convert a Sample, or to take one, two to three times that
after an idle period, and a loop pays for it four times a sample. The bytes are plain: CDR, each number aligned to its
own size, sequences and strings with their length before them. What is written here is what `serialize_message` writes,
but for the padding: zeros here, whatever was in memory there.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from struct import Struct, error

import numpy as np
from deepc_msgs.msg import Sample
from numpy.typing import NDArray
from rclpy.serialization import deserialize_message
from std_msgs.msg import Header

from .convert import NANOSECONDS, nanoseconds, stamp

_LITTLE = b"\x00\x01\x00\x00"  # CDR, little endian: what every machine here writes
_LENGTH = Struct("<I")
_FRAME = 12  # place of frame_id, after the stamp and its own length


class Reading:
    """What a Sample message says; the fields of `deepc_msgs/Sample`, without its constants.

    Attributes:
        time_ns: stamp of the header [ns].
        frame: its frame_id.
        values: tuple of float, the bits that were sent.
    """

    __slots__ = ("epoch", "frame", "held", "k", "quality", "sender", "time_ns", "values")

    def __init__(
        self,
        time_ns: int,
        frame: str,
        epoch: int,
        k: int,
        values: Sequence[float],
        quality: Sequence[int],
        sender: int,
        held: int,
    ) -> None:
        self.time_ns, self.frame, self.epoch, self.k = time_ns, frame, epoch, k
        self.values, self.quality, self.sender, self.held = values, quality, sender, held

    @property
    def header(self) -> Header:
        """The header as a message of its own."""
        return Header(frame_id=self.frame, stamp=stamp(self.time_ns))


def _aligned(at: int, size: int) -> int:
    return at + -at % size


@lru_cache(maxsize=256)
def _layout(frame: int, values: int, quality: int) -> Struct:
    """Of a Sample with these lengths, frame_id with its closing zero; the numbers stand where CDR aligns them."""
    code, at = f"<4xiII{frame}s", _FRAME + frame  # counted from behind the 4 bytes of CDR's own
    fields = [("I", 4, 1), ("Q", 8, 1), ("I", 4, 1), ("d", 8, values), ("I", 4, 1), ("s", 1, quality), ("Q", 8, 1)]
    for kind, size, count in [*fields, ("I", 4, 1)]:
        start = _aligned(at, size) if count else at
        code += f"{start - at}x{count}{kind}"
        at = start + size * count
    return Struct(code)


def pack(
    frame: str, epoch: int, k: int, values: NDArray[np.float64], time_ns: int, held: int = 0, sender: int = 0
) -> bytes:
    """The bytes of `convert.sample` with the same arguments."""
    sec, nanosec = divmod(time_ns, NANOSECONDS)
    name, numbers = frame.encode() + b"\0", np.asarray(values, np.float64).ravel().tolist()
    layout = _layout(len(name), len(numbers), 0)
    data = layout.pack(sec, nanosec, len(name), name, epoch, k, len(numbers), *numbers, 0, b"", sender, held)
    return _LITTLE + data[4:]


def unpack(data: bytes) -> Reading:
    """Reads the bytes of a Sample; of bytes that are none, a sample without values.

    Such a sample has the wrong size for everybody, and is refused and counted like any other one.
    """
    try:
        if data[:2] == _LITTLE[:2]:
            return _unpack(data)
        msg = deserialize_message(data, Sample)
    except (error, IndexError, UnicodeDecodeError, RuntimeError):  # RCLError is a RuntimeError
        return Reading(0, "", 0, 0, (), (), 0, 0)
    at = nanoseconds(msg.header.stamp)
    return Reading(
        at, msg.header.frame_id, msg.epoch, msg.k, tuple(msg.values), tuple(msg.quality), msg.sender, msg.held
    )


def _unpack(data: bytes) -> Reading:
    frame = _length(data, 8)
    place = _aligned(_aligned(_FRAME + frame, 4) + 4, 8) + 8
    values = _length(data, place)
    place = (_aligned(place + 4, 8) if values else place + 4) + 8 * values
    quality = _length(data, place)
    if place + quality > len(data):
        raise error("lengths beyond the end")
    sec, nanosec, _, name, epoch, k, _, *rest = _layout(frame, values, quality).unpack_from(data)
    _, flags, sender, held = rest[values:]
    numbers = tuple(rest[:values])
    return Reading(sec * NANOSECONDS + nanosec, name[:-1].decode(), epoch, k, numbers, flags, sender, held)


def _length(data: bytes, place: int) -> int:
    return int(_LENGTH.unpack_from(data, 4 + place)[0])


def reading(callback: Callable[[Reading], None]) -> Callable[[bytes], None]:
    """A callback for a raw subscription of Samples."""
    return lambda data: callback(unpack(data))
