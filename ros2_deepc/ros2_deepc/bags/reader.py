# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Reads bags: a rosbag2-style folder or a single .mcap file, finished or not, lazily and in bounded memory."""

import os
import re
from bisect import bisect_left
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple, Self

import yaml
from mcap.reader import SeekingReader
from mcap.records import Attachment, Channel, ChunkIndex, Message, Metadata, Schema

from .decode import Decoder, decoder
from .errors import BagError, why
from .layout import MARKER, METADATA
from .scan import BROKEN, Damage, chunk_messages, read_attachments, read_summary, scan


class RawMessage(NamedTuple):
    """One message as it was on the wire; times in ns."""

    topic: str
    type: str
    log_time: int
    publish_time: int
    data: bytes


@dataclass(slots=True)
class TopicInfo:
    """A topic of a bag: its type, definition text, number of messages, offered QoS (YAML text) and type hash."""

    name: str
    type: str
    definition: str
    count: int = 0
    qos: str = ""
    type_hash: str = ""
    encoding: str = "cdr"
    schema_encoding: str = "ros2msg"

    @classmethod
    def of(cls, channel: Channel, schema: Schema | None) -> Self:
        """From the records of a file."""
        return cls(
            channel.topic,
            schema.name if schema else "",
            schema.data.decode("utf-8", "replace") if schema else "",
            qos=channel.metadata.get("offered_qos_profiles", ""),
            type_hash=channel.metadata.get("topic_type_hash", ""),
            encoding=channel.message_encoding,
            schema_encoding=schema.encoding if schema else "",
        )

    def decoder(self) -> Decoder:
        """Function from this topic's bytes to a namespace with the message's fields.

        Raises:
            BagError: if messages or definition are in another encoding than CDR and ros2msg.
        """
        if self.encoding != "cdr" or self.schema_encoding != "ros2msg":
            have = f"{self.encoding} with a {self.schema_encoding or 'missing'} definition"
            raise BagError(f"topic {self.name} is {have}: only cdr with ros2msg can be decoded")
        return decoder(self.type, self.definition)


