# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The last gate before the field: what may be written, and why the rest may not."""

from collections import Counter
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np

from .tags import Array, TagMap


class Refusal(StrEnum):
    """Why a command was refused."""

    MODE = "mode"
    ZONE = "zone"
    PERMIT = "permit"
    FOREIGN = "another commands"
    EPOCH = "epoch"
    SIZE = "size"
    QUALITY = "quality"
    NOT_FINITE = "not finite"
    LATE = "late"
    EARLY = "early"
    STALE = "stale"
    RANGE = "range"
    RATE = "rate"


@dataclass(frozen=True, slots=True, kw_only=True)
class Command:
    """What somebody wants written.

    Attributes:
        zone: name of the plant it is meant for.
        source: who wants it, e.g. "controller".
        epoch: of the samples it answers.
        k: sample at which it is to hold.
        values: m numbers, in input units.
        quality: empty, or m flags of deepc_msgs/Sample.
    """

    zone: str
    source: str
    epoch: int
    k: int
    values: Any
    quality: Any = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Moment:
    """What the gateway knows when a command arrives.

    Attributes:
        writing: whether commands are passed on now.
        epoch: the epoch in force.
        first: smallest k that is not over yet.
        last: largest k that may be decided now.
        age: [s] since the newest outputs.
    """

    writing: bool
    epoch: int
    first: int
    last: int
    age: float


@dataclass(slots=True)
class Counts:
    """What became of all commands.

    Attributes:
        passed: written as they came.
        clamped: written after being brought into their limits.
        refused: not written, by reason.
    """

    passed: int = 0
    clamped: int = 0
    refused: Counter[Refusal] = field(default_factory=Counter)


class Guard:
    """Decides for every command whether it may reach the field; a vector is written whole or not at all.

    Args:
        tags: the map; before the first write the field is taken to be at the safe values.
    """

    def __init__(self, tags: TagMap) -> None:
        self._name, self._names = tags.plant.name, [tag.name for tag in tags.inputs]
        self._low, self._high, rate, safe = (
            np.array([getattr(tag, name) for tag in tags.inputs]) for name in ("low", "high", "max_rate", "safe")
        )
        self._step: Array = rate * tags.period * (1 + 1e-9)  # rounding of the sender is not a violation
        self._clamp = np.array([tag.clamp for tag in tags.inputs])
        self._permit = frozenset.intersection(*(frozenset(tag.permit) for tag in tags.inputs))
        self._stale = tags.supervision.stale_after
        self.last: Array = safe
        self.counts = Counts()
        self.reason = ""

    def judge(self, command: Command, moment: Moment) -> Array | Refusal:
        """The values to write, shape (m,), or why there are none; both are counted.

        Args:
            command: from anybody.
            moment: what holds now.
        """
        verdict = self._formal(command, moment) or self._values(command.values)
        if isinstance(verdict, Refusal):
            self.counts.refused[verdict] += 1
        return verdict

    def refuse(self, refusal: Refusal, reason: str) -> Refusal:
        """Counts a command that never came as far as being judged."""
        self.counts.refused[refusal] += 1
        return self._no(refusal, reason)

    def _formal(self, command: Command, moment: Moment) -> Refusal | None:
        """Everything but the numbers themselves."""
        if command.zone != self._name:
            return self._no(Refusal.ZONE, f"meant for {command.zone!r}, this is {self._name!r}")
        if command.source not in self._permit:
            return self._no(Refusal.PERMIT, f"{command.source!r} may not write here")
        if not moment.writing:
            return self._no(Refusal.MODE, "the gateway passes nothing on now")
        if command.epoch != moment.epoch:
            return self._no(Refusal.EPOCH, f"epoch {command.epoch}, this is {moment.epoch}")
        if command.k < moment.first:
            return self._no(Refusal.LATE, f"inputs {command.k} when {moment.first} are expected")
        if command.k > moment.last:
            return self._no(Refusal.EARLY, f"inputs {command.k} when {moment.last} are expected")
        if moment.age > self._stale:
            return self._no(Refusal.STALE, f"answers outputs that are {moment.age:.3g} s old")
        return self._shape(command)

    def _shape(self, command: Command) -> Refusal | None:
        m = len(self._names)
        if len(command.values) != m:
            return self._no(Refusal.SIZE, f"{len(command.values)} values for {m} inputs")
        if len(command.quality) not in (0, m) or any(command.quality):
            return self._no(Refusal.QUALITY, "flagged as not GOOD by its sender")
        return None

    def _values(self, given: Any) -> Array | Refusal:
        """In range and rate, or brought there where the tag asks for that."""
        try:
            values = np.array(given, dtype=np.float64)
        except (TypeError, ValueError):
            return self._no(Refusal.NOT_FINITE, "not numbers")
        if values.shape != self.last.shape:
            return self._no(Refusal.SIZE, f"shape {values.shape}")
        if not np.isfinite(values).all():
            return self._no(Refusal.NOT_FINITE, f"{self._names[int(np.argmin(np.isfinite(values)))]} is not a number")
        low, high = np.maximum(self._low, self.last - self._step), np.minimum(self._high, self.last + self._step)
        outside = (values < self._low) | (values > self._high)
        fast = (values < low) | (values > high)
        for where, refusal in ((outside, Refusal.RANGE), (fast, Refusal.RATE)):
            if (strict := where & ~self._clamp).any():
                i = int(np.argmax(strict))
                return self._no(refusal, f"{self._names[i]} = {values[i]:.6g} after {self.last[i]:.6g}")
        inside = np.minimum(np.maximum(values, low), high)
        self.counts.clamped += bool(fast.any())
        self.counts.passed += not fast.any()
        return np.where(fast, inside, values)

    def _no(self, refusal: Refusal, reason: str) -> Refusal:
        self.reason = f"{refusal.value}: {reason}"
        return refusal
