# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Is a bag whole, and is what it holds fit for learning? And what can be saved of one that is not."""

import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from mcap.records import Channel, Message, Schema

from .decode import decoder
from .errors import BagError
from .layout import MARKER, METADATA
from .reader import BagReader, TopicInfo, bag_files
from .run import find_namespace
from .scan import Damage, scan
from .writer import RUN_METADATA, BagWriter

EXPECTED = ("plant_info", "outputs", "inputs", "reference", "controller/state", "monitor/report")
SHOWN = 5  # places that are named one by one before the rest is only counted


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


def check(path: str | os.PathLike[str]) -> Check:
    """Reads every byte of a bag and says what is wrong with it.

    Looks at the marker of an unfinished recording, metadata.yaml against the content, unreadable stretches, checksums,
    log times that go back and missing topics; on outputs and inputs at gaps, repeated and late samples, stamps that
    jump, values that are not finite, changes of size; and at what the controller refused or the plant held. Memory is
    bounded.

    Raises:
        BagError: if there is no bag.
    """
    folder = Path(path)
    found = Check()
    if folder.is_dir() and (folder / MARKER).exists():
        found.add("error", folder.name, "the recording was not closed")
    counts: dict[str, int] = {}
    watches: dict[str, _Watch] = {}
    last_log = 0
    for item in _walk(folder):
        if isinstance(item, Damage):
            found.lost_bytes += item.size
            found.add("error", folder.name, str(item))
            continue
        topic, message = item
        found.messages += 1
        counts[topic.name] = counts.get(topic.name, 0) + 1
        if message.log_time < last_log:
            watches.setdefault("log time", _Watch()).note("goes back", f"{(last_log - message.log_time) * 1e-9:.6g} s")
        last_log = max(last_log, message.log_time)
        watches.setdefault(topic.name, _Watch()).look(topic, message.data)
    for name, watch in watches.items():
        watch.report(name, found)
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
    if not source.message_count:
        raise BagError(f"nothing can be read of {path}: {'; '.join(source.losses) or 'no messages'}")
    metadata = source.metadata.get(RUN_METADATA, {})
    known: set[str] = set()
    with BagWriter(out, metadata={**metadata, "repaired_from": Path(path).name}) as bag:
        for name, values in source.metadata.items():
            if name not in (RUN_METADATA, "rosbag2"):
                bag.add_metadata(name, values)
        for item in _walk(Path(path)):
            if isinstance(item, Damage):
                saved.add("note", Path(path).name, str(item))
                saved.lost_bytes += item.size
                continue
            topic, message = item
            if topic.name not in known:
                known.add(topic.name)
                qos = yaml.safe_load(topic.qos) if topic.qos else None
                bag.add_topic(topic.name, topic.type, qos or [], topic.type_hash, topic.definition)
            bag.write(topic.name, message.data, message.log_time, message.publish_time)
            saved.messages += 1
        for attachment in source.attachments():
            bag.attach(attachment.name, attachment.media_type, attachment.data, attachment.log_time)
    return saved


def _walk(path: Path) -> Iterator[Damage | tuple[TopicInfo, Message]]:
    """Every readable message of a bag with its topic, and every damage, in file order."""
    for file in bag_files(path):
        schemas: dict[int, Schema] = {}
        topics: dict[int, TopicInfo] = {}
        orphans = 0
        for record in scan(file):
            match record:
                case Schema():
                    schemas[record.id] = record
                case Channel():
                    topics[record.id] = TopicInfo.of(record, schemas.get(record.schema_id))
                case Message() if record.channel_id in topics:
                    yield topics[record.channel_id], record
                case Message():
                    orphans += 1
                case Damage():
                    yield Damage(record.offset, record.size, f"{file.name}: {record.reason}")
        if orphans:
            yield Damage(0, 0, f"{file.name}: {orphans} messages of topics whose description is lost")


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


class _Watch:
    """Follows one topic and remembers how often each kind of thing went wrong, and the first places."""

    def __init__(self) -> None:
        self._notes: dict[str, list[str]] = {}
        self._counts: dict[str, int] = {}
        self._last: Any = None
        self._period = 0

    def note(self, what: str, where: str) -> None:
        """Counts one event."""
        self._counts[what] = self._counts.get(what, 0) + 1
        if self._counts[what] <= SHOWN:
            self._notes.setdefault(what, []).append(where)

    def look(self, topic: TopicInfo, data: bytes) -> None:
        """Looks at one message."""
        if topic.encoding != "cdr" or topic.schema_encoding != "ros2msg":
            return
        try:
            message = decoder(topic.type, topic.definition)(data)
        except BagError as error:
            self.note("cannot be decoded", str(error))
            return
        if topic.type == "deepc_msgs/msg/Sample" and topic.name.endswith(("/outputs", "/inputs")):
            self._sample(message)
            self._last = message
        elif topic.type == "deepc_msgs/msg/ControllerState":
            self._refusals(message)
            self._last = message

    def report(self, name: str, found: Check) -> None:
        """Writes what was remembered into the check."""
        for what, places in self._notes.items():
            more = self._counts[what] - len(places)
            text = f"{what}: {', '.join(places)}{f' and {more} more' if more else ''}"
            found.add("note" if what in _NOTES else "error", name, text)

    def _sample(self, message: Any) -> None:
        here = f"epoch {message.epoch} k = {message.k}"
        if not np.isfinite(message.values).all():
            self.note("values not finite", here)
        if message.quality.any():
            self.note("quality not good", here)
        if getattr(message, "held", 0):
            self.note("input held", here)
        last = self._last
        if last is None:
            return
        if len(message.values) != len(last.values):
            self.note("number of values changes", f"{here} from {len(last.values)} to {len(message.values)}")
        if message.epoch != last.epoch:
            self.note("new epoch", here)
            self._period = 0
            return
        if message.k > last.k + 1:
            self.note("samples missing", f"{message.k - last.k - 1} before {here}")
        elif message.k == last.k:
            same = np.array_equal(message.values, last.values)
            self.note("sample repeated", f"{here}{'' if same else ' with other values'}")
        elif message.k < last.k:
            self.note("sample out of order", f"{here} after k = {last.k}")
        else:
            self._stamp(last, message, here)

    def _stamp(self, last: Any, message: Any, here: str) -> None:
        step = _nanoseconds(message.header.stamp) - _nanoseconds(last.header.stamp)
        if step <= 0:
            self.note("clock goes back or stands", f"{here} by {-step * 1e-9:.6g} s")
        elif self._period and not 0.5 <= step / self._period <= 1.5:
            self.note("clock jumps", f"{here} by {step * 1e-9:.6g} s instead of {self._period * 1e-9:.6g} s")
        self._period = self._period or max(step, 0)

    def _refusals(self, message: Any) -> None:
        before = getattr(self._last, "refused", 0)
        if getattr(message, "refused", 0) > before:
            self.note("controller refused samples", f"{message.refused - before} before k = {message.k}")
        if message.failures > getattr(self._last, "failures", 0):
            self.note("optimisation failed", f"k = {message.k}")


_NOTES = frozenset({"new epoch", "input held", "controller refused samples", "optimisation failed", "quality not good"})


def _nanoseconds(stamp: Any) -> int:
    return int(stamp.sec * 10**9 + stamp.nanosec)
