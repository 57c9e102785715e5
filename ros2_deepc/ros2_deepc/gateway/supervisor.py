# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The states of a gateway: SHADOW, RUN, DEGRADED and FALLBACK, the last latched until somebody acknowledges it."""

from dataclasses import dataclass
from enum import StrEnum

from .tags import Supervision


class State(StrEnum):
    """What the gateway does."""

    SHADOW = "SHADOW"
    RUN = "RUN"
    DEGRADED = "DEGRADED"
    FALLBACK = "FALLBACK"


@dataclass(frozen=True, slots=True)
class Answer:
    """What became of a request.

    Attributes:
        accepted: whether it was carried out.
        message: one line on what happens now, or why not.
    """

    accepted: bool
    message: str


class Supervisor:
    """Moves from state to state.

    | from | to | when |
    |---|---|---|
    | SHADOW | DEGRADED | AUTO is asked for and nothing speaks against it: the heartbeat starts, commands wait |
    | DEGRADED | RUN | good samples in a row, fresh commands (if there were any), the round trip has not moved |
    | DEGRADED | SHADOW | never was in RUN, and the above does not come about in time |
    | RUN | DEGRADED | a sample that is not GOOD, no sample, no sign of life, or no command for ``stale_after`` |
    | DEGRADED | FALLBACK | nothing has been well for ``fallback_after`` |
    | RUN, DEGRADED | FALLBACK | the record broke: the field was restarted |
    | FALLBACK | RUN | acknowledged while samples are good and the round trip has not moved; a new epoch |
    | any | SHADOW | asked for |

    Args:
        settings: time-outs and counts.
        arming: [s] that going to AUTO may take.
    """

    def __init__(self, settings: Supervision, arming: float) -> None:
        self._settings, self._arming = settings, arming
        self.state = State.SHADOW
        self.reason = "writes nothing until AUTO is asked for"
        self.since = 0.0
        self.runs = 0
        self.armed_at: float | None = None
        self._well = 0.0

    @property
    def writing(self) -> bool:
        """Whether anything at all is written."""
        return self.state is not State.SHADOW

    def tick(self, now: float, trouble: str, steady: bool, moved: str) -> None:
        """Looks at how things stand.

        Args:
            now: own clock [s].
            trouble: what is wrong now, in one line; empty if nothing.
            steady: good samples in a row are enough for RUN.
            moved: in one line, why the data no longer describe the loop; empty if they do.
        """
        if self.state is State.RUN:
            if trouble:
                self._go(State.DEGRADED, trouble, now)
            else:
                self._well = now
        elif self.state is State.DEGRADED:
            self._degraded(now, trouble, steady, moved)

    def _degraded(self, now: float, trouble: str, steady: bool, moved: str) -> None:
        if self.armed_at is not None:
            if steady and not trouble:
                self.armed_at = None
                if moved:
                    self._go(State.SHADOW, f"AUTO refused: {moved}", now)
                else:
                    self._run(now, "all samples are good, commands are passed on")
            elif now - self.armed_at > self._arming:
                self.armed_at = None
                self._go(State.SHADOW, f"AUTO given up: {trouble or 'not enough good samples in a row'}", now)
        elif steady and not trouble:
            self._go(State.RUN, "recovered", now)
            self._well = now
        elif now - self._well > self._settings.fallback_after:
            self._go(State.FALLBACK, trouble or self.reason, now)
        elif trouble:
            self.reason = trouble

    def broke(self, now: float, reason: str) -> None:
        """The record cannot go on."""
        if self.state is State.RUN or (self.state is State.DEGRADED and self.armed_at is None):
            self._go(State.FALLBACK, reason, now)

    def auto(self, now: float, trouble: str, moved: str) -> Answer:
        """Asks for commands to be passed on."""
        if self.state is State.FALLBACK:
            return Answer(False, "FALLBACK is latched: acknowledge it first")
        if self.state is not State.SHADOW:
            return Answer(True, f"already in {self.state}")
        if trouble or moved:
            return Answer(False, f"AUTO refused: {trouble or moved}")
        self._arm(now, "AUTO asked for, waiting for good samples")
        return Answer(True, "commands are passed on after a few good samples")

    def shadow(self, now: float) -> Answer:
        """Asks for nothing to be written any more."""
        self.armed_at = None
        if self.state is not State.SHADOW:
            self._go(State.SHADOW, "asked for; the field keeps its last inputs until its own watchdog acts", now)
        return Answer(True, "nothing is written")

    def acknowledge(self, now: float, trouble: str, steady: bool, moved: str, *, rearm: bool = False) -> Answer:
        """Ends a latched FALLBACK, if all is well again; with ``rearm``, by way of the heartbeat."""
        if self.state is not State.FALLBACK:
            return Answer(False, f"nothing to acknowledge in {self.state}")
        if trouble or moved or not steady:
            return Answer(False, f"not yet: {trouble or moved or 'too few good samples in a row'}")
        if rearm:
            self._arm(now, "acknowledged, waiting for the heartbeat to come back")
        else:
            self._run(now, "acknowledged")
        return Answer(True, "commands are passed on again, in a new epoch")

    def leave(self, now: float) -> None:
        """The gateway ends: the field gets the fallback, if it was in control."""
        if self.state in (State.RUN, State.DEGRADED) and self.armed_at is None:
            self._go(State.FALLBACK, "the gateway ends", now)

    def _arm(self, now: float, reason: str) -> None:
        self.armed_at = now
        self._go(State.DEGRADED, reason, now)

    def _run(self, now: float, reason: str) -> None:
        self.runs += 1
        self._well = now
        self._go(State.RUN, reason, now)

    def _go(self, state: State, reason: str, now: float) -> None:
        self.state, self.reason, self.since = state, reason, now
