# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Work that comes after the loop: what a message asks for, but not at once."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from rclpy.clock import Clock, ClockType

if TYPE_CHECKING:
    from .lifecycle import ManagedNode

AT_ONCE = 1e-4  # [s]; readers of what was just published are in the executor's queue already, and go first


class Deferred:
    """Does work a little later, in order, by a timer of its own; a task of rclpy costs the caller more than twice that.

    Args:
        node: does nothing while it is inactive; errors end in its ``on_fault``. Lives until cleanup.
        delay: from the first work to its turn [s].
    """

    def __init__(self, node: ManagedNode, delay: float) -> None:
        self._node = node
        self._due: list[Callable[[], None]] = []
        self._do = node.guarded(lambda work: work())
        self._timer = node.create_timer(delay, self._run, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._timer.cancel()
        node.resources.callback(node.destroy_timer, self._timer)

    def __call__(self, work: Callable[[], None]) -> None:
        """Work to be done; at once if nobody spins the node."""
        if self._node.executor is None:
            work()
            return
        if not self._due:
            self._timer.reset()
        self._due.append(work)

    def _run(self) -> None:
        self._timer.cancel()
        due, self._due = self._due, []
        for work in due:
            self._do(work)
