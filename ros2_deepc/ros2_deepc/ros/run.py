# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Running nodes: executors, signals, one BLAS thread."""

import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress

import rclpy
from rclpy.context import Context
from rclpy.exceptions import InvalidHandle
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.experimental import EventsExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from threadpoolctl import threadpool_limits

from .lifecycle import ManagedNode
from .parameters import ConfigError

EXECUTORS = ("events", "single")
_DOMAINS = range(233)  # beyond them, the ports that DDS makes of the number do not exist
_SHARED, _ROOM = "/dev/shm", 4 << 20  # [B] that the participants of a zone take of it, and some to spare
_SLICE = 0.1  # [s]; EventsExecutor.spin() without a time-out never returns in the wheels


def make_executor(kind: str, context: Context) -> Executor:
    """An executor by name: ``events`` (fast) or ``single`` (the classic wait set).

    Raises:
        ConfigError: for any other name.
    """
    if kind == "events":
        return EventsExecutor(context=context)
    if kind == "single":
        return SingleThreadedExecutor(context=context)
    raise ConfigError(f"executor {kind!r} is not one of {', '.join(EXECUTORS)}")


class Spinner:
    """Spins an executor until a condition holds; ``wake`` ends the current slice at once."""

    def __init__(self, executor: Executor) -> None:
        self._executor = executor
        self._future: Future[None] = Future()

    def wake(self) -> None:
        """Makes ``until`` look at its condition now; call it from a callback."""
        if not self._future.done():
            self._future.set_result(None)

    def until(self, done: Callable[[], bool], each: Callable[[], None] = lambda: None) -> None:
        """Spins until ``done()``; ``each`` runs between slices of at most 0.1 s."""
        while not done():
            with suppress(InvalidHandle):  # an event of something that was taken off the graph meanwhile
                self._executor.spin_until_future_complete(self._future, _SLICE)
            if self._future.done():
                self._future = Future()
            each()


@contextmanager
def ros(args: Sequence[str] | None = None, domain_id: int | None = None) -> Iterator[Context]:
    """An initialised context of our own, without rclpy's signal handlers, shut down at the end.

    Raises:
        ConfigError: for a DDS domain that does not exist.
    """
    domain = os.environ.get("ROS_DOMAIN_ID", "") if domain_id is None else str(domain_id)
    if domain and not (domain.isdecimal() and int(domain) in _DOMAINS):
        raise ConfigError(f"ROS_DOMAIN_ID = {domain}: give a whole number from {_DOMAINS[0]} to {_DOMAINS[-1]}")
    _find_a_transport()
    context = Context()
    rclpy.init(
        args=list(args) if args is not None else None,
        context=context,
        domain_id=domain_id,
        signal_handler_options=SignalHandlerOptions.NO,
    )
    try:
        yield context
    finally:
        rclpy.try_shutdown(context=context)


def _find_a_transport() -> None:
    """Leaves shared memory alone where there is no room for it: DDS would end the process with a bus error."""
    with suppress(OSError):
        place = os.statvfs(_SHARED)
        if place.f_bavail * place.f_frsize < _ROOM and "FASTDDS_BUILTIN_TRANSPORTS" not in os.environ:
            os.environ["FASTDDS_BUILTIN_TRANSPORTS"] = "UDPv4"
            print(f"warning: no room in {_SHARED}, messages go over the network's loopback", file=sys.stderr)  # noqa: T201


@contextmanager
def on_signal(wake: Callable[[], None]) -> Iterator[list[int]]:
    """Collects SIGINT and SIGTERM in a list instead of dying, so that nodes can leave a defined command behind."""
    received: list[int] = []

    def handle(number: int, _frame: object) -> None:
        received.append(number)
        wake()

    before = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield received
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def run_node(factory: Callable[..., ManagedNode], args: Sequence[str] | None = None) -> int:
    """Runs one node as a process: start, spin until a signal or a fault, stop, clean exit.

    Args:
        factory: makes the node from keyword arguments (``context``).
        args: command line; ``--executor events|single`` is taken out, the rest goes to ROS.

    Returns:
        Exit code: 0 after a signal or when the node says that it is done, 1 after a configuration error or a fault.
    """
    argv = list(sys.argv[1:] if args is None else args)
    kind = "events"
    if "--executor" in argv:
        at = argv.index("--executor")
        kind = argv[at + 1] if at + 1 < len(argv) else ""
        del argv[at : at + 2]
    with threadpool_limits(limits=1), ExitStack() as stack:
        try:
            context = stack.enter_context(ros(argv))
            executor = make_executor(kind, context)
            node = factory(context=context)
        except (ConfigError, ValueError, OSError) as error:
            print(f"error: {error}", file=sys.stderr)  # noqa: T201
            return 1
        executor.add_node(node)
        spinner = Spinner(executor)
        with on_signal(spinner.wake) as signals:
            try:
                if node.p["autostart"]:
                    node.start()
                spinner.until(lambda: bool(signals) or bool(node.fault))
            except ConfigError as error:
                print(f"error: {error}", file=sys.stderr)  # noqa: T201
            drain = getattr(node, "drained", None)
            if drain is not None:
                spinner.until(drain)
            node.stop()
        failed = bool(node.fault)
        executor.shutdown()
        node.destroy_node()
    return int(failed)
