# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The command line `ros2-deepc`."""

import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

app = typer.Typer(
    help="Online data-enabled predictive control and proofs from data, on ROS 2.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


@app.callback()
def _top() -> None:
    """Makes every command a subcommand, however few there are."""


@app.command()
def demo(
    plant: Annotated[str, typer.Argument(help="Which plant: wscc9 (9-bus grid) or net3 (water network).")] = "wscc9",
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
      ros2-deepc demo net3 --seed 3 --out /tmp/net3
      ros2-deepc demo wscc9 -o variant=full
    """
    from . import demo as runner
    from .nodes.config import load, merged, shipped
    from .ros.run import EXECUTORS

    console = Console()
    if executor not in EXECUTORS:
        raise ValueError(f"--executor {executor}: choose one of {', '.join(EXECUTORS)}")
    parameters = load(shipped(plant))
    plant_changes: dict[str, object] = {"seed": seed}
    if steps is not None:
        plant_changes["steps"] = steps
    if option:
        plant_changes["options"] = option
    parameters = merged(parameters, {"plant": plant_changes, "controller": {"seed": seed}})
    parameters = merged(parameters, _changes(changes or []))
    out = out or Path("runs") / f"{datetime.now(tz=UTC).strftime('%Y%m%dT%H%M%S')}-{plant}"
    options = runner.Options(out=out, namespace=f"/{plant}", executor=executor, processes=processes)
    summary = runner.run(parameters, options, console)
    _print_summary(console, summary, out)


def _changes(texts: list[str]) -> dict[str, dict[str, object]]:
    """NODE.PARAMETER=VALUE strings by node; values are read as YAML."""
    import yaml

    from .nodes.config import ROLES

    changes: dict[str, dict[str, object]] = {}
    for text in texts:
        path, equals, value = text.partition("=")
        role, dot, name = path.partition(".")
        if not (equals and dot and name and role in ROLES):
            raise ValueError(f"--set {text}: write NODE.PARAMETER=VALUE with NODE one of {', '.join(ROLES)}")
        changes.setdefault(role, {})[name] = yaml.safe_load(value)
    return changes


def _print_summary(console: Console, summary: dict, out: Path) -> None:  # type: ignore[type-arg]
    table = Table(
        "output", "RMSE of the last 20 samples of each reference", "peak to peak in control", box=None, padding=(0, 2)
    )
    for name, values in summary["outputs"].items():
        rmse = ", ".join(f"{value:.4g}" for value in values["rmse"])
        table.add_row(name, rmse, "-" if values["peak_to_peak"] is None else f"{values['peak_to_peak']:.4g}")
    console.print(table)
    for name, verdict in summary["verdicts"].items():
        console.print(f"  {name}: {verdict}")
    controller = summary["controller"]
    times = controller["solve_time_ms"]
    if times["median"] is not None:
        console.print(f"  solve time {times['median']:.2f} ms median, {times['p99']:.2f} ms p99")
    console.print(f"  {controller['failures']} failures")
    console.print(f"  figure, bag and summary: {out}", soft_wrap=True)


def main() -> int:
    """Console script; every expected error is one line on stderr and exit code 1 (2 for wrong usage)."""
    try:
        app(standalone_mode=False)
    except typer.Exit as stop:
        return int(stop.exit_code)
    except typer.Abort:
        return 130
    except (ValueError, OSError, RuntimeError) as error:
        print(f"error: {error}", file=sys.stderr)  # noqa: T201
        return 1
    except Exception as error:
        show = getattr(error, "show", None)  # click's usage errors explain themselves
        if show is None:
            raise
        show()
        return int(getattr(error, "exit_code", 2))
    return 0
