# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""`ros2-deepc analyze`: what recorded inputs and outputs prove about the plant."""

import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from ..bags.records import Recorded, load_records
from ..bags.run import PROPERTIES
from ..bags.style import PROPERTY, VERDICT
from ..monitors import Finding, Noise, Prior, Report, Verdict, analyze_records, estimate_structure, increments
from .bar import bar
from .plane import at_fault, draw_plane, in_words, speaks

PICTURES = (".png", ".svg", ".pdf")
COLOR = {Verdict.PROVED: "green", Verdict.NOT_PROVED: "yellow", Verdict.PRIOR_VIOLATED: "red"}


def analyze(
    data: Annotated[Path, typer.Argument(help="A run's folder, a bag, or a table (.csv, .tsv, .txt, .parquet).")],
    inputs: Annotated[
        list[str] | None, typer.Option("--input", help="Column, or /topic:field in bags of others; repeatable.")
    ] = None,
    outputs: Annotated[list[str] | None, typer.Option("--output", help="Likewise for the outputs; repeatable.")] = None,
    q: Annotated[int, typer.Option("-q", help="Order of the slow part, an upper bound; 0 = what the bag says.")] = 0,
    s: Annotated[int, typer.Option("-s", help="Index of nilpotency, an upper bound; 0 = what the bag says.")] = 0,
    n: Annotated[int, typer.Option("-n", help="State dimension, for the C-properties; 0 = what the bag says.")] = 0,
    noise: Annotated[
        str, typer.Option(help="Standard deviation of the output noise: one, one per output (1,2,...), or auto.")
    ] = "auto",
    form: Annotated[str, typer.Option(help="absolute, or incremental: for an unknown operating point.")] = "absolute",
    no_feedthrough: Annotated[
        bool, typer.Option("--no-feedthrough", help="D = 0: outputs do not see the inputs of their own sample.")
    ] = False,
    L: Annotated[int, typer.Option("-L", help="Block rows of the tests; 0 = looked for.")] = 0,
    time: Annotated[str, typer.Option(help="Tables: column with the time; uneven steps are gaps.")] = "",
    namespace: Annotated[str | None, typer.Option(help="Namespace of the plant, if the bag holds several.")] = None,
    printed: Annotated[bool, typer.Option("--printed", help="The paper's Theorems 1 to 4 as printed, too.")] = False,
    require: Annotated[
        list[str] | None, typer.Option(help="Exit code 1 unless this is PROVED, e.g. r_observability; repeatable.")
    ] = None,
    out: Annotated[
        list[Path] | None, typer.Option(help="Picture (.png, .svg, .pdf) or numbers (.json) to write; repeatable.")
    ] = None,
) -> None:
    """Say what recorded inputs and outputs prove: is the plant controllable, observable, and at which modes not?

    Gaps start a new record and cost no more than a few columns. Without -q the order is taken from the data, where only
    a lower bound of it can be seen: the verdicts then hold for what is seen.

    Examples:
      ros2-deepc analyze runs/today --out verdict.png
      ros2-deepc analyze scada.csv --input pump_1 --input pump_2 --output level -q 3 --form incremental --noise 0.002
      ros2-deepc analyze plc.mcap --input /cmd:data[0] --output /level:data -q 2 --require r_controllability
    """
    _refuse(require or [], out or [], form)
    console = Console()
    with bar(console, "reading") as progress:
        found = load_records(data, inputs or [], outputs or [], time=time, namespace=namespace, progress=progress)
    level, records = _noise(noise), list(found.records)
    if form == "incremental":
        records, level = increments(records, level)
    prior, seen = _prior(found, records, level, q, s, n, no_feedthrough)
    with console.status("analysing"):
        report = analyze_records(records, prior=prior, L=L or None, noise=level)
    title = found.plant or data.resolve().name
    _show(console, title, found, prior, report, from_data=seen)
    if printed:
        _show_printed(console, report)
    for path in out or []:
        _write(path, title, found, prior, report)
        console.print(f"  written: {path}", soft_wrap=True)
    if any(getattr(report, name).verdict != Verdict.PROVED for name in require or []):
        raise typer.Exit(1)


def _refuse(require: list[str], out: list[Path], form: str) -> None:
    """Wrong words, before anything is read."""
    for name in require:
        if name not in PROPERTIES:
            raise ValueError(f"--require {name}: one of {', '.join(PROPERTIES)}")
    for path in out:
        if path.suffix.lower() not in (*PICTURES, ".json"):
            raise ValueError(f"--out {path}: end it in {', '.join(PICTURES)} or .json")
    if form not in ("absolute", "incremental"):
        raise ValueError(f"--form {form}: one of absolute, incremental")


def _noise(text: str) -> Noise:
    if text == "auto":
        return Noise(estimated=True)
    try:
        levels = [float(part) for part in text.split(",")]
    except ValueError:
        raise ValueError(f"--noise {text}: write auto, one number, or one per output as 0.1,0.2") from None
    return Noise(std=levels if len(levels) > 1 else levels[0])


