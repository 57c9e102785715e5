# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The gateway without any protocol and without ROS: scans and commands in, outputs and writes out."""

import math
from dataclasses import dataclass

import numpy as np

from .assemble import Assembler, Quality, Scan, Vector
from .guard import Command, Guard, Moment, Refusal
from .pace import ScanPace, Step, TimerPace
from .round_trip import RoundTrip
from .supervisor import Answer, State, Supervisor
from .tags import BEAT, ECHO, PEER, SCAN, Array, TagMap

NO_RECORD = 0  # epoch of samples that belong to no record
_CARRIED = 64  # newest heartbeats whose echo still tells something
_ARMING = 10  # periods beyond the good samples that going to AUTO may take


@dataclass(frozen=True, slots=True, kw_only=True)
class Outputs:
    """One sample to publish.

    Attributes:
        epoch: of the sample; NO_RECORD unless the gateway's own inputs are in force, and then UNCERTAIN at best.
        k: its index.
        vector: its values and their quality.
        held: samples since the input in force was commanded.
    """

    epoch: int
    k: int
    vector: Vector
    held: int


class Gateway:
    """One field device seen from one zone. Every method takes the own monotonic clock ``now`` [s]; none ever blocks.

    Sample k of an epoch is the one that answers inputs k: counting starts when the first inputs of an epoch have been
    written. Until then, and in SHADOW and FALLBACK, what moves the plant is not what the controller asked for: samples
    carry UNCERTAIN and belong to no epoch.

    Args:
        tags: the map.
        now: own clock [s].
        reference: round trip of data collected before [s], or NaN.
    """

    def __init__(self, tags: TagMap, now: float, reference: float = math.nan) -> None:
        settings = tags.supervision
        self.tags, self.epoch = tags, 1
        self.guard = Guard(tags)
        self.round_trip = RoundTrip(tags.period, reference)
        arming = settings.fallback_after + (settings.good_samples + _ARMING) * tags.period
        self.supervisor = Supervisor(settings, arming)
        self.link_fault = "not connected yet"
        self.applied = self.guard.last
        self.assembler = Assembler(tags)
        self._timer = TimerPace(tags.period)
        self._counter = ScanPace(tags.period, tags.modulus.get(SCAN, 2), settings.fallback_after)
        self._index = {tag.name: len(tags.outputs) + i for i, tag in enumerate(tags.counters)}
        self._scale = np.array([tag.scale for tag in tags.inputs])
        self._offset = np.array([tag.offset for tag in tags.inputs])
        self._safe = np.array([tag.safe for tag in tags.inputs])
        self._limits = np.array([[tag.low, tag.high] for tag in tags.inputs]).T
        self._vector: Vector | None = None
        self._good = 0
        self._j = -1  # sample of the epoch that is in force
        self._shadow_k = -1
        self._sampled_at = self._peer_at = self._commanded_at = now
        self._peer: float | None = None
        self._pending: dict[int, Array] = {}
        self._applied_k: int | None = None
        self._carried: dict[int, int | None] = {}  # heartbeat -> newest inputs that were written with or before it
        self._acted: int | None = None  # inputs that the newest scan of the field used, as its echo tells
        self._on_its_way: tuple[int, Array] | None = None
        self._beat, self._beat_at, self._beat_sample = 0, -math.inf, -math.inf
        self._first_beat_at = -math.inf
        self._runs = 0
        self._fallback_from: Array | None = None
        self._ramped_at = -math.inf

    @property
    def state(self) -> State:
        """What the gateway does."""
        return self.supervisor.state

    @property
    def waiting(self) -> bool:
        """Whether the first inputs of the epoch have not been written yet."""
        return self._j < 0

    def scan(self, scan: Scan, now: float, wall_ns: int) -> Outputs | None:
        """Takes what was read; returns a sample if this is one.

        Args:
            scan: everything that is read, just now.
            now: own clock [s].
            wall_ns: own wall clock [ns since 1970].
        """
        self.link_fault = ""
        self._signs_of_life(scan, now)
        step = self._step(scan, now)
        if step.broken:
            self._good = 0
            self.supervisor.broke(now, step.broken)
        if step.samples < 1:
            self.tick(now)
            return None
        self._vector = self.assembler.take(scan, now, wall_ns)
        self._good = self._good + 1 if self._vector.good and not step.broken else 0
        self._sampled_at = now
        outputs = self._number(step.samples, self._vector)
        self.tick(now)
        return outputs

    def failed(self, reason: str, now: float) -> None:
        """A request to the field failed."""
        self.link_fault, self._good = reason, 0
        self._on_its_way = None
        self._drop_pending()
        self.tick(now)

    def tick(self, now: float) -> None:
        """Looks at the time; call it at least once a period."""
        if now - self._sampled_at > self.tags.supervision.stale_after:
            self._good = 0
        self.supervisor.tick(now, self._trouble(now), self._steady(), self.round_trip.moved())
        self._new_epoch()
        if self.state is State.RUN:
            self.round_trip.learn()
        else:
            self._drop_pending()
        if self.state is State.FALLBACK and self._fallback_from is None:
            self._fallback_from = self.applied.copy()

    def command(self, command: Command, now: float) -> Refusal | None:
        """Takes a command; returns why it was refused, or None."""
        verdict = self.guard.judge(command, self._moment(now))
        if isinstance(verdict, Refusal):
            return verdict
        self._pending[int(command.k)] = self.guard.last = verdict
        self._commanded_at = now
        self.tick(now)
        return None

    def order(self, now: float) -> Array | None:
        """What to write now, raw, in the order of ``TagMap.writes``; NaN = leave alone, None = nothing at all."""
        m = len(self.tags.inputs)
        raw = np.full(len(self.tags.writes), np.nan)
        values = self._due(now)
        if values is not None:
            raw[:m] = (values - self._offset) / self._scale
        if self._beat_due(now, values is not None):
            self._beat = (self._beat + 1) % self.tags.modulus[BEAT]
            raw[m] = self._beat
        return None if np.isnan(raw).all() else raw

    def wrote(self, order: Array, now: float) -> None:
        """The order was carried out: the field has these numbers."""
        m = len(self.tags.inputs)
        if self._on_its_way is not None and not np.isnan(order[:m]).any():
            k, values = self._on_its_way
            self.applied = self.guard.last = values
            if k >= 0:
                self._applied_k = k
                if self._fallback_from is not None:  # written while the state changed
                    self._fallback_from = values
        self._on_its_way = None
        if len(order) > m and not np.isnan(order[m]):
            again = self._beat_sample == self._sampled_at and not np.isnan(order[:m]).any()
            self._first_beat_at = self._first_beat_at if again else now
            self._beat_at, self._beat_sample = now, self._sampled_at
            if ECHO in self._index:
                beat = int(order[m])
                self.round_trip.sent(beat, self._first_beat_at)  # the controller's time is no part of the round trip
                self._carried[beat] = self._applied_k
                if len(self._carried) > _CARRIED:
                    del self._carried[next(iter(self._carried))]

    def answered(self, seconds: float) -> None:
        """A request and its answer took so long; this is the round trip where the field echoes no heartbeat."""
        if ECHO not in self._index:
            self.round_trip.add(seconds)

    def auto(self, now: float) -> Answer:
        """Asks for commands to be passed on."""
        echoed = ECHO in self._index  # then the heartbeat must be on before anything can be said of the round trip
        answer = self.supervisor.auto(now, self._trouble(now), "" if echoed else self.round_trip.moved())
        if echoed and self.supervisor.armed_at == now:
            self.round_trip.restart()
        return answer

    def shadow(self, now: float) -> Answer:
        """Asks for nothing to be written any more."""
        answer = self.supervisor.shadow(now)
        self._drop_pending()
        return answer

    def acknowledge(self, now: float) -> Answer:
        """Ends a latched FALLBACK, if all is well again."""
        released = self.tags.supervision.policy == "release"  # then there was no heartbeat either
        trouble, moved = self._trouble(now), self.round_trip.moved()
        answer = self.supervisor.acknowledge(now, trouble, self._steady(), moved, rearm=released)
        if answer.accepted and released and ECHO in self._index:
            self.round_trip.restart()
        self._new_epoch()
        self.tick(now)
        return answer

    def leave(self, now: float) -> None:
        """The gateway ends; go on with ``order`` until ``settled``."""
        self.supervisor.leave(now)
        self.tick(now)

    def settled(self) -> bool:
        """Whether the field has what the fallback wants it to have."""
        ramping = self.state is State.FALLBACK and self.tags.supervision.policy == "ramp"
        return not ramping or bool((self.applied == self._safe).all())

    def wait(self, now: float) -> float:
        """Time until the next look at the field [s]."""
        return self.tags.poll if self.tags.by == "scan" else self._timer.wait(now)

    def _step(self, scan: Scan, now: float) -> Step:
        if self.tags.by == "timer":
            return self._timer.look(now)
        i = self._index[SCAN]
        return Step(0) if scan.quality[i] == Quality.BAD else self._counter.look(float(scan.raw[i]), now)

    def _signs_of_life(self, scan: Scan, now: float) -> None:
        if PEER in self._index:
            value = float(scan.raw[self._index[PEER]])
            if value != self._peer and math.isfinite(value):
                self._peer, self._peer_at = value, now
        if ECHO in self._index:
            echo = float(scan.raw[self._index[ECHO]])
            self.round_trip.returned(echo, now)
            self._acted = self._carried.get(int(echo), self._acted) if math.isfinite(echo) else self._acted

    def _number(self, samples: int, vector: Vector) -> Outputs | None:
        """Which sample of which epoch this is."""
        timed = self.tags.by == "timer"
        started = self._newest_inputs() is not None or (timed and 0 in self._pending)
        if self.state in (State.RUN, State.DEGRADED) and started and self.supervisor.armed_at is None:
            self._j = 0 if self._j < 0 else self._j + samples
            k = self._j - (self.tags.plant.s - 1)  # with index s, what is seen now answers inputs up to s-1 later
            return Outputs(epoch=self.epoch, k=k, vector=vector, held=self._held()) if k >= 0 else None
        self._shadow_k += samples
        shown = np.maximum(vector.quality, Quality.UNCERTAIN)
        vector = Vector(
            values=vector.values, quality=shown, stamp_ns=vector.stamp_ns, age=vector.age, reason=vector.reason
        )
        return Outputs(epoch=NO_RECORD, k=self._shadow_k, vector=vector, held=0)

    def _held(self) -> int:
        if self.tags.by == "timer" and self._j in self._pending:
            return 0
        newest = self._newest_inputs()
        return 0 if newest is None else max(0, self._j - newest)

    def _newest_inputs(self) -> int | None:
        """Inputs that the newest sample answers: as the field says where it echoes, else as they were written."""
        told = self.tags.by == "scan" and ECHO in self._index
        return self._acted if told else self._applied_k

    def _moment(self, now: float) -> Moment:
        missed = not self.waiting and self._closed(now)
        passing = self.state is State.RUN or (
            self.state is State.DEGRADED and self.supervisor.armed_at is None and self._steady()
        )
        return Moment(
            writing=passing, epoch=self.epoch, first=self._j + 1 + missed, last=self._j + self.tags.plant.s + missed,
            age=0.0 if self.waiting else now - self._sampled_at,
        )  # fmt: skip

    def _closed(self, now: float) -> bool:
        """Whether a scan may have happened that was not seen yet, which would take a command one sample late."""
        return self.tags.by == "scan" and now - self._sampled_at > self.tags.period - 2 * self.tags.poll

    def _due(self, now: float) -> Array | None:
        """The inputs to write now, in input units."""
        if self.state is State.FALLBACK:
            return self._fallback(now)
        if self.state is not State.RUN or self._closed(now):
            return None
        k = self._j if self.tags.by == "timer" else self._j + 1
        values = self._pending.pop(k, None)
        for late in [old for old in self._pending if old < k]:
            del self._pending[late]
        if values is not None:
            self._on_its_way = (k, values)
        return values

    def _fallback(self, now: float) -> Array | None:
        policy, start = self.tags.supervision, self._fallback_from
        if policy.policy != "ramp" or start is None or now - self._ramped_at < 0.9 * self.tags.period:
            return None
        share = min(1.0, (now - self.supervisor.since) / policy.ramp) if policy.ramp > 0 else 1.0
        values: Array = self._safe if share == 1.0 else start + share * (self._safe - start)
        values = np.minimum(np.maximum(values, self._limits[0]), self._limits[1])
        if (values == self.applied).all():
            return None
        self._on_its_way, self._ramped_at = (-1, values), now
        return values

    def _beat_due(self, now: float, inputs: bool) -> bool:
        """Whether to write the heartbeat: with every sample and all inputs, and without samples a little slower."""
        released = self.state is State.FALLBACK and self.tags.supervision.policy == "release"
        if self.tags.beat is None or released or not self.supervisor.writing:
            return False
        return inputs or self._sampled_at != self._beat_sample or now - self._beat_at > 1.5 * self.tags.period

    def _drop_pending(self) -> None:
        """Commands that were let through but not written are not written any more; one on its way may arrive."""
        self._pending.clear()
        self.guard.last = self.applied if self._on_its_way is None else self._on_its_way[1]

    def _steady(self) -> bool:
        enough = self._good >= self.tags.supervision.good_samples
        return enough and (ECHO not in self._index or self.round_trip.measured)

    def _trouble(self, now: float) -> str:
        """What is wrong now, in one line; empty if nothing."""
        stale = self.tags.supervision.stale_after
        if self.link_fault:
            return self.link_fault
        if self._vector is None:
            return "no sample yet"
        if now - self._sampled_at > stale:
            return f"no sample for {stale:g} s"
        if not self._vector.good:
            return self._vector.reason
        if PEER in self._index and now - self._peer_at > stale:
            return f"no sign of life from the field for {stale:g} s"
        controlling = self.state in (State.RUN, State.DEGRADED) and self.supervisor.armed_at is None
        if controlling and not self.waiting and now - self._commanded_at > stale:
            return f"no command for {stale:g} s"
        return ""

    def _new_epoch(self) -> None:
        """Every time that commands begin to be passed on, a new record begins."""
        if self.supervisor.runs == self._runs:
            return
        self._runs = self.supervisor.runs
        self.epoch += 1
        self._j, self._applied_k, self._acted = -1, None, None
        self._carried.clear()
        self._fallback_from = None
        self._drop_pending()
