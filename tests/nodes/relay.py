# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""A node between a publisher and its readers that loses, delays, doubles, reorders and spoils messages by a schedule.

The publisher writes to ``<topic>/source`` (by remapping), the readers read ``<topic>`` as ever. What happens to the
i-th message is drawn from a seed, not from a clock: the same messages suffer the same faults, however fast they come.
"""

import copy
from dataclasses import dataclass, field

import numpy as np
from deepc_msgs.msg import Sample
from rclpy.node import Node

from ros2_deepc.ros.qos import profile

SPOILED = ("nan", "inf", "size", "empty", "epoch", "quality")
MOVED = ("drop", "outage", "late", "twice", "reverse")
EXTRA = ("twice", "old", *SPOILED)  # added beside the good message: what a loop that waits for every message survives
SOURCE = "/source"


def spoiled(msg, kind):
    """A copy of a sample as one of the faults in SPOILED leaves it."""
    bad = copy.deepcopy(msg)
    if kind in ("nan", "inf"):
        bad.values = [*list(msg.values)[:-1], float(kind)]
    elif kind == "size":
        bad.values = [*msg.values, 0.0]
    elif kind == "empty":
        bad.values = []
    elif kind == "epoch":
        bad.epoch = (msg.epoch + 7) % 2**32
    elif kind == "quality":
        bad.quality = [Sample.GOOD] * (len(msg.values) - 1) + [Sample.BAD]
    return bad


@dataclass
class Schedule:
    """Which messages suffer what, drawn from a seed.

    Attributes:
        seed: of the draws.
        rate: share of the messages that a fault begins at.
        kinds: faults to choose from.
        begin: messages that pass before the first fault.
        end: number of the message from which on all pass again.
    """

    seed: int
    rate: float
    kinds: tuple[str, ...] = SPOILED + MOVED
    begin: int = 2
    end: int = 100

    def __post_init__(self):
        rng = np.random.Generator(np.random.PCG64([self.seed, 11]))
        hit = rng.random(self.end) < self.rate
        kinds, lengths = rng.integers(len(self.kinds), size=self.end), rng.integers(1, 5, size=self.end)
        self._faults = {i: (self.kinds[kinds[i]], int(lengths[i])) for i in range(self.begin, self.end) if hit[i]}

    def __getitem__(self, i):
        """Fault and its length in messages for message i; ("", 0) if none."""
        return self._faults.get(i, ("", 0))


@dataclass
class Link:
    """One topic through the relay.

    Attributes:
        schedule: what happens to its messages.
        beside: faults come in addition to the good message.
        seen: messages that came in.
        sent: messages that went out, in order, and whether each is spoiled.
        faults: number of faults by kind.
        closed: nothing passes any more.
    """

    schedule: Schedule
    beside: bool = False
    seen: list[Sample] = field(default_factory=list)
    sent: list[tuple[Sample, bool]] = field(default_factory=list)
    faults: dict[str, int] = field(default_factory=dict)
    closed: bool = False
    _waiting: list[tuple[int, Sample]] = field(default_factory=list)
    _silent_until: int = -1
    _reversed_until: int = -1

    def take(self, msg):
        """What goes out now that ``msg`` has come in: (message, spoiled) in order."""
        if self.closed:
            return []
        i = len(self.seen)
        self.seen.append(msg)
        kind, length = self.schedule[i]
        if kind and i > max(self._silent_until, self._reversed_until):
            self.faults[kind] = self.faults.get(kind, 0) + 1
        out = self._beside(msg, kind) if self.beside else self._instead(i, msg, kind, length)
        out += [(late, False) for due, late in self._waiting if due <= i]
        self._waiting = [(due, late) for due, late in self._waiting if due > i]
        self.sent += out
        return out

    def _beside(self, msg, kind):
        if not kind:
            return [(msg, False)]
        if kind == "twice":
            return [(msg, False), (msg, False)]
        if kind == "old":
            return [(self.seen[len(self.seen) // 2], False), (msg, False)]
        return [(spoiled(msg, kind), True), (msg, False)]

    def _instead(self, i, msg, kind, length):
        if i <= self._silent_until:
            return []
        if i <= self._reversed_until:
            self._waiting.insert(0, (self._reversed_until, msg))
            return []
        if kind == "outage":
            self._silent_until = i + 2 * length
            return []
        if kind == "reverse":
            self._reversed_until = i + length
            self._waiting.insert(0, (self._reversed_until, msg))
            return []
        if kind == "late":
            self._waiting.append((i + length, msg))
            return []
        if kind in SPOILED:
            return [(spoiled(msg, kind), True)]
        return {"drop": [], "twice": [(msg, False)] * 2}.get(kind, [(msg, False)])

    @property
    def spoiled(self):
        """Messages that went out spoiled."""
        return sum(bad for _, bad in self.sent)


class Relay(Node):
    """Passes samples on, by a schedule for each topic.

    Args:
        links: a Link for each topic.
        lockstep: quality of service of the loop.
        sample_time: of a real-time loop [s].
    """

    def __init__(self, links, *, lockstep, sample_time=0.0, **kwargs):
        super().__init__("relay", **kwargs)
        for topic, link in links.items():
            offered = profile(topic, lockstep=lockstep, sample_time=sample_time)
            onward = self.create_publisher(topic.type, topic.name, offered)
            taken = profile(topic, lockstep=lockstep)
            self.create_subscription(topic.type, topic.name + SOURCE, self._passes(link, onward), taken)

    def _passes(self, link, onward):
        def on_message(msg):
            for out, _ in link.take(msg):
                onward.publish(out)

        return on_message


def remapped(*topics):
    """ROS arguments that make a publisher write to the relay; readers keep the plain name."""
    return ["--ros-args", *(word for topic in topics for word in ("-r", f"{topic.name}:={topic.name}{SOURCE}"))]


def verdict_of(sent):
    """What a strict receiver of a topic makes of messages in that order.

    Returns:
        (indices accepted in order, number refused): the spoiled and those not newer than the newest are refused.
    """
    accepted, refused = [], 0
    for msg, bad in sent:
        if bad or (accepted and msg.k <= accepted[-1]):
            refused += 1
        else:
            accepted.append(int(msg.k))
    return accepted, refused