def _prior(
    found: Recorded, records: list[Any], noise: Noise, q: int, s: int, n: int, no_feedthrough: bool
) -> tuple[Prior, bool]:
    """The prior, and whether q is only what the data show."""
    q, s, n = q or found.q, s or found.s, n or found.n
    D = np.zeros((len(found.outputs), len(found.inputs))) if no_feedthrough else found.D
    if q:
        return Prior(q=q, s=max(s, 1), n=n, D=D), False
    u, y = max(records, key=lambda record: len(record[1]))
    seen = estimate_structure(u, y, noise=noise)
    if not seen.q:
        raise ValueError(
            f"the {len(y)} samples of the longest record show no order above the noise: give it with -q, or more data"
        )
    return Prior(q=seen.q, s=max(s, seen.s, 1), n=n, D=D), True


def _show(console: Console, title: str, found: Recorded, prior: Prior, report: Report, *, from_data: bool) -> None:
    gaps = f" in {len(found.records)} unbroken records" if len(found.records) > 1 else ""
    console.print(
        f"{title}: {found.samples} samples{gaps}, {len(found.inputs)} inputs, {len(found.outputs)} outputs; "
        f"noise {report.noise_source}",
        style="bold", highlight=False, markup=False, soft_wrap=True,
    )  # fmt: skip
    given = f"q = {prior.q}, s = {prior.s}" + (f", n = {prior.n}" if prior.n else "")
    if from_data:
        console.print(
            f"  prior taken from the data ({given}), which only show lower bounds: give -q and -s from physics",
            style="yellow", highlight=False, soft_wrap=True,
        )  # fmt: skip
    else:
        console.print(f"  prior {given}", highlight=False)
    table = Table(box=None, show_header=False, padding=(0, 1))
    for name in PROPERTIES:
        table.add_row(*_line(name, getattr(report, name)))
    console.print(table)
    for mode in at_fault(report):
        console.print(
            f"  mode at fault: λ = {in_words(mode.lambda_)}, {_place(mode.place)}", highlight=False, soft_wrap=True
        )
    estimate = report.estimate
    console.print(
        f"  seen: q >= {estimate.q}, s >= {max(estimate.s, 1)}, lag {estimate.lag}; rank {report.rank} of "
        f"{report.rank_need}; excitation order {report.excitation_order}; L = {report.L}, {report.columns} columns",
        highlight=False, soft_wrap=True,
    )  # fmt: skip


def _line(name: str, finding: Finding) -> tuple[Text, Text, Text, Text]:
    color = COLOR.get(finding.verdict, "bright_black")
    margin = f"{finding.margin:+.1f} dB" if speaks(finding) else ""
    word = VERDICT[finding.verdict.name].word
    return Text(PROPERTY[name]), Text(f"● {word}", style=color), Text(margin), Text(finding.reason, style="dim")


def _place(place: str) -> str:
    """What a mode that inputs do not move means for the plant."""
    return {
        "inside": "inside the unit circle: it decays by itself",
        "on": "on the unit circle, as far as noise tells: what it holds stays",
        "outside": "outside the unit circle: it grows, and no input stops it",
    }[place]


def _show_printed(console: Console, report: Report) -> None:
    for number, theorem in report.printed.items():
        word = f"holds: rank {theorem.rank}" if theorem.holds else f"does not hold: {theorem.reason}"
        console.print(
            f"  Theorem {number} as printed {word}",
            highlight=False, soft_wrap=True,
        )  # fmt: skip


def _write(path: Path, title: str, found: Recorded, prior: Prior, report: Report) -> None:
    if path.suffix.lower() == ".json":
        text = json.dumps(_plain(_numbers(found, prior, report)), indent=2, allow_nan=False)
        path.write_text(text + "\n", encoding="utf-8")
        return
    facts = f"{found.samples} samples   q = {prior.q}, s = {prior.s}   noise {report.noise_source}   L = {report.L}"
    draw_plane(report, path, title, facts)


def _numbers(found: Recorded, prior: Prior, report: Report) -> dict[str, Any]:
    """The report by name; in JSON what is not finite becomes null, a complex number [real, imaginary]."""
    return {
        "inputs": list(found.inputs),
        "outputs": list(found.outputs),
        "samples": [len(y) for _, y in found.records],
        "prior": {"q": prior.q, "s": prior.s, "n": prior.n, "D": prior.D},
        "noise": report.noise_source,
        **{
            name: {**asdict(getattr(report, name)), "verdict": getattr(report, name).verdict.name}
            for name in PROPERTIES
        },
        "modes": [asdict(mode) for mode in report.modes],
        "estimate": asdict(report.estimate),
        "rank": report.rank,
        "rank_need": report.rank_need,
        "excitation_order": report.excitation_order,
        "excitation_need": report.excitation_need,
        "L": report.L,
        "columns": report.columns,
    }


def _plain(value: Any) -> Any:
    """The same in what JSON knows."""
    if isinstance(value, dict):
        return {name: _plain(each) for name, each in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [_plain(each) for each in value]
    if isinstance(value, complex):
        return [_plain(value.real), _plain(value.imag)]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    return value
