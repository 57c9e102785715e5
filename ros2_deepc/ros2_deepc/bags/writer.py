# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Writes a rosbag2-style folder: MCAP files plus metadata.yaml."""

import os
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self

from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import CompressionType, Writer

from .errors import BagError, why
from .layout import MARKER, METADATA, FileRecord, TopicRecord, bag_information, to_yaml
from .schema import message_definition
from .schema import type_hash as installed_hash

_COMPRESSION = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4, "none": CompressionType.NONE}
RUN_METADATA = "ros2_deepc"  # name of the MCAP metadata record that holds the caller's metadata


class BagWriter:
    """Records serialized messages into a folder that ``ros2 bag``, Foxglove and PlotJuggler open.

    Memory stays bounded by the chunk size and the index of one file, about 1 kB a chunk, which MCAP keeps until the
    file is finished. A kill loses what came after the last flush, one second at most; until a clean close the folder
    holds a file ``INCOMPLETE`` and no metadata.yaml. Not thread-safe.

    Args:
        folder: the bag's folder, created here; an existing one must be empty.
        name: stem of the files ``<name>_0.mcap``, default the folder's name.
        compression: of the chunks: "zstd", "lz4" or "none".
        chunk_size: bytes of messages per chunk.
        metadata: text by name (parameters, seed, versions): kept in every file and in metadata.yaml.
        ros_distro: written into metadata.yaml.
        max_bytes: start a new file once this many bytes are written; 0 = never.
        max_duration: start a new file after this much log time [s]; 0 = never.
        max_chunks: start a new file after so many chunks: by default after an hour, where one a second is flushed.
        flush_period: longest time [s] that a message stays in memory while others arrive.

    Raises:
        BagError: if the folder cannot be made or is not empty.
    """

    def __init__(
        self,
        folder: str | os.PathLike[str],
        name: str | None = None,
        *,
        compression: str = "zstd",
        chunk_size: int = 256 * 1024,
        metadata: Mapping[str, str] | None = None,
        ros_distro: str = "kilted",
        max_bytes: int = 0,
        max_duration: float = 0.0,
        max_chunks: int = 3600,
        flush_period: float = 1.0,
    ) -> None:
        if compression not in _COMPRESSION:
            raise BagError(f"unknown compression {compression!r}: one of {', '.join(_COMPRESSION)}")
        self.folder = Path(folder)
        self._name = name or self.folder.resolve().name
        self._compression, self._chunk_size = _COMPRESSION[compression], chunk_size
        self._metadata, self._ros_distro = dict(metadata or {}), ros_distro
        self._max_bytes, self._max_duration = max_bytes, round(max_duration * 1e9)
        self._max_chunks, self._flushes, self._bytes = max_chunks, 0, 0  # the latter two: of the file that is open
        self._flush_period, self._flushed = flush_period, time.monotonic()
        self._count, self._safe = 0, 0  # messages written, and those of them that were flushed
        self._topics: dict[str, TopicRecord] = {}
        self._definitions: dict[str, str] = {}
        self._files: list[FileRecord] = []
        self._channels: dict[str, int] = {}
        self._failure = ""
        self._closed = False
        try:
            _make_folder(self.folder)
            (self.folder / MARKER).write_text("This bag is being recorded, or its recorder was killed.\n", "utf-8")
            self._open_file()
        except OSError as error:
            raise BagError(f"cannot record into {self.folder}: {why(error)}") from error

    @property
    def message_count(self) -> int:
        """Messages written so far."""
        return self._count

    def add_topic(
        self,
        name: str,
        type: str,
        qos: Iterable[Mapping[str, Any]] = (),
        type_hash: str | None = None,
        definition: str | None = None,
    ) -> None:
        """Registers a topic before its first message; a second call for the same topic must name the same type.

        Args:
            name: full topic name.
            type: full type name, e.g. ``deepc_msgs/msg/Sample``.
            qos: offered profiles, see ``qos_entry``.
            type_hash: RIHS01 hash of the type as its publisher states it; default: that of the installed message.
            definition: message definition text; default: read from the installed messages.

        Raises:
            BagError: if the type is unknown or differs from an earlier registration.
        """
        self._check_open()
        if name in self._topics:
            if self._topics[name].type != type:
                raise BagError(f"topic {name} is {self._topics[name].type} in this bag, not {type}")
            return
        if type not in self._definitions:
            self._definitions[type] = message_definition(type) if definition is None else definition
        known_hash = installed_hash(type) if type_hash is None else type_hash
        self._topics[name] = TopicRecord(name, type, [dict(q) for q in qos], known_hash)
        self._register(self._topics[name])

    def write(self, topic: str, data: bytes, log_time: int, publish_time: int | None = None) -> None:
        """Appends one serialized message (CDR, with its 4-byte header); times in ns.

        Raises:
            BagError: if the topic is not registered, or the disk refuses; after the latter every call fails at once.
        """
        self._check_open()
        if topic not in self._topics:
            raise BagError(f"topic {topic} is not in this bag: call add_topic first")
        self._roll_if_due(log_time)
        record, entry = self._topics[topic], self._files[-1]
        entry.add(topic, log_time)
        record.count += 1
        self._count += 1
        self._bytes += len(data)
        with self._disk():
            self._mcap.add_message(
                self._channels[topic],
                log_time=log_time,
                data=data,
                publish_time=log_time if publish_time is None else publish_time,
                sequence=record.count & 0xFFFFFFFF,
            )
        self.flush_if_due()

    def attach(self, name: str, media_type: str, data: bytes, time_ns: int = 0) -> None:
        """Attaches a file, e.g. the configuration; ``time_ns`` is stored as its creation and log time."""
        self._check_open()
        with self._disk():
            self._mcap.add_attachment(time_ns, time_ns, name, media_type, data)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Adds a named record of text values to the current file."""
        self._check_open()
        with self._disk():
            self._mcap.add_metadata(name, dict(values))

    def flush_if_due(self) -> None:
        """Flushes if the last flush was longer ago than the flush period and something came since."""
        if time.monotonic() - self._flushed > self._flush_period and self._count > self._safe:
            self.flush()

    def flush(self) -> None:
        """Hands everything so far to the operating system: a kill of this process loses nothing before this call."""
        self._check_open()
        self._flushed, self._safe = time.monotonic(), self._count
        self._flushes += 1
        with self._disk():
            self._mcap.flush()

    def close(self) -> None:
        """Finishes the files, writes metadata.yaml and removes the marker; a second call does nothing.

        Raises:
            BagError: if the disk refuses; the bag then stays marked, and readable up to the last whole chunk.
        """
        if self._closed:
            return
        self._closed = True
        try:
            if not self._failure:
                self._finish()
        finally:
            with suppress(OSError):  # what is still buffered after a failure cannot be written either
                self._file.close()

    def _finish(self) -> None:
        with self._disk():
            self._finish_file()
            information = bag_information(self._files, list(self._topics.values()), self._metadata, self._ros_distro)
            text = to_yaml({"rosbag2_bagfile_information": information})
            (self.folder / METADATA).write_text(text, encoding="utf-8")
            (self.folder / MARKER).unlink()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _check_open(self) -> None:
        if self._failure:
            raise BagError(self._failure)
        if self._closed:
            raise BagError(f"bag {self.folder} is closed")

    @contextmanager
    def _disk(self) -> Iterator[None]:
        """Turns a system error into one BagError and remembers it: a half-written file must not grow further."""
        try:
            yield
        except OSError as error:
            self._failure = f"recording into {self.folder} stopped: {why(error)}"
            raise BagError(self._failure) from error

    def _open_file(self) -> None:
        path = self.folder / f"{self._name}_{len(self._files)}.mcap"
        self._file: BinaryIO = open(path, "xb")  # noqa: SIM115 - closed in _finish_file
        self._mcap = Writer(self._file, chunk_size=self._chunk_size, compression=self._compression)
        self._mcap.start(profile="ros2", library="ros2_deepc")
        if self._metadata:
            self._mcap.add_metadata(RUN_METADATA, self._metadata)
        self._files.append(FileRecord(path.name))
        self._flushes = self._bytes = 0
        self._schemas: dict[str, int] = {}
        self._channels.clear()
        for topic in self._topics.values():
            self._register(topic)

    def _register(self, topic: TopicRecord) -> None:
        if topic.type not in self._schemas:
            data = self._definitions[topic.type].encode()
            self._schemas[topic.type] = self._mcap.register_schema(topic.type, SchemaEncoding.ROS2, data)
        metadata = {"offered_qos_profiles": to_yaml(topic.qos), "topic_type_hash": topic.type_hash}
        self._channels[topic.name] = self._mcap.register_channel(
            topic.name, MessageEncoding.CDR, self._schemas[topic.type], metadata
        )

    def _roll_if_due(self, log_time: int) -> None:
        entry = self._files[-1]
        full = self._max_bytes and self._file.tell() >= self._max_bytes
        late = self._max_duration and log_time - entry.start >= self._max_duration
        many = self._flushes + self._bytes // self._chunk_size >= self._max_chunks  # each of them ends a chunk at most
        if entry.count and (full or late or many):
            with self._disk():
                self._finish_file()
                self._open_file()

    def _finish_file(self) -> None:
        entry = self._files[-1]
        information = bag_information(
            [entry], list(self._topics.values()), self._metadata, self._ros_distro, entry.topics
        )
        self._mcap.flush()
        self._mcap.add_metadata("rosbag2", {"serialized_metadata": to_yaml(information)})
        self._mcap.finish()
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.close()


def _make_folder(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    if any(folder.iterdir()):
        raise FileExistsError(17, "the folder is not empty; choose another name")
