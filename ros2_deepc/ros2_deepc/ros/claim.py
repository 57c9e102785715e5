# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Who may command a plant: heartbeats under a liveliness contract, one id for each activation of a controller.

Liveliness is MANUAL_BY_TOPIC, asserted by each heartbeat: with AUTOMATIC, Fast DDS declares a writer of the same
process dead after its first lease. Nodes do not wait for DDS's liveliness events, which count writers without naming
them and crash EventsExecutor when an entity is destroyed beside them; they look at each heartbeat of their own.
"""

import math
import os
import secrets
import socket
import time
from collections.abc import Callable, Container

from deepc_msgs.msg import Claim
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile

from . import topics
from .convert import stamp

LEASE = 2.0
"""[s] without a sign of life after which a claim is void, here and for DDS."""
_BEAT = LEASE / 4
_READERS_DEPTH = 100  # claims that may arrive before a reader looks


def _profile(depth: int) -> QoSProfile:
    """Transient local: whoever comes late hears at once who is there, but never somebody who is gone."""
    return QoSProfile(
        depth=depth,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
        liveliness=LivelinessPolicy.MANUAL_BY_TOPIC,
        liveliness_lease_duration=Duration(seconds=LEASE),
    )


class Claimants:
    """Who is there to command the plant of a node's zone.

    Args:
        node: on which to listen.
        heard: called after every claim, also those that say nothing new: by then another one may have run out.
    """

    def __init__(self, node: Node, heard: Callable[[], None] = lambda: None) -> None:
        self._node, self._heard = node, heard
        self._claims: dict[int, Claim] = {}
        self._seen: dict[int, float] = {}
        self._first: dict[int, float] = {}
        self._subscription = node.create_subscription(
            topics.CLAIM.type,
            topics.CLAIM.name,
            self._on_claim,
            _profile(_READERS_DEPTH),
        )

    def alive(self, sender: int, patience: float = LEASE) -> bool:
        """Whether there was a sign of life within ``patience`` [s], and no word that the plant was given up."""
        claim, seen = self._claims.get(sender), self._seen.get(sender)
        return (claim is None or claim.commands) and seen is not None and time.monotonic() - seen < patience

    def settled(self, sender: int) -> bool:
        """Whether a sender has been known for long enough that its other topics are known, too."""
        return time.monotonic() - self._first.get(sender, math.inf) > _BEAT / 2

    def note(self, sender: int) -> None:
        """Another sign of life: inputs of that sender, heard before its claim or beside it."""
        self._seen[sender] = time.monotonic()

    def commander(self, other_than: Container[int] = ()) -> Claim | None:
        """Whoever claims to command now, the earliest first; None if nobody does."""
        there = [claim for sender, claim in self._claims.items() if sender not in other_than and self.alive(sender)]
        return min(there, key=_seniority, default=None)

    def who(self, sender: int) -> str:
        """A sender for people."""
        claim = self._claims.get(sender)
        return claim.who if claim is not None else "somebody who does not say who it is"

    def destroy(self) -> None:
        """Takes the subscription off the graph."""
        self._node.destroy_subscription(self._subscription)

    def _on_claim(self, msg: Claim) -> None:
        self._claims[int(msg.id)] = msg
        self._first.setdefault(int(msg.id), time.monotonic())
        self.note(int(msg.id))
        self._heard()


class Owner:
    """What a plant keeps to: it follows one sender at a time, the next one only when that one is gone.

    Args:
        claimants: signs of life.
        patience: [s] without inputs after which a sender that makes no claims is gone.
    """

    def __init__(self, claimants: Claimants, patience: float) -> None:
        self._claimants, self._patience = claimants, max(patience, LEASE)
        self.sender: int | None = None

    def refusal(self, sender: int, *, final: bool = False) -> str:
        """Why inputs of a sender are not taken, in one line; empty if they may be.

        Args:
            sender: who sent them.
            final: whether the first sender is followed to the end, gone or not.
        """
        if self.sender is None or self.sender == sender:
            return ""
        if not final and not self._claimants.alive(self.sender, LEASE if self.sender else self._patience):
            return ""
        return f"{self._claimants.who(self.sender)} commands the plant, not {self._claimants.who(sender)}"

    def follow(self, sender: int) -> None:
        """Inputs of a sender are taken."""
        self.sender = sender
        self._claimants.note(sender)


class Holder:
    """A controller's own claim: a heartbeat every half a second from `take` to `release`.

    Its entities live as long as the node is configured: an executor may be about to look at them at any other time.

    Args:
        node: on which to publish.
        commands: whether it commands the plant now, or only waits.
        beside: called with every heartbeat, to look who is gone.
    """

    def __init__(self, node: Node, commands: Callable[[], bool], beside: Callable[[], None] = lambda: None) -> None:
        self._node, self._commands, self._beside = node, commands, beside
        self._held = False
        self.ids: set[int] = set()
        """Of all activations: news of an earlier one may still be on its way, and are not from somebody else."""
        self.claim = Claim(who=f"{node.get_fully_qualified_name()}, process {os.getpid()} on {socket.gethostname()}")
        self._publisher = node.create_publisher(topics.CLAIM.type, topics.CLAIM.name, _profile(1))
        self._timer = node.create_timer(_BEAT, self._on_beat, clock=Clock(clock_type=ClockType.STEADY_TIME))

    @property
    def id(self) -> int:
        """For the field ``sender`` of the inputs."""
        return int(self.claim.id)

    def precedes(self, other: Claim) -> bool:
        """Whether this claim is older than another one."""
        return _seniority(self.claim) < _seniority(other)

    def take(self) -> None:
        """Claims the plant, as somebody new."""
        self.claim.id = secrets.randbits(63) + 1
        self.ids.add(self.id)
        self.claim.header.stamp = stamp(time.time_ns())
        self._held = True
        self.beat()

    def beat(self) -> None:
        """Says now whether it commands; call it when that changes."""
        if self._held:
            self.claim.commands = self._commands()
            self._publisher.publish(self.claim)

    def _on_beat(self) -> None:
        self._beside()
        self.beat()

    def release(self) -> None:
        """Gives the plant up."""
        self._held, self.claim.commands = False, False
        self._publisher.publish(self.claim)

    def destroy(self) -> None:
        """Takes everything off the graph."""
        self._node.destroy_timer(self._timer)
        self._node.destroy_publisher(self._publisher)


def _seniority(claim: Claim) -> tuple[int, int, int]:
    return claim.header.stamp.sec, claim.header.stamp.nanosec, claim.id
