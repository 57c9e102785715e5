# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""All nodes of a zone, in one process or in one process each."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from rclpy.context import Context
from rclpy.executors import Executor
from threadpoolctl import threadpool_limits

from ..ros.lifecycle import ManagedNode
from ..ros.parameters import ConfigError
from ..ros.run import Spinner, make_executor, ros
from .config import node_class
from .observer import Observer

_STOP_SECONDS = 30.0


@dataclass
class Stack:
    """A running zone.

    Attributes:
        observer: sees what goes over the topics.
        executor: of this process, with the observer on it.
        spinner: runs this process's share of it.
        failure: one line on why a node gave up; empty while all is well.
        finish: stops all nodes, the recorder last, once everything published has been written; returns one line on
            what went wrong without ending the loop, such as a full disk, empty if nothing did.
    """

    observer: Observer
    executor: Executor
    spinner: Spinner
    failure: Callable[[], str]
    finish: Callable[[], str]


@contextmanager
def running(
    roles: Sequence[str],
    params_file: Path,
    *,
    namespace: str,
    executor: str = "events",
    processes: bool = False,
    domain_id: int | None = None,
    log_level: str = "warn",
) -> Iterator[Stack]:
    """Starts the nodes of ``roles`` and stops them at the end.

    Args:
        roles: which nodes, in the order in which they are started.
        params_file: ROS parameter file for all of them.
        namespace: of the zone.
        executor: "events" or "single".
        processes: one process a node instead of this one for all; they log beside ``params_file``.
        domain_id: DDS domain, None = ROS_DOMAIN_ID.
        log_level: of the nodes.

    Raises:
        ConfigError: if a node cannot be configured.
    """
    with ExitStack() as cleanup:
        cleanup.enter_context(threadpool_limits(limits=1))
        context = cleanup.enter_context(ros(["--ros-args", "--log-level", log_level], domain_id))
        spin = make_executor(executor, context)
        spinner = Spinner(spin)
        observer = Observer(context=context, namespace=namespace, use_global_arguments=False)
        spin.add_node(observer)
        cleanup.callback(observer.destroy_node)
        cleanup.callback(spin.shutdown)
        arguments = ["--ros-args", "--log-level", log_level, "--params-file", str(params_file)]
        arguments += ["-r", f"__ns:={namespace}"]
        if processes:
            zone = _Processes(roles, arguments, executor, domain_id, params_file.parent)
        else:
            zone = _InProcess(roles, arguments, context, spin, spinner)
        cleanup.callback(zone.finish)
        zone.start()
        yield Stack(observer, spin, spinner, zone.failure, zone.finish)


class _InProcess:
    """Nodes in this process, on one executor."""

    def __init__(
        self, roles: Sequence[str], arguments: list[str], context: Context, executor: Executor, spinner: Spinner
    ) -> None:
        self._spinner = spinner
        self._executor = executor
        self._nodes: list[ManagedNode] = []
        try:
            for role in roles:
                self._nodes.append(node_class(role)(context=context, cli_args=arguments, use_global_arguments=False))
        except ConfigError:
            for node in self._nodes:
                node.destroy_node()
            raise

    def start(self) -> None:
        for node in self._nodes:
            self._executor.add_node(node)
            node.start()

    def failure(self) -> str:
        return next((node.fault for node in self._nodes if node.fault), "")

    def finish(self) -> str:
        for node in self._nodes:
            if not hasattr(node, "drained"):
                node.quiesce()
        for node in self._nodes:
            if hasattr(node, "drained") and not node.fault:
                self._spinner.until(node.drained)
        self._executor.shutdown()  # nothing may be taken off the graph while an executor still looks at it
        for node in self._nodes:
            node.stop()
        trouble = self.failure()
        for node in self._nodes:
            node.destroy_node()
        self._nodes.clear()
        return trouble


class _Processes:
    """Nodes in processes of their own; each logs to a file."""

    def __init__(
        self, roles: Sequence[str], arguments: list[str], executor: str, domain_id: int | None, logs: Path
    ) -> None:
        self._roles, self._arguments, self._executor, self._logs = roles, arguments, executor, logs
        self._env = dict(os.environ)
        if domain_id is not None:
            self._env["ROS_DOMAIN_ID"] = str(domain_id)
        self._children: dict[str, subprocess.Popen[bytes]] = {}

    def start(self) -> None:
        for role in self._roles:
            module = node_class(role).__module__
            command = [sys.executable, "-m", module, "--executor", self._executor, *self._arguments]
            with self._log(role).open("wb") as log:
                # A session of its own: Ctrl-C reaches this process only, which stops the recorder last.
                self._children[role] = subprocess.Popen(
                    command, env=self._env, stdout=log, stderr=log, start_new_session=True
                )

    def failure(self) -> str:
        for role, child in self._children.items():
            if child.poll() is not None:
                return self._last_words(role, child) or f"the {role} process ended"
        return ""

    def _last_words(self, role: str, child: "subprocess.Popen[bytes]") -> str:
        """How an ended process failed; empty if it did not."""
        if not child.returncode:
            return ""
        lines = self._log(role).read_text(encoding="utf-8", errors="replace").strip().splitlines()
        return f"the {role} process ended with code {child.returncode}: {lines[-1] if lines else 'no message'}"

    def finish(self) -> str:
        trouble = ""
        for role in sorted(self._children, key=lambda r: r == "recorder"):
            child = self._children[role]
            child.terminate()
            try:
                child.wait(timeout=_STOP_SECONDS)
            except subprocess.TimeoutExpired:
                child.kill()
                child.wait()
            if child.returncode != -signal.SIGTERM:  # that is one who had not begun to work yet
                trouble = trouble or self._last_words(role, child)
        self._children.clear()
        return trouble

    def _log(self, role: str) -> Path:
        return self._logs / f"{role}.log"
