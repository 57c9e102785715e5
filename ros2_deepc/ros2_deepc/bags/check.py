# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Is a bag whole, and is what it holds fit for learning? And what can be saved of one that is not."""

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import yaml

from .errors import BagError
from .layout import MARKER, METADATA
from .messages import Messages
from .outline import Block
from .progress import Progress, no_progress
from .reader import BagReader, bag_files
from .recording import find_namespace
from .scan import Damage
from .topic import TopicInfo
from .walk import Walked, walk
from .watch import LogWatch, Watch, watch_of
from .writer import RUN_METADATA, BagWriter

EXPECTED = ("plant_info", "outputs", "inputs", "reference", "controller/state", "monitor/report")


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is wrong ("error") or worth knowing ("note"), where, and what it is."""

    level: str
    where: str
    text: str

    def __str__(self) -> str:
        return f"{self.level}: {self.where}: {self.text}"


@dataclass(slots=True)
class Check:
    """What a check found.

    Attributes:
        findings: in the order found.
        messages: number of messages that can be read.
        lost_bytes: bytes of the files that cannot be read.
    """

    findings: list[Finding] = field(default_factory=list)
    messages: int = 0
    lost_bytes: int = 0

    @property
    def ok(self) -> bool:
        """Whether there are no errors."""
        return not any(f.level == "error" for f in self.findings)

    def add(self, level: str, where: str, text: str) -> None:
        """Appends a finding."""
        self.findings.append(Finding(level, where, text))


def check(path: str | os.PathLike[str], *, progress: Progress = no_progress) -> Check:
    """Reads every byte of a bag and says what is wrong with it.

    Looks at the marker of an unfinished recording, metadata.yaml against the content, unreadable stretches, checksums,
    log times that go back and missing topics; on outputs and inputs at gaps, repeated and late samples, stamps that
    jump, values that are not finite, changes of size; and at what the controller refused or the plant held. Memory is
    bounded.

    Args:
        path: folder or file.
        progress: called now and then with messages done and in all.

    Raises:
        BagError: if there is no bag.
    """
    reader, found = BagReader(path), Check()
    folder = reader.files[0].parent if reader.path.is_dir() else reader.path
    if folder.is_dir() and (folder / MARKER).exists():
        found.add("error", folder.name, "the recording was not closed")
    if int(lost := reader.metadata.get("recorder", {}).get("lost", "0")):
        found.add("error", folder.name, f"the recorder lost {lost} messages: its disk was too slow")
    counts: dict[str, int] = {}
    watches: dict[str, Watch] = {}
    clock = LogWatch()
    for file, item in _walk(folder):
        if isinstance(item, Damage):
            found.lost_bytes += item.size
            found.add("error", folder.name, f"{file.name}: {item}")
        elif isinstance(item, tuple):
            topics, batch = item
            clock.look(batch)
            for channel in np.unique(batch.channel).tolist():
                topic, mine = topics[channel], batch.rows(batch.channel == channel)
                counts[topic.name] = counts.get(topic.name, 0) + len(mine)
                if topic.readable:
                    watches.setdefault(topic.name, watch_of(topic)).look(Block(mine, topic.outliner()))
            found.messages += len(batch)
            progress(found.messages, reader.message_count)
    if not found.messages:
        found.add("error", folder.name, "no messages")
    for name, watch in {"log time": clock, **watches}.items():
        watch.report(name, found.add)
    _compare_index(folder, counts, found)
    _missing_topics(folder, found)
    return found


def repair(path: str | os.PathLike[str], out: str | os.PathLike[str]) -> Check:
    """Copies all that can be read of a bag, bytes and times as they are, into a new and finished one.

    Args:
        path: the damaged bag; it is not touched.
        out: folder of the new bag.

    Returns:
        The number of messages saved, and a finding for every loss.

    Raises:
        BagError: if nothing can be read, or the new bag cannot be written.
    """
    source = BagReader(path)
    saved = Check()
    source.must_hold_something()
    metadata = source.metadata.get(RUN_METADATA, {})
    with BagWriter(out, metadata={**metadata, "repaired_from": Path(path).name}) as bag:
        for name, values in source.metadata.items():
            if name not in (RUN_METADATA, "rosbag2"):
                bag.add_metadata(name, values)
        for file, item in _walk(Path(path)):
            if isinstance(item, Damage):
                saved.add("note", Path(path).name, f"{file.name}: {item}")
                saved.lost_bytes += item.size
            elif isinstance(item, tuple):
                topics, batch = item
                saved.messages += _copy(topics, batch, bag)
        for attachment in source.attachments():
            bag.attach(attachment.name, attachment.media_type, attachment.data, attachment.log_time)
    return saved


def _copy(topics: Mapping[int, TopicInfo], batch: Messages, bag: BagWriter) -> int:
    for channel in np.unique(batch.channel).tolist():
        topic = topics[channel]
        qos = yaml.safe_load(topic.qos) if topic.qos else None
        bag.add_topic(topic.name, topic.type, qos or [], topic.type_hash, topic.definition)
    for channel, log_time, publish_time, data in batch:
        bag.write(topics[channel].name, data, log_time, publish_time)
    return len(batch)


def _walk(path: Path) -> Iterator[tuple[Path, Walked]]:
    """What is in the files of a bag, in file order, see ``walk``."""
    for file in bag_files(path):
        for item in walk(file):
            yield file, item


def _compare_index(folder: Path, counts: dict[str, int], found: Check) -> None:
    """What metadata.yaml counts against what is there."""
    if not folder.is_dir() or not (folder / METADATA).exists():
        if folder.is_dir():
            found.add("error", folder.name, f"no {METADATA}")
        return
    info = yaml.safe_load((folder / METADATA).read_text(encoding="utf-8"))["rosbag2_bagfile_information"]
    for entry in info["topics_with_message_count"]:
        name, count = entry["topic_metadata"]["name"], entry["message_count"]
        if counts.get(name, 0) != count:
            found.add("error", name, f"{METADATA} counts {count} messages, the files hold {counts.get(name, 0)}")


def _missing_topics(folder: Path, found: Check) -> None:
    try:
        reader = BagReader(folder)
        prefix = find_namespace(reader)
    except BagError as error:
        found.add("note", folder.name, f"no single plant: {error}")
        return
    for name in EXPECTED:
        if not reader.topics.get(f"{prefix}/{name}", TopicInfo("", "", "")).count:
            found.add("note", f"{prefix}/{name}", "no messages")
