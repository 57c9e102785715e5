# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Reads an MCAP file from the front and survives damage: for files without an index, and for checks."""

import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Footer, Header, Message, Metadata, Schema
from mcap.stream_reader import CRCValidationError, breakup_chunk

from .errors import why

MAGIC = b"\x89MCAP0\r\n"
_KEPT = {
    Opcode.HEADER: Header,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.METADATA: Metadata,
    Opcode.ATTACHMENT: Attachment,
    Opcode.FOOTER: Footer,
}
BROKEN = (
    McapError, CRCValidationError, zstandard.ZstdError, struct.error, ValueError, MemoryError, EOFError, RuntimeError
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Damage:
    """Bytes of a file that could not be read: where, how many, and why."""

    offset: int
    size: int
    reason: str

    def __str__(self) -> str:
        return f"{self.size} bytes lost at byte {self.offset}: {self.reason}"


def scan(path: Path) -> Iterator[Any]:
    """Yields the records of a file in file order (chunks are opened), and a Damage for every unreadable stretch.

    A damaged chunk is skipped; a cut or senseless record ends the file. One chunk is in memory at a time.

    Raises:
        OSError: if the file cannot be read at all.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        if file.read(8) != MAGIC:
            yield Damage(0, size, "not an MCAP file")
            return
        yield from _records(file, size)


def _records(file: BinaryIO, size: int) -> Iterator[Any]:
    at = 8
    while at < size:
        head = file.read(9)
        length = int.from_bytes(head[1:], "little")
        if len(head) < 9 or at + 9 + length > size:
            yield Damage(at, size - at, "the file ends within a record")
            return
        opcode = head[0]
        if not 0 < opcode <= Opcode.DATA_END:
            yield Damage(at, size - at, f"no record starts here (opcode {opcode})")
            return
        yield from _record(file, opcode, at, length)
        if opcode == Opcode.FOOTER:
            return
        at += 9 + length
    yield Damage(size, 0, "the file was not finished")


def _record(file: BinaryIO, opcode: int, at: int, length: int) -> Iterator[Any]:
    if opcode != Opcode.CHUNK and opcode != Opcode.MESSAGE and opcode not in _KEPT:
        file.seek(length, os.SEEK_CUR)
        return
    body = file.read(length)
    try:
        stream = ReadDataStream(BytesIO(body))
        if opcode == Opcode.CHUNK:
            yield from _chunk(Chunk.read(stream))
        elif opcode == Opcode.MESSAGE:
            yield Message.read(stream, length)
        else:
            yield _KEPT[Opcode(opcode)].read(stream)
    except BROKEN as error:
        yield Damage(at, 9 + length, f"{Opcode(opcode).name.lower()}: {why(error)}")


def _chunk(chunk: Chunk) -> list[Any]:
    if chunk.uncompressed_size > 1 << 30:
        raise ValueError(f"claims {chunk.uncompressed_size} bytes")
    return breakup_chunk(chunk, validate_crc=True)
