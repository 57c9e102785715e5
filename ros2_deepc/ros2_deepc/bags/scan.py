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
from mcap.records import Attachment, Channel, Chunk, Footer, Header, Metadata, Schema
from mcap.stream_reader import CRCValidationError, get_chunk_data_stream
from mcap.summary import Summary

from .errors import why
from .messages import Messages, split

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
_INDEX = frozenset(
    [
        Opcode.FOOTER,
        Opcode.CHUNK_INDEX,
        Opcode.ATTACHMENT_INDEX,
        Opcode.STATISTICS,
        Opcode.METADATA_INDEX,
        Opcode.SUMMARY_OFFSET,
    ]
)
# what the parsers may raise for bytes that make no sense
BROKEN = (
    McapError, CRCValidationError, zstandard.ZstdError, struct.error, ValueError, LookupError, OverflowError,
    MemoryError, EOFError, RuntimeError,
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Damage:
    """Bytes of a file that could not be read: where, how many, and why."""

    offset: int
    size: int
    reason: str

    def __str__(self) -> str:
        return f"{self.size} bytes lost at byte {self.offset}: {self.reason}" if self.size else self.reason


def scan(path: Path) -> Iterator[Any]:
    """Yields the records of a file in file order (of a chunk: its ``Messages``), a Damage for every unreadable stretch.

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
        known = summary.chunk_indexes if summary is not None else []
        yield from _records(file, size, {c.chunk_start_offset: c.chunk_length for c in known})


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


def read_attachments(path: Path) -> Iterator[Attachment]:
    """Yields the attachments of a file that are whole: by its index, or by reading through it if it has none."""
    summary = read_summary(path)
    if summary is None:
        yield from (record for record in scan(path) if isinstance(record, Attachment))
        return
    with path.open("rb") as file:
        for entry in summary.attachment_indexes:
            file.seek(entry.offset + 9)
            found = _record(file, Opcode.ATTACHMENT, entry.offset, entry.length - 9)
            yield from (record for record in found if isinstance(record, Attachment))


def _records(file: BinaryIO, size: int, chunks: dict[int, int]) -> Iterator[Any]:
    at, over = 8, False  # over: the data has ended, the index follows
    while at < size:
        file.seek(at)
        head = file.read(9)
        opcode, length = head[0], int.from_bytes(head[1:], "little")
        fault = _fault(file, head, size - at - 9, over)
        if at in chunks and (fault or (opcode, length) != (Opcode.CHUNK, chunks[at] - 9)):
            yield Damage(at, 9, "the head of a chunk; its content is read by the index")
            opcode, length, fault = Opcode.CHUNK, chunks[at] - 9, ""
        if fault:
            resume = min((c for c in chunks if c > at), default=size)
            yield Damage(at, resume - at, fault)
            at = resume
            if at == size:
                return
            continue
        file.seek(at + 9)
        yield from _record(file, opcode, at, length)
        if opcode == Opcode.FOOTER:
            return
        over = over or opcode == Opcode.DATA_END
        at += 9 + length
    yield Damage(size, 0, "the file was not finished")


def _fault(file: BinaryIO, head: bytes, room: int, over: bool) -> str:
    """Why no record can start with this head; empty if one can."""
    length = int.from_bytes(head[1:], "little")
    if len(head) < 9 or length > room:
        return "the file ends within a record"
    if not 0 < head[0] <= Opcode.DATA_END:
        return f"no record starts here (opcode {head[0]})"
    if head[0] in _INDEX and not over:
        return f"a record of the index before the end of the data (opcode {head[0]})"
    if head[0] == Opcode.MESSAGE_INDEX and int.from_bytes(file.read(6)[2:], "little") != length - 6:
        return "a message index of a wrong length"
    return ""


def _record(file: BinaryIO, opcode: int, at: int, length: int) -> Iterator[Any]:
    if opcode not in (Opcode.CHUNK, Opcode.MESSAGE, *_KEPT):
        return
    body = file.read(length)
    try:
        stream = ReadDataStream(BytesIO(body))
        if opcode == Opcode.CHUNK:
            yield from _chunk(Chunk.read(stream))
        elif opcode == Opcode.MESSAGE:
            yield Messages.found(body, [0], [length])
        else:
            if opcode == Opcode.ATTACHMENT and zlib.crc32(body[:-4]) != int.from_bytes(body[-4:], "little"):
                raise ValueError("wrong checksum")
            yield _KEPT[Opcode(opcode)].read(stream)
    except BROKEN as error:
        yield Damage(at, 9 + length, f"{Opcode(opcode).name.lower()}: {why(error)}")


def _chunk(chunk: Chunk) -> Iterator[Any]:
    data = _opened(chunk)
    others, messages = split(data)
    kinds = {Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel}
    found = [kinds[Opcode(o)].read(ReadDataStream(BytesIO(data[a : a + n]))) for o, a, n in others if o in kinds]
    yield from found  # only after all could be read: of a chunk either everything counts, or nothing
    yield messages


def chunk_messages(body: bytes) -> Messages:
    """The messages of a chunk record, without any of the other records.

    Raises:
        One of BROKEN: if the chunk is damaged.
    """
    return split(_opened(Chunk.read(ReadDataStream(BytesIO(body)))))[1]


def _opened(chunk: Chunk) -> bytes:
    _sane(chunk)
    stream, size = get_chunk_data_stream(chunk, validate_crc=True)
    return bytes(stream.read(size))


def _sane(chunk: Chunk) -> None:
    if chunk.uncompressed_size > 1 << 30:
        raise ValueError(f"a chunk claims {chunk.uncompressed_size} bytes")
