# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""One run from start to finish: start a zone, record it, draw and sum it up."""

import json
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from .bags.reader import BagReader
from .bags.recording import Recording
from .bags.summary import summarize
from .dashboard import Dashboard
from .nodes.config import Parameters, merged, node_class, text_of, validate
from .nodes.recorder_node import FIGURE
from .nodes.stack import Stack, running
from .ros.parameters import ConfigError

SETTINGS = "settings.yaml"  # what was asked for, also kept in the bag; a run can be repeated from it
_STARTED = "parameters.yaml"  # what the nodes were started with: the same, with folders and readers
_ROLES = ("recorder", "monitor", "controller", "operator", "plant")
_SILENCE = 60.0  # [s] without any message before a run counts as stuck
_READERS = {
    "plant": {"readers": 4},  # controller, monitor, recorder, observer
    "controller": {"readers_inputs": 3, "readers_state": 2},  # plant, monitor, recorder; recorder, observer
    "monitor": {"readers": 2},  # recorder, observer
    "operator": {"readers": 2},  # controller, recorder
}


class RunError(RuntimeError):
    """A run that did not reach its end; the message is one line."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """How to run.

    Attributes:
        out: folder for everything the run leaves behind; made here, must be empty.
        namespace: of the zone.
        executor: "events" or "single".
        processes: one process a node.
        domain_id: DDS domain, None = ROS_DOMAIN_ID.
    """

    out: Path
    namespace: str
    executor: str = "events"
    processes: bool = False
    domain_id: int | None = None


def run(parameters: Parameters, options: Options, console: Console) -> dict[str, Any]:
    """Runs a zone in lockstep to its last sample and leaves a bag, a figure and a summary in ``options.out``.

    Returns:
        The summary, as written to summary.json.

    Raises:
        ConfigError: if the parameters cannot work (nothing is written then).
        RunError: if the run did not reach its end; the folder then holds a file FAILED that says why.
        OSError: if the folder cannot be written.
    """
    validate(parameters)
    steps = parameters["plant"].get("steps", 0)
    if steps < 1:
        raise ConfigError("plant: a run that is summed up needs steps >= 1")
    info = node_class("plant").info(parameters["plant"])  # type: ignore[attr-defined]
    for role, values in parameters.items():
        node_class(role).check(values, info)
    out = _fresh(options.out)
    changes = {"recorder": {"folder": str(out / "bag"), "figure": True}, "monitor": {"log": str(out / "verdicts")}}
    parameters = merged(merged(explained(parameters, out), changes), _READERS)
    (out / _STARTED).write_text(text_of(parameters), encoding="utf-8")
    try:
        _to_the_end(parameters, steps, info.name, options, console, out)
        return _harvest(out)
    except Exception as error:
        with suppress(OSError):  # a full disk may be why
            (out / "FAILED").write_text(f"{error}\n", encoding="utf-8")
        raise


def _to_the_end(parameters: Parameters, steps: int, name: str, options: Options, console: Console, out: Path) -> None:
    period = parameters["monitor"].get("period", 10)
    last_report = steps // period * period - 1
    with (
        running(
            _ROLES,
            out / _STARTED,
            namespace=options.namespace,
            executor=options.executor,
            processes=options.processes,
            domain_id=options.domain_id,
        ) as stack,
        Dashboard(console, stack.observer, steps, name) as board,
    ):
        seen = stack.observer

        def done() -> bool:
            reported = last_report < 0 or (seen.report is not None and seen.report.k >= last_report)
            return bool(stack.failure()) or (reported and seen.state is not None and seen.state.k >= steps - 1)

        seen.on_change = lambda: stack.spinner.wake() if done() else None
        watch = _Watch(stack)

        def between() -> None:
            board.draw()
            watch.look()

        stack.spinner.until(done, between)
        trouble = stack.failure()
        trouble = trouble or stack.finish()
        if trouble:
            raise RunError(trouble)


class _Watch:
    """Raises when nothing has happened for too long."""

    def __init__(self, stack: Stack) -> None:
        self._stack = stack
        self._seen, self._since = -1, time.monotonic()

    def look(self) -> None:
        observer, now = self._stack.observer, time.monotonic()
        if observer.messages != self._seen:
            self._seen, self._since = observer.messages, now
        elif now - self._since > _SILENCE:
            k = "none" if observer.state is None else observer.state.k
            raise RunError(f"nothing was published for {_SILENCE:.0f} s; last sample controlled: {k}")


def _fresh(out: Path) -> Path:
    """Makes the folder of the run.

    Raises:
        OSError: with a message that says what to do.
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise OSError(f"{out} exists and is not an empty folder: choose another one with --out")
    try:
        out.mkdir(parents=True, exist_ok=True)
        probe = out / ".probe"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise OSError(f"cannot write to {out}: {error.strerror}; choose another folder with --out") from None
    return out


def explained(parameters: Parameters, folder: Path) -> Parameters:
    """Parameters whose recorder keeps, in the bag, what the run was started with; nothing of the machine.

    Args:
        parameters: of all nodes; without a recorder they stay as they are.
        folder: where the file to be kept is written.
    """
    if "recorder" not in parameters:
        return parameters
    local = {"recorder": ("folder", "attach", "metadata"), "monitor": ("log",)}
    portable = {
        role: {name: value for name, value in values.items() if name not in local.get(role, ())}
        for role, values in parameters.items()
    }
    (folder / SETTINGS).write_text(text_of(portable), encoding="utf-8")
    facts = {name: parameters.get("plant", {}).get(name) for name in ("plant", "seed", "steps")}
    facts["parameters"] = text_of(portable)
    given = parameters["recorder"]
    kept = {
        "attach": [*filter(None, given.get("attach", ())), str(folder / SETTINGS)],
        "metadata": [
            *(f"{name}={value}" for name, value in facts.items() if value is not None),
            *filter(None, given.get("metadata", ())),
        ],
    }
    return merged(parameters, {"recorder": kept})


def _harvest(out: Path) -> dict[str, Any]:
    """Figure and summary, from the bag alone."""
    reader = BagReader(out / "bag")
    with Recording(reader) as recording:
        summary = summarize(recording)
    (out / FIGURE).write_bytes(next(a.data for a in reader.attachments() if a.name == FIGURE))
    (out / "summary.json").write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    return summary
