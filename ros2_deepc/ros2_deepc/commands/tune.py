# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""`ros2-deepc tune`: horizons, window and form from a recorded run, by prediction error on held-out stretches."""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
import yaml
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from ..bags.records import load_records
from ..control import DeepcSettings
from ..control.tune import Trial, Tuning
from ..control.tune import tune as search

SHOWN = 8  # best combinations that are listed


def tune(
    bag: Annotated[Path, typer.Argument(help="A run's folder, a bag, or a table (.csv, .tsv, .txt, .parquet).")],
    N: Annotated[list[int] | None, typer.Option("-N", help="Candidate for the past samples; repeatable.")] = None,
    L: Annotated[list[int] | None, typer.Option("-L", help="Candidate for the horizon; repeatable.")] = None,
    q: Annotated[list[int] | None, typer.Option("-q", help="Candidate for the order, 0 = all; repeatable.")] = None,
    T: Annotated[list[int] | None, typer.Option("-T", help="Candidate for the window, 0 = least; repeatable.")] = None,
    folds: Annotated[int, typer.Option(help="Held-out stretches.", min=1)] = 4,
    jobs: Annotated[int, typer.Option(help="Processes (more than one needs joblib).", min=1)] = 1,
    inputs: Annotated[
        list[str] | None, typer.Option("--input", help="Column, or /topic:field in bags of others; repeatable.")
    ] = None,
    outputs: Annotated[list[str] | None, typer.Option("--output", help="Likewise for the outputs; repeatable.")] = None,
    time: Annotated[str, typer.Option(help="Tables: column with the time; uneven steps are gaps.")] = "",
    namespace: Annotated[str | None, typer.Option(help="Namespace of the plant, if the bag holds several.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for the figure and the settings found.")] = None,
) -> None:
    """Choose N, L, q, T and the form of prediction by cross-validation on a recorded run.

    Each combination predicts stretches of the run that it has not seen, from the samples before them. Of those within
    2 % of the smallest error the simplest wins.

    Examples:
      ros2-deepc tune runs/today/bag --out tuned
      ros2-deepc tune plc.mcap --input /cmd:data[0] --output /level:data
      ros2-deepc tune scada.csv --input pump --output level --time time
    """
    found = load_records(bag, inputs or [], outputs or [], time=time, namespace=namespace)
    u, y = found.longest
    u, s = u[: len(y)], max(found.s, 1)
    grid = {name: tuple(values) for name, values in (("N", N), ("L", L), ("q", q), ("T", T)) if values}
    base = DeepcSettings(N=1, L=1, s=s, terminal="none")
    console = Console()
    with Progress(console=console, transient=True) as bar:
        task = bar.add_task("trying")

        def progress(done: int, total: int, _trial: Trial) -> None:
            bar.update(task, completed=done, total=total)

        tuned = search(u, y, base, folds=folds, jobs=jobs, progress=progress, **grid)  # type: ignore[arg-type]
    console.print(_table(tuned))
    chosen = {name: getattr(tuned.settings, name) for name in ("N", "L", "q", "T", "form")}
    console.print("  best: " + ", ".join(f"{name} = {value}" for name, value in chosen.items()))
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        (out / "controller.yaml").write_text(
            yaml.safe_dump({"/**/controller": {"ros__parameters": chosen}}, sort_keys=False), encoding="utf-8"
        )
        _draw(tuned, out / "tuning.png")
        console.print(f"  figure and settings: {out}", soft_wrap=True)


def _table(found: Tuning) -> Table:
    table = Table("N", "q", "T", "form", "error, all steps", "error, first step", box=None, padding=(0, 2))
    ranked = sorted((trial for trial in found.trials if np.isfinite(trial.error)), key=lambda trial: trial.error)
    for trial in ranked[:SHOWN]:
        first = f"{np.max(trial.first):.3g}" if len(trial.first) else "-"
        row = (trial.N, trial.q, trial.T, trial.form, f"{trial.error:.4g}", first)
        table.add_row(*map(str, row), style="bold" if trial == found.best else "")
    return table


def _draw(found: Tuning, path: Path) -> None:
    """Error over the prediction step: every combination thin, the chosen one thick, the naive prediction dashed."""
    figure = Figure(figsize=(8, 4.5), dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    axis = figure.add_subplot()
    for trial in found.trials:
        if len(trial.by_step):
            axis.plot(np.arange(1, len(trial.by_step) + 1), trial.by_step, color="0.8", linewidth=0.7)
    best = found.best
    label = f"N = {best.N}, q = {best.q}, T = {best.T}, {best.form}"
    axis.plot(np.arange(1, len(best.by_step) + 1), best.by_step, color="#0b5da2", linewidth=2.0, label=label)
    if len(found.naive):
        axis.plot(np.arange(1, len(found.naive) + 1), found.naive, "k--", linewidth=1.0, label="last value held")
    axis.axvline(found.settings.L, color="0.5", linewidth=0.8, linestyle=":")
    axis.set_yscale("log")
    axis.set_xlabel("prediction step [samples]")
    axis.set_ylabel("error [standard deviations]")
    axis.legend(frameon=False)
    figure.savefig(path)
