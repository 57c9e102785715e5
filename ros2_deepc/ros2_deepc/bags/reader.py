# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Reads bags: a rosbag2-style folder or a single .mcap file, finished or not, lazily and in bounded memory."""

import os
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from mcap.reader import SeekingReader
from mcap.records import Attachment, Channel, ChunkIndex, Metadata, Schema

from .decode import Decoder
from .errors import BagError, why
from .layout import MARKER, METADATA
from .messages import Messages
from .outline import Block
from .scan import BROKEN, Damage, chunk_messages, read_attachments, read_summary
from .topic import RawMessage, TopicInfo
from .walk import walk


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
        self.complete = not (self.path.is_dir() and (self.files[0].parent / MARKER).exists())
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

    def must_hold_something(self) -> None:
        """Raises a BagError if there is no message in the bag, or none that can be read."""
        if not self.message_count and self.losses:
            raise BagError(f"nothing can be read of bag {self.path}: {'; '.join(self.losses)}")
        if not self.message_count:
            raise BagError(f"bag {self.path} holds no message: nothing was recorded")

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
        for names, batch in self.batches(topics):
            if start is not None or end is not None:
                first, last = np.uint64(max(start or 0, 0)), np.uint64(2**64 - 1 if end is None else max(end, 0))
                batch = batch.rows((batch.log_time >= first) & (batch.log_time < last))
            for channel, log_time, publish_time, data in batch:
                info = names[channel]
                yield RawMessage(info.name, info.type, log_time, publish_time, data)

    def decoded(self, topics: Iterable[str] | None = None) -> Iterator[tuple[RawMessage, Any]]:
        """Yields each message with its decoded form, see ``ros2_deepc.bags.decode``."""
        decoders: dict[str, Decoder] = {}
        for raw in self.messages(topics):
            if raw.topic not in decoders:
                decoders[raw.topic] = self.topics[raw.topic].decoder()
            yield raw, decoders[raw.topic](raw.data)

    def blocks(self, topics: Iterable[str] | None = None) -> Iterator[tuple[str, Block]]:
        """Yields topic and messages, many at once and decoded by column; in each topic in the order of ``messages``.

        Raises:
            BagError: for a message that cannot be decoded.
        """
        for names, batch in self.batches(topics):
            for channel in np.unique(batch.channel).tolist():
                info = names[channel]
                block = Block(batch.rows(batch.channel == channel), info.outliner())
                if block.bad:
                    raise BagError(f"topic {info.name}: {block.bad[0][1]}")
                yield info.name, block

    def batches(self, topics: Iterable[str] | None = None) -> Iterator[tuple[Mapping[int, TopicInfo], Messages]]:
        """Yields topics by channel and messages, chunk by chunk, in the order of ``messages``; bounded memory."""
        wanted = None if topics is None else set(topics)
        for file in self.files:
            source = _from_index(file, wanted) if self._indexed[file] else _from_front(file)
            for names, batch in source:
                chosen = [c for c, info in names.items() if wanted is None or info.name in wanted]
                mine = batch.rows(np.isin(batch.channel, chosen))
                if len(mine):
                    yield names, mine

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
        for item in walk(file):
            if isinstance(item, Metadata):
                self.metadata[item.name] = item.metadata
            elif isinstance(item, Damage):
                self.complete = False
                self.losses.append(f"{file.name}: {item}")
            else:
                self._count(*item)
        return False

    def _count(self, names: Mapping[int, TopicInfo], batch: Messages) -> None:
        for info in names.values():
            self.topics.setdefault(info.name, replace(info))
        for channel, count in zip(*np.unique(batch.channel, return_counts=True), strict=True):
            self.topics[names[int(channel)].name].count += int(count)
        if len(batch):
            self._add_time(int(batch.log_time.min()), int(batch.log_time.max()))

    def _add_topic(self, channel: Channel, schema: Schema | None) -> TopicInfo:
        return self.topics.setdefault(channel.topic, TopicInfo.of(channel, schema))

    def _add_time(self, first: int, last: int) -> None:
        self.start = min(self.start, first) if self._timed else first
        self.end = max(self.end, last)
        self._timed = True


def bag_files(path: Path) -> list[Path]:
    """The MCAP files of a bag in order: as metadata.yaml lists them, else sorted by their number.

    Args:
        path: a file, the folder of a bag, or the folder of a run with its `bag`.

    Raises:
        BagError: if there are none.
    """
    if path.is_file():
        return [path]
    if not path.is_dir():
        raise BagError(f"no bag at {path}: name the folder of a run or of a bag, or an .mcap file")
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
    if not files and (path / "bag").is_dir():
        return bag_files(path / "bag")
    missing = [f.name for f in files if not f.is_file()]
    if missing or not files:
        raise BagError(f"bag {path} has no file {missing[0] if missing else 'that ends in .mcap'}")
    if any(f.suffix != ".mcap" for f in files):
        raise BagError(f"bag {path} is not MCAP: convert it first (ros2 bag convert)")
    return files


def _number(path: Path) -> tuple[int, str]:
    match = re.search(r"_(\d+)$", path.stem)
    return (int(match[1]) if match else -1, path.name)


def _from_index(file: Path, topics: set[str] | None) -> Iterator[tuple[Mapping[int, TopicInfo], Messages]]:
    """Messages in the order of log time; only chunks that overlap in time are in memory together."""
    summary = read_summary(file)
    assert summary is not None
    names = {c.id: TopicInfo.of(c, summary.schemas.get(c.schema_id)) for c in summary.channels.values()}
    together: list[Messages] = []
    latest = 0
    try:
        with file.open("rb") as stream:
            for entry in sorted(summary.chunk_indexes, key=lambda c: (c.message_start_time, c.chunk_start_offset)):
                if not _matters(entry, names, topics):
                    continue
                if together and entry.message_start_time >= latest:
                    yield names, Messages.joined(together).in_order()
                    together.clear()
                stream.seek(entry.chunk_start_offset + 9)
                found = chunk_messages(stream.read(entry.chunk_length - 9))
                together.append(found.rows(np.isin(found.channel, list(names))))
                latest = max(latest, entry.message_end_time)
    except BROKEN as error:
        raise BagError(f"{file} is damaged inside ({why(error)}): check it and repair it into a new bag") from error
    if together:
        yield names, Messages.joined(together).in_order()


def _matters(entry: ChunkIndex, names: Mapping[int, TopicInfo], topics: set[str] | None) -> bool:
    """Whether a chunk may hold a wanted message."""
    held = entry.message_index_offsets
    return topics is None or not held or any(names[c].name in topics for c in held if c in names)


def _from_front(file: Path) -> Iterator[tuple[Mapping[int, TopicInfo], Messages]]:
    for item in walk(file):
        if isinstance(item, tuple):
            yield item
