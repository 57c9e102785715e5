# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The base of every node: a managed (lifecycle) node whose gaps in rclpy are closed.

rclpy runs timers and subscriptions of an inactive node, forgets `deactivate` on a signal, and lets an exception in a
callback end the process. Here callbacks run only while active, `stop` deactivates and cleans up, and an exception
ends in `on_fault`.
"""

from collections import deque
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from typing import Any, ClassVar, TypeVar

from deepc_msgs.msg import Sample
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from .parameters import ConfigError, Param, declare
from .publisher import PatientPublisher
from .qos import profile
from .topics import Topic
from .wire import reading

Message = TypeVar("Message")

AUTOSTART = Param("autostart", True, "configure and activate without being told to")


class ManagedNode(LifecycleNode):
    """A lifecycle node. Subclasses fill in ``configure``, ``activate`` and ``deactivate``.

    What ``configure`` makes, it registers in ``resources``; cleaning up closes them in reverse order.

    Attributes:
        p: values of the parameters by name.
        fault: one line on why the node failed; empty while all is well.
        resources: what cleaning up has to release.
    """

    parameters: ClassVar[tuple[Param, ...]] = ()

    def __init__(self, name: str, **kwargs: Any) -> None:
        super().__init__(name, **kwargs)
        self.p = declare(self, (*self.parameters, AUTOSTART))
        self.fault = ""
        self.resources = ExitStack()
        self._active = False
        self._latched: list[Callable[[], None]] = []

    @classmethod
    def check(cls, parameters: Mapping[str, Any], info: Any) -> None:
        """Checks parameters against a plant, before any node exists.

        Args:
            parameters: of this node, those that are given.
            info: PlantInfo of the plant.

        Raises:
            ConfigError: if they cannot work together.
        """

    def configure(self) -> None:
        """Validates, allocates, creates publishers and subscriptions.

        Raises:
            ConfigError: with one line that says what is wrong; the node then stays unconfigured.
        """

    def activate(self) -> None:
        """Starts work."""

    def deactivate(self) -> None:
        """Leaves a defined state behind and stops work."""

    def subscribe(self, topic: Topic, callback: Callable[[Any], None], *, lockstep: bool = True) -> None:
        """Subscribes until cleanup; the callback runs only while the node is active.

        What is kept for late readers comes again at every activation, as to a node that has just been started. Samples
        of the loop come as `wire.Reading`.
        """
        qos = profile(topic, lockstep=lockstep)
        run = self._keeping(callback, topic.depth) if topic.latched else self.guarded(callback)
        raw = topic.type is Sample and not topic.latched
        subscription = self.create_subscription(topic.type, topic.name, reading(run) if raw else run, qos, raw=raw)
        self.resources.callback(self.destroy_subscription, subscription)

    def advertise(
        self, topic: Topic, *, lockstep: bool = True, sample_time: float = 0.0, readers: int = 0
    ) -> PatientPublisher:
        """Makes a publisher that lives until cleanup; see `PatientPublisher`."""
        publisher = PatientPublisher(self, topic, lockstep=lockstep, sample_time=sample_time, readers=readers)
        self.resources.callback(publisher.destroy)
        return publisher

    def on_fault(self, error: Exception) -> None:
        """An exception escaped a callback: says so and deactivates."""
        self.fault = str(error) if isinstance(error, ConfigError) else f"{type(error).__name__}: {error}"
        self.get_logger().error(f"{self.get_name()} stopped working: {self.fault}")
        self.quiesce()

    def start(self) -> None:
        """Configures and activates.

        Raises:
            ConfigError: if the configuration cannot work.
        """
        for transition in (self.trigger_configure, self.trigger_activate):
            if transition() != TransitionCallbackReturn.SUCCESS:
                raise ConfigError(self.fault or f"{self.get_name()} could not be started")

    def quiesce(self) -> None:
        """Deactivates, if active."""
        if self._active:
            self.trigger_deactivate()

    def stop(self) -> None:
        """Deactivates and cleans up, whatever the state; may be called twice. No executor may be spinning the node."""
        self.quiesce()
        self._guard(self.resources.close)

    def _keeping(self, callback: Callable[[Message], None], depth: int) -> Callable[[Message], None]:
        """A guarded callback whose last messages are given to it again at every activation."""
        run = self.guarded(callback)
        kept: deque[Message] = deque(maxlen=depth)

        def again() -> None:
            for msg in list(kept):
                callback(msg)

        def keep(msg: Message) -> None:
            kept.append(msg)
            run(msg)

        self._latched.append(again)
        self.resources.callback(self._latched.remove, again)
        return keep

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

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:  # noqa: ARG002 - rclpy's signature
        """Transition callback: unconfigured -> inactive, or a failure with its reason logged."""
        self.fault = ""
        result = self._guard(self.configure)
        if result != TransitionCallbackReturn.SUCCESS:
            self.resources.close()
        return result

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Transition callback: inactive -> active, or a failure with its reason logged."""
        self.fault = ""
        self._active = True
        for step in (self.activate, *self._latched):
            if self._guard(step) != TransitionCallbackReturn.SUCCESS:
                self._guard(self.deactivate, quiet=True)
                self._active = False
                return TransitionCallbackReturn.FAILURE
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Transition callback: active -> inactive."""
        result = self._guard(self.deactivate)
        self._active = False
        super().on_deactivate(state)
        return result

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:  # noqa: ARG002
        """Transition callback: inactive -> unconfigured."""
        return self._guard(self.resources.close)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:  # noqa: ARG002
        """Transition callback: any -> finalized."""
        if self._active:
            self._guard(self.deactivate)
            self._active = False
        return self._guard(self.resources.close)

    def _guard(self, step: Callable[[], None], *, quiet: bool = False) -> TransitionCallbackReturn:
        try:
            step()
        except Exception as error:  # rclpy would turn it into an error state without a word
            if quiet:
                return TransitionCallbackReturn.FAILURE
            known = isinstance(error, (ConfigError, OSError, ValueError))
            self.fault = str(error) if known else f"{type(error).__name__}: {error}"
            self.get_logger().error(self.fault)
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS
