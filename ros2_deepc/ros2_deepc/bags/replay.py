# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Feeds the recorded samples through today's controller and monitors, and says where the answers differ."""

import hashlib
import os
from collections import deque
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from .compare import Difference, first_difference
from .errors import BagError
from .messages import Messages
from .outline import Block
from .reader import BagReader
from .recording import find_namespace
from .topic import TopicInfo

Array = NDArray[np.float64]
# what depends on the clock or on what never reached the topics
STATE_SKIP = frozenset({"header", "epoch", "prepare_time", "solve_time", "deadline_misses", "refused"})
REPORT_SKIP = frozenset({"header", "epoch", "data_age", "compute_time"})
REFERENCES = 100  # newest ones that hold on in a new epoch: as many as a node that starts then would hear of
START = 200  # messages kept back at the start of an epoch, or before it, at most
WAITING = 1000  # answers that may wait for their counterpart before they count as missing


ANSWERS = {"controller": ("inputs", "controller/state"), "monitor": ("monitor/report",)}  # topics of each part
CHANGES = {"controller": "controller/changes", "monitor": "monitor/changes"}  # what else entered each part
Answer = tuple[str, int, Any]  # topic, k, an object with the message's fields


class Core(Protocol):
    """One part of the loop: takes the samples of one epoch and gives back what it would publish."""

    @property
    def listens(self) -> bool:
        """Whether the inputs are somebody else's, so that they are no answers of this part."""

    def reference(self, k: int, values: Array) -> list[Answer]:
        """Takes a reference that holds from k on."""

    def inputs(self, k: int, values: Array) -> list[Answer]:
        """Takes the inputs recorded for k."""

    def outputs(self, k: int, values: Array, held: int) -> list[Answer]:
        """Takes outputs k."""

    def disturbances(self, k: int, values: Array) -> list[Answer]:
        """Takes the disturbances measured at k and, after them, those forecast; flat."""

    def change(self, k: int, name: str, value: str) -> list[Answer]:
        """Takes what entered besides samples before outputs k, see deepc_msgs/Change."""


CoreFactory = Callable[[Any], Core]  # from the recorded PlantInfo; one Core per epoch


@dataclass(slots=True)
class Replay:
    """How a replay went.

    Attributes:
        differences: the first one of each topic.
        compared: answers compared, by topic.
        unmatched: answers recorded but not computed or the other way round, by topic; those that were computed for
            samples after the last one recorded do not count, for a recording ends somewhere.
        loop_hash: of recomputed inputs and recorded outputs, see ``loop_hash``; "" if no inputs were recomputed.
    """

    differences: list[Difference] = field(default_factory=list)
    compared: dict[str, int] = field(default_factory=dict)
    unmatched: dict[str, int] = field(default_factory=dict)
    loop_hash: str = ""

    @property
    def same(self) -> bool:
        """Whether all that was recorded was computed again, to the bit, and at least one answer was compared."""
        return not self.differences and not any(self.unmatched.values()) and any(self.compared.values())


def replay(
    bag: str | os.PathLike[str] | BagReader,
    cores: Mapping[str, CoreFactory],
    *,
    namespace: str | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,  # noqa: ARG005
) -> Replay:
    """Feeds a bag's samples through cores and compares what they answer with what was recorded.

    Args:
        bag: folder, file or open reader.
        cores: factory of each part to replay, by its name in ANSWERS.
        namespace: of the plant; default the only one.
        progress: called now and then with messages done and in all.

    Raises:
        BagError: if the bag holds no PlantInfo, or cannot be read.
    """
    reader = bag if isinstance(bag, BagReader) else BagReader(bag)
    prefix = find_namespace(reader, namespace)
    matcher = _Matcher({topic for name in cores for topic in ANSWERS[name]})
    changes = {name: _changes(reader, f"{prefix}/{CHANGES[name]}") for name in cores}
    references: dict[int, Any] = {}
    early: deque[tuple[str, Any]] = deque(maxlen=START)  # seen before what says whose they are
    feeder: _Feeder | None = None
    total = reader.message_count
    for done, (topic, message) in enumerate(_stream(reader, prefix, matcher.topics)):
        if topic == "plant_info":
            if feeder is not None and feeder.epoch != message.epoch:
                feeder.finish()
            elif feeder is not None:
                feeder.flush()  # the same epoch again, as a bag that loops has it: its changes may be still to come
            made = [(make(message), changes[name].get(message.epoch, deque())) for name, make in cores.items()]
            feeder = _Feeder(message, made, matcher)
            for reference in references.values():  # those of before hold on, as for the node
                feeder.take("reference", reference)
            for item in early:
                feeder.take(*item)
            early.clear()
        elif topic == "reference":
            references.pop(message.k, None)
            references[message.k] = message
            if len(references) > REFERENCES:
                del references[next(iter(references))]
            if feeder is not None:
                feeder.take(topic, message)
        elif feeder is None or message.epoch != feeder.epoch:
            early.append((topic, message))
        else:
            feeder.take(topic, message)
        if done % 1000 == 0:
            progress(done, total)
    if feeder is None:
        raise BagError(f"bag {reader.path} has no message on {prefix}/plant_info: nothing says what the plant is")
    feeder.finish()
    progress(total, total)
    return matcher.result()


_SAMPLES = ("outputs", "inputs", "reference", "disturbances")


@dataclass(slots=True)
class _Taken:
    """What a replay needs of a Sample: its fields, and whether all its values are finite and good."""

    epoch: int
    k: int
    held: int
    sender: int
    values: Array
    usable: bool


def _stream(reader: BagReader, prefix: str, answers: Collection[str]) -> Iterator[tuple[str, Any]]:
    """Relative topic and decoded message of all that cores take or that is compared, in order."""
    for topics, batch in reader.batches(f"{prefix}/{name}" for name in ("plant_info", *_SAMPLES, *answers)):
        messages: list[tuple[str, Any]] = [("", None)] * len(batch)
        for channel in np.unique(batch.channel).tolist():
            info, rows = topics[channel], np.flatnonzero(batch.channel == channel)
            name, mine = info.name[len(prefix) + 1 :], batch.rows(rows)
            decoded = _samples(mine, info) if name in _SAMPLES else map(info.decoder(), (data for *_, data in mine))
            for row, message in zip(rows.tolist(), decoded, strict=True):
                messages[row] = (name, message)
        yield from messages


def _samples(messages: Messages, info: TopicInfo) -> Iterator[_Taken]:
    block = Block(messages, info.outliner())
    if block.bad:
        raise BagError(f"topic {info.name}: {block.bad[0][1]}")
    values, widths = block.vectors("values")
    quality, _ = block.vectors("quality")
    unknown = ~np.isfinite(values) & (np.arange(values.shape[1]) < widths[:, None])
    usable = np.asarray(~unknown.any(axis=1) & ~np.nan_to_num(quality).any(axis=1))
    kinds = {"epoch": np.int64, "k": np.uint64, "held": np.int64, "sender": np.uint64}
    columns = [block.column(name, kind, 0).tolist() for name, kind in kinds.items()]
    vectors = (row[:width] for row, width in zip(values, widths.tolist(), strict=True))
    yield from map(_Taken, *columns, vectors, usable.tolist())


def _changes(reader: BagReader, topic: str) -> dict[int, deque[Any]]:
    """All changes of one part by epoch, in order: few, and needed before a recorder may have seen them."""
    found: dict[int, deque[Any]] = {}
    for _, message in reader.decoded([topic]):
        found.setdefault(message.epoch, deque()).append(message)
    return found


class _Feeder:
    """One epoch: hands the samples to the cores as the nodes would take them.

    A recorder does not see two topics in the order in which a controller saw them. Where the controller noted when it
    took its references, they are taken from there. Otherwise the order matters at the start only, where the loop waits
    for a reference; so messages are kept back until the first sample was answered, and references go first.
    """

    def __init__(self, info: Any, cores: list[tuple[Core, deque[Any]]], matcher: "_Matcher") -> None:
        self.epoch, self._cores, self._matcher = info.epoch, cores, matcher
        m, p = len(info.input_names), len(info.output_names)
        self._sizes = {"inputs": m, "outputs": p, "reference": p}
        self._k, self._s = -1, max(int(info.s), 1)
        self._kept: list[tuple[str, Any]] | None = []
        self._follows = 0
        self._noted = any(change.name == "reference" for _, changes in cores for change in changes)

    def take(self, topic: str, message: Any) -> None:
        """One recorded message."""
        if message.epoch != self.epoch and topic != "reference":
            return
        if topic == "outputs":
            self._follows = message.sender or self._follows
        if topic == "inputs" and self._follows and message.sender not in (0, self._follows):
            return  # of a controller that the plant does not follow
        if self._kept is None:
            self._deliver(topic, message)
            return
        self._kept.append((topic, message))
        if topic == "controller/state" or len(self._kept) >= START:
            self.flush()

    def flush(self) -> None:
        """Hands over what was kept back at the start."""
        kept, self._kept = self._kept, None
        for topic, message in sorted(kept or (), key=lambda item: item[0] != "reference"):
            self._deliver(topic, message)

    def finish(self) -> None:
        """The epoch ends: what was kept back, then the changes after its last outputs."""
        self.flush()
        for core, changes in self._cores:
            self._change(core, changes, None)

    def _change(self, core: Core, changes: deque[Any], k: int | None) -> None:
        """Hands over the changes that came before outputs k; None: all."""
        while changes and (k is None or changes[0].k <= k):
            change = changes.popleft()
            for answer in core.change(change.k, change.name, change.value):
                self._matcher.computed(self.epoch, *answer)

    def _deliver(self, topic: str, message: Any) -> None:
        for core, changes in self._cores:
            if topic == "outputs":
                self._change(core, changes, message.k)
            for answer in self._ask(core, topic, message):
                self._matcher.computed(self.epoch, *answer)
        if getattr(message, "overdue", False):
            return  # decided by the clock, stands among the changes
        if topic == "outputs":
            self._k = max(self._k, message.k)
            self._matcher.output(message, self._s)
        elif not (topic == "inputs" and any(core.listens for core, _ in self._cores)):
            self._matcher.recorded(topic, self.epoch, message)

    def _ask(self, core: Core, topic: str, message: Any) -> list[Answer]:
        if topic not in _SAMPLES or not message.usable:
            return []
        if topic == "disturbances":
            return core.disturbances(message.k, message.values)
        if len(message.values) != self._sizes[topic]:
            return []
        if topic == "reference":
            return [] if self._noted else core.reference(message.k, message.values)
        if topic == "inputs":
            return core.inputs(message.k, message.values)
        return core.outputs(message.k, message.values, message.held) if message.k > self._k else []


