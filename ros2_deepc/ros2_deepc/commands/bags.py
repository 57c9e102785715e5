# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Commands that work on a recorded bag: report, check, export, layout."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from ..bags.check import check as check_bag
from ..bags.check import repair
from ..bags.errors import BagError, check_target, write_text
from ..bags.export import check_format
from ..bags.export import export as export_run
from ..bags.layouts import foxglove, panels, plotjuggler
from ..bags.reader import BagReader
from ..bags.recording import Recording, find_namespace
from ..bags.report import write_report
from .bar import bar
from .demo import print_summary

Bag = Annotated[Path, typer.Argument(help="Folder of the bag, or one .mcap file.")]
Zone = Annotated[str | None, typer.Option("--namespace", help="Namespace of the plant, if the bag holds several.")]
Out = Annotated[Path | None, typer.Option(help="File to write.")]


def report(bag: Bag, out: Out = None, namespace: Zone = None) -> None:
    """Write one self-contained HTML page about a run: trends, verdicts, timing, faults, settings.

    Example:
      ros2-deepc report runs/today/bag --out today.html
    """
    out = out or Path(f"{bag.resolve().name}.html")
    console = Console()
    with bar(console, "reading") as progress:
        summary = write_report(bag, out, namespace=namespace, progress=progress)
    print_summary(console, summary)
    console.print(f"  report: {out}", soft_wrap=True)


def check(
    bag: Bag, fixed: Annotated[Path | None, typer.Option("--repair", help="New bag for what can be repaired.")] = None
) -> None:
    """Look for gaps, duplicates, clock jumps, refused samples, missing topics and damage; exit code 1 if any matter.

    Repairs into a new bag, never in place.
    """
    console = Console()
    with bar(console, "reading") as progress:
        found = repair(bag, fixed) if fixed is not None else check_bag(bag, progress=progress)
    for finding in found.findings:
        console.print(str(finding), soft_wrap=True, highlight=False, markup=False)
    console.print(f"{found.messages} messages, {'nothing that matters found' if found.ok else 'see above'}")
    if fixed is not None:
        console.print(f"repaired bag: {fixed}", soft_wrap=True)
    if not found.ok:
        raise typer.Exit(1)


def export(
    bag: Bag,
    out: Annotated[Path, typer.Option(help="File to write: .csv, .parquet, .json, .png, .svg or .pdf.")],
    namespace: Zone = None,
) -> None:
    """Export a run: samples as CSV or Parquet, the figure as PNG, the summary as JSON.

    Example:
      ros2-deepc export runs/today/bag --out today.csv
    """
    console = Console()
    check_format(out)
    check_target(out)
    with bar(console, "reading") as progress:
        recording = Recording(bag, namespace, progress=progress)
    with recording, bar(console, "writing") as progress:
        export_run(recording, out, progress=progress)
    console.print(f"{len(recording)} samples: {out}", soft_wrap=True)


def layout(
    bag: Bag,
    out: Annotated[Path, typer.Option(help="File to write: .json for Foxglove, .xml for PlotJuggler.")],
    namespace: Zone = None,
) -> None:
    """Write a viewer layout for a bag's outputs and inputs.

    Example:
      ros2-deepc layout runs/today/bag --out today.json
    """
    writers = {".json": foxglove, ".xml": plotjuggler}
    if out.suffix not in writers:
        raise BagError(f"--out {out}: end it in .json (Foxglove) or .xml (PlotJuggler)")
    check_target(out)
    reader = BagReader(bag)
    prefix = find_namespace(reader, namespace)
    with Recording(reader, namespace) as recording:
        run = next(recording.stretches())
    write_text(out, writers[out.suffix](panels(run.output_names, run.input_names), prefix))
    Console().print(f"layout: {out}", soft_wrap=True)
