# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""`ros2-deepc demo`: one run from start to finish."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import typer
import yaml
from rich.console import Console
from rich.table import Table

from .. import demo as runner
from ..nodes.config import ROLES, merged
from ..nodes.suggested import title_of, zone_of
from ..ros.run import EXECUTORS

_PHASES = 6  # errors that are listed of each output


def demo(
    plant: Annotated[
        str, typer.Argument(help="Which plant: wscc9 (9-bus grid), net3 (water network), ..., or a plant's YAML file.")
    ] = "wscc9",
    out: Annotated[
        Path | None, typer.Option(help="Folder for bag, figure and summary. Default: runs/<time>-<plant>.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the initial state and of the excitation.", min=0)] = 0,
    steps: Annotated[
        int | None, typer.Option(help="Run length in samples. Default: what the plant's YAML says.", min=1)
    ] = None,
    option: Annotated[
        list[str] | None, typer.Option("--option", "-o", help="Option of the plant, e.g. variant=full; repeatable.")
    ] = None,
    changes: Annotated[
        list[str] | None, typer.Option("--set", "-s", help="Parameter of a node, e.g. controller.T=150; repeatable.")
    ] = None,
    executor: Annotated[str, typer.Option(help="events (fast) or single (the classic wait set).")] = "events",
    processes: Annotated[bool, typer.Option("--processes", help="One process a node instead of one for all.")] = False,
) -> None:
    """Control a plant from its own live data, record everything, draw it and sum it up.

    Starts plant, controller, monitor, operator and recorder on real DDS in lockstep. The same seed gives the same bits
    with either executor and with --processes.

    Examples:
      ros2-deepc demo
      ros2-deepc demo net3 --seed 3 --out net3-run
      ros2-deepc demo wscc9 -o variant=full
      ros2-deepc demo my_grid.yaml --steps 300
    """
    if executor not in EXECUTORS:
        raise ValueError(f"--executor {executor}: choose one of {', '.join(EXECUTORS)}")
    plant_changes: dict[str, Any] = {"seed": seed}
    if steps is not None:
        plant_changes["steps"] = steps
    parameters = merged(zone_of(plant, option), {"plant": plant_changes, "controller": {"seed": seed}})
    parameters = merged(parameters, parse_changes(changes or []))
    out = out or Path("runs") / f"{datetime.now(tz=UTC).strftime('%Y%m%dT%H%M%S')}-{title_of(plant)}"
    options = runner.Options(out=out, namespace=f"/{title_of(plant)}", executor=executor, processes=processes)
    console = Console()
    print_summary(console, runner.run(parameters, options, console))
    console.print(f"  figure, bag and summary: {out}", soft_wrap=True)


def parse_changes(texts: list[str]) -> dict[str, dict[str, Any]]:
    """NODE.PARAMETER=VALUE strings by node; values are read as YAML.

    Raises:
        ValueError: for a string of another form.
    """
    changes: dict[str, dict[str, Any]] = {}
    for text in texts:
        path, equals, value = text.partition("=")
        role, dot, name = path.partition(".")
        if not (equals and dot and name and role in ROLES):
            raise ValueError(f"--set {text}: write NODE.PARAMETER=VALUE with NODE one of {', '.join(ROLES)}")
        changes.setdefault(role, {})[name] = yaml.safe_load(value)
    return changes


def print_summary(console: Console, summary: dict[str, Any]) -> None:
    """A summary as a person reads it."""
    table = Table("output", "RMSE, last 20 samples of each reference", "peak to peak in control", box=None)
    table.padding = (0, 2)
    for name, values in summary["outputs"].items():
        rmse, more = values["rmse"][:_PHASES], len(values["rmse"]) - _PHASES
        words = ", ".join(map(_number, rmse)) + (f" and {more} more" if more > 0 else "")
        table.add_row(name, words, _number(values["peak_to_peak"]))
    console.print(table)
    for name, verdict in summary["verdicts"].items():
        if verdict is not None:  # a monitor was recorded
            console.print(f"  {name}: {verdict}")
    controller = summary["controller"]
    times = controller["solve_time_ms"]
    if times["median"] is not None:
        console.print(f"  solve time {times['median']:.2f} ms median, {times['p99']:.2f} ms p99")
    if controller["failures"] is not None:
        console.print(f"  {controller['failures']} failures")


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"