class _Matcher:
    """Pairs recorded and computed answers by topic, epoch and k, in whichever order they come."""

    def __init__(self, topics: Collection[str]) -> None:
        self._result = Replay()
        self._waiting: dict[str, dict[tuple[int, int], tuple[bool, Any]]] = {topic: {} for topic in topics}
        self.topics = topics
        self._last: dict[tuple[str, int], int] = {}  # newest k recorded, by topic and epoch
        self._differs: set[str] = set()
        self._hash = hashlib.sha256()
        self._inputs: dict[tuple[int, int], bytes] = {}
        self._held: dict[tuple[int, int], int] = {}

    def recorded(self, topic: str, epoch: int, message: Any) -> None:
        """One recorded answer; of those to the same sample the first one counts."""
        if topic in self._waiting:
            self._last[topic, epoch] = message.k
            answer = SimpleNamespace(values=message.values) if topic == "inputs" else message
            self._pair(topic, (epoch, message.k), True, answer)

    def computed(self, epoch: int, topic: str, k: int, answer: Any) -> None:
        """One computed answer."""
        if topic == "inputs":
            self._inputs[epoch, k] = np.asarray(answer.values, dtype="<f8").tobytes()
            _forget(self._inputs)
        self._pair(topic, (epoch, k), False, answer)

    def output(self, message: Any, s: int) -> None:
        """Recorded outputs of a plant of index s, for the hash: outputs k-s+1 tell how old the input of k was."""
        epoch, k = message.epoch, message.k
        self._held[epoch, k] = message.held
        _forget(self._held)
        held = 0 if k < s - 1 else self._held.get((epoch, k - s + 1))
        u = None if held is None else self._inputs.get((epoch, k - held))
        if u is not None:
            self._hash.update(u + np.asarray(message.values, dtype="<f8").tobytes())

    def result(self) -> Replay:
        """Closes the books."""
        for topic, waiting in self._waiting.items():
            lost = sum(
                was_recorded or k <= self._last.get((topic, epoch), -1)
                for (epoch, k), (was_recorded, _) in waiting.items()
            )
            self._result.unmatched[topic] = self._result.unmatched.get(topic, 0) + lost
        if self._inputs:
            self._result.loop_hash = self._hash.hexdigest()
        return self._result

    def _pair(self, topic: str, key: tuple[int, int], recorded: bool, message: Any) -> None:
        waiting = self._waiting[topic]
        other = waiting.get(key)
        if other is None or other[0] == recorded:
            waiting.setdefault(key, (recorded, message))
            self._drop_oldest(topic, waiting)
            return
        del waiting[key]
        pair = (message, other[1]) if recorded else (other[1], message)
        self._compare(topic, key, *pair)

    def _drop_oldest(self, topic: str, waiting: dict[tuple[int, int], tuple[bool, Any]]) -> None:
        if len(waiting) > WAITING:
            del waiting[next(iter(waiting))]
            self._result.unmatched[topic] = self._result.unmatched.get(topic, 0) + 1

    def _compare(self, topic: str, key: tuple[int, int], recorded: Any, computed: Any) -> None:
        self._result.compared[topic] = self._result.compared.get(topic, 0) + 1
        if topic in self._differs:
            return
        skip = REPORT_SKIP if topic == "monitor/report" else STATE_SKIP
        found = first_difference(recorded, computed, skip)
        if found:
            self._differs.add(topic)
            path, was, now = found
            self._result.differences.append(
                Difference(topic=topic, epoch=key[0], k=key[1], field=path, recorded=was, computed=now)
            )


def _forget(known: dict[tuple[int, int], Any]) -> None:
    """Drops the oldest entry where there are more than will be asked for."""
    if len(known) > WAITING:
        del known[next(iter(known))]
