# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""`ros2-deepc run`: a zone, or one node of it, until it is told to stop."""

import tempfile
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from ..dashboard import Dashboard
from ..demo import explained
from ..nodes.config import ROLES, load, merged, node_class, text_of, validate
from ..nodes.stack import running
from ..ros.parameters import ConfigError
from ..ros.run import EXECUTORS, on_signal, run_node
from .record import MaxDuration, MaxSize


def run(
    config: Annotated[Path, typer.Argument(help="YAML with the parameters of all nodes, as the launch files load it.")],
    role: Annotated[
        str,
        typer.Option(help="Only one node: plant, controller, monitor, operator or recorder. Default: all in the YAML."),
    ] = "",
    record: Annotated[Path | None, typer.Option(help="Record every topic into this folder.")] = None,
    max_size: MaxSize = 0.0,
    max_duration: MaxDuration = 0.0,
    namespace: Annotated[str, typer.Option(help="Namespace of the zone.")] = "/",
    executor: Annotated[str, typer.Option(help="events (fast) or single (the classic wait set).")] = "events",
    processes: Annotated[bool, typer.Option("--processes", help="One process a node instead of one for all.")] = False,
) -> None:
    """Run a zone until Ctrl-C, SIGTERM, or the end of a plant that has one.

    Without a plant in the YAML, the zone waits for one from elsewhere: your own node, or `ros2-deepc gateway`.

    Examples:
      ros2-deepc run zone.yaml --record today
      ros2-deepc run zone.yaml --role controller --namespace /grid
    """
    if executor not in EXECUTORS:
        raise ValueError(f"--executor {executor}: choose one of {', '.join(EXECUTORS)}")
    parameters = load(config)
    if record is not None:
        recorder = {"folder": str(record), "max_size": max_size, "max_duration": max_duration}
        parameters = merged(parameters, {"recorder": recorder})
    elif not role:
        parameters.pop("recorder", None)  # nothing said where to
    validate(parameters)
    if role:
        _one(role, parameters, namespace, executor)
        return
    title, steps = config.stem, 0
    if "plant" in parameters:
        info = node_class("plant").info(parameters["plant"])  # type: ignore[attr-defined]
        for name, values in parameters.items():
            node_class(name).check(values, info)
        title, steps = info.name, int(parameters["plant"].get("steps", 0))
    roles = [name for name in ("recorder", "monitor", "controller", "operator", "plant") if name in parameters]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "parameters.yaml"
        file.write_text(text_of(explained(parameters, Path(folder))), encoding="utf-8")
        with (
            running(roles, file, namespace=namespace, executor=executor, processes=processes) as stack,
            Dashboard(Console(), stack.observer, steps, title) as board,
            on_signal(stack.spinner.wake) as signals,
        ):
            seen = stack.observer

            def done() -> bool:
                ended = steps > 0 and seen.state is not None and seen.state.k >= steps - 1
                return bool(signals) or ended or bool(stack.failure())

            seen.on_change = lambda: stack.spinner.wake() if done() else None
            stack.spinner.until(done, board.draw)
            why = stack.failure()
            why = why or stack.finish()
    if why:
        raise RuntimeError(why)


def _one(role: str, parameters: dict[str, dict[str, object]], namespace: str, executor: str) -> None:
    if role not in ROLES:
        raise ConfigError(f"--role {role}: choose one of {', '.join(ROLES)}")
    with tempfile.NamedTemporaryFile("w", suffix=".yaml") as file:
        file.write(text_of(parameters))
        file.flush()
        arguments = ["--executor", executor, "--ros-args", "--params-file", file.name, "-r", f"__ns:={namespace}"]
        code = run_node(node_class(role), arguments)
    if code:
        raise typer.Exit(code)