class BagReader:
    """What is in a bag.

    Args:
        path: the bag's folder, or one .mcap file.

    Attributes:
        files: the MCAP files, in order.
        topics: by name.
        start, end: smallest and largest log time [ns]; 0 for an empty bag.
        metadata: text by name, for every named MCAP metadata record (the last one of a name counts).
        complete: the recorder closed the bag, and every file has its index.
        losses: what could not be read, one line each; always empty for a complete bag.

    Raises:
        BagError: if there is no bag, or nothing readable in it.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self.files = bag_files(self.path)
        self.topics: dict[str, TopicInfo] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        self.start, self.end, self._timed = 0, 0, False
        self.complete = not (self.path.is_dir() and (self.path / MARKER).exists())
        self.losses: list[str] = []
        self._indexed: dict[Path, bool] = {}
        for file in self.files:
            try:
                self._indexed[file] = self._read_index(file) or self._read_through(file)
            except (OSError, *BROKEN) as error:
                raise BagError(f"cannot read {file}: {why(error)}") from error

    @property
    def message_count(self) -> int:
        """Messages in all topics."""
        return sum(t.count for t in self.topics.values())

    def messages(
        self, topics: Iterable[str] | None = None, start: int | None = None, end: int | None = None
    ) -> Iterator[RawMessage]:
        """Yields messages, within a finished file in the order of log time, else in the order they were written.

        Args:
            topics: only these; default all.
            start: smallest log time [ns], inclusive.
            end: largest log time [ns], exclusive.

        Raises:
            BagError: if a file that has its index is damaged inside.
        """
        wanted = None if topics is None else set(topics)
        for file in self.files:
            source = _from_index(file, wanted, start, end) if self._indexed[file] else _from_front(file)
            for message in source:
                if wanted is not None and message.topic not in wanted:
                    continue
                if (start is None or message.log_time >= start) and (end is None or message.log_time < end):
                    yield message

    def decoded(self, topics: Iterable[str] | None = None) -> Iterator[tuple[RawMessage, Any]]:
        """Yields each message with its decoded form, see ``ros2_deepc.bags.decode``."""
        decoders: dict[str, Decoder] = {}
        for raw in self.messages(topics):
            if raw.topic not in decoders:
                decoders[raw.topic] = self.topics[raw.topic].decoder()
            yield raw, decoders[raw.topic](raw.data)

    def attachments(self) -> Iterator[Attachment]:
        """Yields attachments whose checksum is right: ``.name``, ``.media_type``, ``.data``."""
        for file in self.files:
            yield from read_attachments(file)

    def _read_index(self, file: Path) -> bool:
        """Fills in what the summary at the end of the file says; False if there is none."""
        summary = read_summary(file)
        if summary is None or summary.statistics is None or not summary.chunk_indexes:
            return False
        try:
            with file.open("rb") as stream:
                for record in SeekingReader(stream).iter_metadata():
                    self.metadata[record.name] = record.metadata
        except BROKEN as error:
            self.complete = False
            self.losses.append(f"{file.name}: metadata lost: {why(error)}")
        for channel in summary.channels.values():
            count = summary.statistics.channel_message_counts.get(channel.id, 0)
            self._add_topic(channel, summary.schemas.get(channel.schema_id)).count += count
        if summary.statistics.message_count:
            self._add_time(summary.statistics.message_start_time, summary.statistics.message_end_time)
        return True

    def _read_through(self, file: Path) -> bool:
        """Fills in the same by reading the whole file; always False: this file has no usable index."""
        schemas: dict[int, Schema] = {}
        channels: dict[int, TopicInfo] = {}
        orphans = 0
        for record in scan(file):
            match record:
                case Schema():
                    schemas[record.id] = record
                case Channel():
                    channels[record.id] = self._add_topic(record, schemas.get(record.schema_id))
                case Message() if record.channel_id in channels:
                    channels[record.channel_id].count += 1
                    self._add_time(record.log_time, record.log_time)
                case Metadata():
                    self.metadata[record.name] = record.metadata
                case Message():
                    orphans += 1
                case Damage():
                    self.complete = False
                    self.losses.append(f"{file.name}: {record}")
        if orphans:
            self.losses.append(f"{file.name}: {orphans} messages of topics whose description is lost")
        return False

    def _add_topic(self, channel: Channel, schema: Schema | None) -> TopicInfo:
        return self.topics.setdefault(channel.topic, TopicInfo.of(channel, schema))

    def _add_time(self, first: int, last: int) -> None:
        self.start = min(self.start, first) if self._timed else first
        self.end = max(self.end, last)
        self._timed = True


def bag_files(path: Path) -> list[Path]:
    """The MCAP files of a bag in order: as metadata.yaml lists them, else sorted by their number.

    Raises:
        BagError: if there are none.
    """
    if path.is_file():
        return [path]
    if not path.is_dir():
        raise BagError(f"no bag at {path}")
    try:
        text = (path / METADATA).read_text(encoding="utf-8")
        info = yaml.safe_load(text)["rosbag2_bagfile_information"]
        files = [path / name for name in info["relative_file_paths"]]
        mode = str(info.get("compression_mode") or "").lower()
    except FileNotFoundError:
        files, mode = sorted(path.glob("*.mcap"), key=_number), ""
    except (yaml.YAMLError, KeyError, TypeError, UnicodeDecodeError) as error:
        raise BagError(f"cannot read {path / METADATA}: {why(error)}; remove it to read the files alone") from error
    if mode in ("file", "message"):
        raise BagError(f"bag {path} is compressed by {mode}: convert it first (ros2 bag convert)")
    missing = [f.name for f in files if not f.is_file()]
    if missing or not files:
        raise BagError(f"bag {path} has no file {missing[0] if missing else '*.mcap'}")
    if any(f.suffix != ".mcap" for f in files):
        raise BagError(f"bag {path} is not MCAP: convert it first (ros2 bag convert)")
    return files


def _number(path: Path) -> tuple[int, str]:
    match = re.search(r"_(\d+)$", path.stem)
    return (int(match[1]) if match else -1, path.name)


def _from_index(file: Path, topics: set[str] | None, start: int | None, end: int | None) -> Iterator[RawMessage]:
    """Messages in the order of log time; only chunks that overlap in time are in memory together."""
    summary = read_summary(file)
    assert summary is not None
    schemas = {key: schema.name for key, schema in summary.schemas.items()}
    channels = {c.id: (c.topic, schemas.get(c.schema_id, "")) for c in summary.channels.values()}
    pending: list[RawMessage] = []
    try:
        with file.open("rb") as stream:
            for entry in sorted(summary.chunk_indexes, key=lambda c: (c.message_start_time, c.chunk_start_offset)):
                if not _matters(entry, channels, topics, start, end):
                    continue
                ready = bisect_left(pending, entry.message_start_time, key=_log_time)
                yield from pending[:ready]
                stream.seek(entry.chunk_start_offset + 9)
                found = chunk_messages(stream.read(entry.chunk_length - 9))
                pending = pending[ready:] + [RawMessage(*channels[c], log, sent, data) for c, log, sent, data in found]
                pending.sort(key=_log_time)
    except BROKEN as error:
        raise BagError(f"{file} is damaged inside ({why(error)}): check it and repair it into a new bag") from error
    yield from pending


_log_time = attrgetter("log_time")


def _matters(
    entry: ChunkIndex, channels: dict[int, tuple[str, str]], topics: set[str] | None, start: int | None, end: int | None
) -> bool:
    """Whether a chunk may hold a wanted message."""
    if (start is not None and entry.message_end_time < start) or (end is not None and entry.message_start_time >= end):
        return False
    held = entry.message_index_offsets
    return topics is None or not held or any(channels[c][0] in topics for c in held if c in channels)


def _from_front(file: Path) -> Iterator[RawMessage]:
    schemas: dict[int, str] = {}
    channels: dict[int, tuple[str, str]] = {}
    for record in scan(file):
        if isinstance(record, Message) and record.channel_id in channels:
            yield RawMessage(*channels[record.channel_id], record.log_time, record.publish_time, record.data)
        elif isinstance(record, Schema):
            schemas[record.id] = record.name
        elif isinstance(record, Channel):
            channels[record.id] = (record.topic, schemas.get(record.schema_id, ""))
