# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The base of every node: a managed (lifecycle) node whose gaps in rclpy are closed.

rclpy runs timers and subscriptions of an inactive node, forgets `deactivate` on a signal, and lets an exception in a callback
end the process. Here callbacks run only while active, `stop` walks down to finalized, and an exception ends in `on_fault`.
"""

from collections.abc import Callable
from typing import Any, TypeVar

from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from .parameters import ConfigError

Message = TypeVar("Message")


class ManagedNode(LifecycleNode):
    """A lifecycle node. Subclasses fill in ``configure``, ``activate``, ``deactivate`` and ``cleanup``.

    Each of the four may be called again after its counterpart; ``deactivate`` and ``cleanup`` must tolerate being called twice.
    """

    def __init__(self, name: str, **kwargs: Any) -> None:
        super().__init__(name, **kwargs)
        self._active = False
        self.fault = ""
        """One line on why the node failed; empty while all is well."""

    def configure(self) -> None:
        """Reads and validates parameters, allocates, creates publishers and subscriptions.

        Raises:
            ConfigError: with one line that says what is wrong; the node then stays unconfigured.
        """

    def activate(self) -> None:
        """Starts work."""

    def deactivate(self) -> None:
        """Leaves a defined state behind and stops work."""

    def cleanup(self) -> None:
        """Releases what ``configure`` allocated."""

    def on_fault(self, error: Exception) -> None:
        """An exception escaped a callback: says so and deactivates."""
        self.fault = f"{type(error).__name__}: {error}"
        self.get_logger().error(f"{self.get_name()} stopped working: {self.fault}")
        if self._active:
            self.trigger_deactivate()

    def start(self) -> None:
        """Configures and activates.

        Raises:
            ConfigError: if the configuration cannot work.
        """
        if self.trigger_configure() != TransitionCallbackReturn.SUCCESS:
            raise ConfigError(self.fault or f"{self.get_name()} could not be configured")
        if self.trigger_activate() != TransitionCallbackReturn.SUCCESS:
            raise ConfigError(self.fault or f"{self.get_name()} could not be activated")

    def quiesce(self) -> None:
        """Deactivates, if active."""
        if self._active:
            self.trigger_deactivate()

    def stop(self) -> None:
        """Deactivates and cleans up, whatever the state; may be called twice. No executor may be spinning the node."""
        self.quiesce()
        self._guard(self.cleanup)

    def guarded(self, callback: Callable[[Message], None]) -> Callable[[Message], None]:
        """A callback that runs only while the node is active and whose exceptions end in ``on_fault``."""

        def run(msg: Message) -> None:
            if not self._active:
                return
            try:
                callback(msg)
            except Exception as error:
                self.on_fault(error)

        return run

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Transition callback: unconfigured -> inactive, or a failure with its reason logged."""
        self.fault = ""
        return self._guard(self.configure)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Transition callback: inactive -> active."""
        self._active = True
        result = self._guard(self.activate)
        self._active = result == TransitionCallbackReturn.SUCCESS
        return result if self._active is False else super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Transition callback: active -> inactive."""
        result = self._guard(self.deactivate)
        self._active = False
        super().on_deactivate(state)
        return result

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Transition callback: inactive -> unconfigured."""
        return self._guard(self.cleanup)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Transition callback: any -> finalized."""
        if self._active:
            self._guard(self.deactivate)
            self._active = False
        return self._guard(self.cleanup)

    def _guard(self, step: Callable[[], None]) -> TransitionCallbackReturn:
        try:
            step()
        except (ConfigError, OSError, ValueError) as error:
            self.fault = str(error)
            self.get_logger().error(self.fault)
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS
