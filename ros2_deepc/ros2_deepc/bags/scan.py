# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Reads an MCAP file from the front and survives damage: for files without an index, and for checks."""

import os
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Attachment, Channel, Chunk, Footer, Header, Message, Metadata, Schema
from mcap.stream_reader import CRCValidationError, breakup_chunk
from mcap.summary import Summary

from .errors import why

MAGIC = b"\x89MCAP0\r\n"
_TAIL = 1 + 8 + 20 + 8  # the footer record and the magic behind it
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

    A damaged chunk is skipped. Where no record starts, reading goes on at the next chunk that the index knows; without
    an index the file ends there. Schemas and channels that the index repeats come first. One chunk is in memory at a
    time.

    Raises:
        OSError: if the file cannot be read at all.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        if file.read(8) != MAGIC:
            yield Damage(0, size, "not an MCAP file")
            return
        summary = read_summary(path)
        if summary is not None:
            yield from summary.schemas.values()
            yield from summary.channels.values()
        chunks = sorted(c.chunk_start_offset for c in summary.chunk_indexes) if summary is not None else []
        yield from _records(file, size, chunks)


def read_summary(path: Path) -> Summary | None:
    """The index at the end of a file; None if there is none, or its checksum is wrong."""
    try:
        with path.open("rb") as stream:
            end = stream.seek(-_TAIL, os.SEEK_END)
            tail = stream.read()
            start, expected = struct.unpack_from("<Q8xI", tail, 9)
            if not tail.endswith(MAGIC) or not 8 <= start < end:
                return None
            stream.seek(start)
            if expected and zlib.crc32(stream.read(end - start) + tail[: _TAIL - 12]) != expected:
                return None
            stream.seek(0)
            return SeekingReader(stream).get_summary()
    except (*BROKEN, OSError):
        return None


def _records(file: BinaryIO, size: int, chunks: list[int]) -> Iterator[Any]:
    at = 8
    while at < size:
        file.seek(at)
        head = file.read(9)
        length = int.from_bytes(head[1:], "little")
        fault = ""
        if len(head) < 9 or at + 9 + length > size:
            fault = "the file ends within a record"
        elif not 0 < head[0] <= Opcode.DATA_END:
            fault = f"no record starts here (opcode {head[0]})"
        if fault:
            resume = next((c for c in chunks if c > at), size)
            yield Damage(at, resume - at, fault)
            if resume == size:
                return
            at = resume
            continue
        yield from _record(file, head[0], at, length)
        if head[0] == Opcode.FOOTER:
            return
        at += 9 + length
    yield Damage(size, 0, "the file was not finished")


def _record(file: BinaryIO, opcode: int, at: int, length: int) -> Iterator[Any]:
    if opcode not in (Opcode.CHUNK, Opcode.MESSAGE, *_KEPT):
        return
    body = file.read(length)
    try:
        stream = ReadDataStream(BytesIO(body))
        if opcode == Opcode.CHUNK:
            yield from _chunk(Chunk.read(stream))
        elif opcode == Opcode.MESSAGE:
            yield Message.read(stream, length)
        else:
            if opcode == Opcode.ATTACHMENT and zlib.crc32(body[:-4]) != int.from_bytes(body[-4:], "little"):
                raise ValueError("wrong checksum")
            yield _KEPT[Opcode(opcode)].read(stream)
    except BROKEN as error:
        yield Damage(at, 9 + length, f"{Opcode(opcode).name.lower()}: {why(error)}")


def _chunk(chunk: Chunk) -> list[Any]:
    if chunk.uncompressed_size > 1 << 30:
        raise ValueError(f"claims {chunk.uncompressed_size} bytes")
    return breakup_chunk(chunk, validate_crc=True)
