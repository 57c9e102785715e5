# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""A run as one self-contained HTML page: no network, no other files."""

import json
import os
from collections.abc import Iterable, Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from .check import Check, check
from .errors import BagError, why
from .figure import seconds
from .panels import events, page_data
from .progress import Progress, no_progress
from .reader import BagReader
from .run import PROPERTIES, VERDICTS, Run, load_run
from .spoken import spoken
from .style import PROPERTY, VERDICT
from .summary import summarize

SPOKEN = 200  # warnings and errors shown at most
SETTINGS = "settings.yaml"  # attachment with the parameters of the run, by node


def write_report(
    bag: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    namespace: str | None = None,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Writes the report of a bag.

    Args:
        bag: folder or file.
        out: the HTML file.
        namespace: of the plant; default the only one.
        progress: called now and then with messages done and in all; every message is read twice.

    Returns:
        The summary, see ``summarize``.

    Raises:
        BagError: if the bag cannot be read or the file cannot be written.
    """
    reader = BagReader(bag)
    run = load_run(reader, namespace, progress=lambda done, total: progress(done, 2 * total))
    summary = summarize(run)
    checked = check(bag, progress=lambda done, total: progress(total + done, 2 * total))
    page = _page(run, reader, summary, checked)
    try:
        Path(out).write_text(page, encoding="utf-8")
    except OSError as error:
        raise BagError(f"cannot write {out}: {why(error)}") from error
    return summary


def _page(run: Run, reader: BagReader, summary: dict[str, Any], checked: Check) -> str:
    here = files(__package__)
    title = " · ".join(filter(None, (run.plant or "run", run.variant)))
    data = json.dumps(page_data(run), separators=(",", ":"), allow_nan=False).replace("</", "<\\/")
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<link rel="icon" href="data:,">
<title>{escape(title)}</title>
<style>
{here.joinpath("report.css").read_text(encoding="utf-8")}</style>
</head>
<body>
<h1>{escape(title)}</h1>
<p class="facts">{_facts(run, summary)}</p>
{_warnings(checked)}
<div class="cards">{_cards(run, summary)}</div>
<h2>The run</h2>
<p class="hint">Drag to zoom, double-click for all, point to read values. Shaded: the controller is not in control.</p>
<noscript>The plots need JavaScript; the tables below do not.</noscript>
<div id="panels"></div>
<div class="columns">
<div><h2>Outputs</h2>{_outputs(run, summary)}</div>
<div><h2>Verdicts at the end</h2>{_verdicts(run)}</div>
</div>
<div class="columns">
<div><h2>Events</h2>{_events(run)}</div>
<div><h2>Warnings and errors of the nodes</h2>{_spoken(reader)}</div>
</div>
<div class="columns">
<div><h2>Settings</h2>{_settings(run, reader)}</div>
<div><h2>Recording</h2>{_recording(run, reader, checked)}</div>
</div>
<script id="data" type="application/json">{data}</script>
<script>
{here.joinpath("report.js").read_text(encoding="utf-8")}</script>
</body>
</html>
"""


def _facts(run: Run, summary: dict[str, Any]) -> str:
    parts = [f"{len(run)} samples"]
    if not np.isnan(run.sample_time):
        parts.append(f"one every {seconds(run.sample_time)}")
    if summary["seed"] is not None:
        parts.append(f"seed {summary['seed']}")
    return f"{escape(', '.join(parts))}; loop hash <code>{summary['loop_hash']}</code>"


def _warnings(checked: Check) -> str:
    errors = [f for f in checked.findings if f.level == "error"]
    return "".join(f'<p class="warn">{escape(f.where)}: {escape(f.text)}</p>' for f in errors[:10])


def _cards(run: Run, summary: dict[str, Any]) -> str:
    cards = []
    if len(run.reports.k):
        for j, name in enumerate(PROPERTIES):
            look = VERDICT[VERDICTS[run.reports.verdict[-1, j]]]
            fill = look.fill if look.fill != "#ffffff" else "#9aa0a6"
            cards.append(
                f'<div class="card light" style="--look:{fill}"><b>{look.word}</b><span>{PROPERTY[name]}</span></div>'
            )
    times = summary["controller"]["solve_time_ms"]
    if times["median"] is not None:
        cards.append(_card(f"{times['median']:.2f} ms", f"solve time, median; 99 %: {times['p99']:.2f} ms"))
    if summary["controller"]["failures"] is not None:
        cards.append(_card(str(summary["controller"]["failures"]), "samples without an optimum while in control"))
    return "".join(cards)


def _card(value: str, words: str) -> str:
    return f'<div class="card"><b>{escape(value)}</b><span>{escape(words)}</span></div>'


def _table(head: Sequence[str], rows: Iterable[Sequence[Any]], numeric: Sequence[int] = (), kind: str = "") -> str:
    """An HTML table; cells are escaped, the given columns right-aligned."""

    def line(tag: str, cells: Sequence[Any]) -> str:
        inner = (
            f"<{tag}{' class=number' if i in numeric else ''}>{escape(_text(c))}</{tag}>" for i, c in enumerate(cells)
        )
        return f"<tr>{''.join(inner)}</tr>"

    return f"<table class='{kind}'>{line('th', head)}{''.join(line('td', row) for row in rows)}</table>"


def _text(value: Any) -> str:
    if value is None or (isinstance(value, float) and np.isnan(value)):
        return "–"
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def _outputs(run: Run, summary: dict[str, Any]) -> str:
    rows = []
    for name, unit in zip(run.output_names, run.output_units, strict=True):
        values = summary["outputs"][name]
        rows.append([name, unit, ", ".join(map(_text, values["rmse"])), values["peak_to_peak"]])
    return _table(["output", "unit", "RMSE at the end of each reference", "peak to peak in control"], rows, (2, 3))


def _verdicts(run: Run) -> str:
    reports = run.reports
    if not len(reports.k):
        return "<p>No monitor was recorded.</p>"
    rows = []
    for j, name in enumerate(PROPERTIES):
        look = VERDICT[VERDICTS[reports.verdict[-1, j]]]
        margin = reports.margin[-1, j]
        rows.append([PROPERTY[name], look.word, "–" if np.isnan(margin) else f"{margin:.4g} dB", reports.reason[j]])
    return _table(["property", "verdict", "margin", "why"], rows)


def _events(run: Run) -> str:
    found = events(run)
    rows = [[epoch, k, seconds(t), words] for epoch, k, t, words in found[:300]]
    more = f"<p>and {len(found) - 300} more</p>" if len(found) > 300 else ""
    return _table(["epoch", "k", "time", "what"], rows, (0, 1, 2), "narrow") + more if rows else "<p>None.</p>"


def _spoken(reader: BagReader) -> str:
    rows = spoken(reader, SPOKEN)
    table = _table(["time", "node", "level", "what"], [[f"{t:.3f} s", *rest] for t, *rest in rows], (0,), "narrow")
    more = f"<p>The first {SPOKEN}; all are in the bag.</p>" if len(rows) == SPOKEN else ""
    return table + more if rows else "<p>None.</p>"


def _settings(run: Run, reader: BagReader) -> str:
    text = next((a.data.decode("utf-8", "replace") for a in reader.attachments() if a.name == SETTINGS), "")
    rows: list[list[Any]] = []
    try:
        for node, body in (yaml.safe_load(text) or {}).items():
            rows += [[node.rsplit("/", 1)[-1], name, value] for name, value in body.get("ros__parameters", {}).items()]
    except (yaml.YAMLError, AttributeError):
        rows = [["", SETTINGS, text]]
    rows += [["bag", name, value] for name, value in run.metadata.items() if name != "parameters"]  # stand above
    limits = zip(run.input_names, run.input_min, run.input_max, strict=True)
    rows += [["plant", f"limits of {name}", f"{low:.6g} .. {high:.6g}"] for name, low, high in limits]
    rows += [["plant", name, value] for name, value in run.prior.items() if value]
    return _table(["of", "name", "value"], rows)


def _recording(run: Run, reader: BagReader, checked: Check) -> str:
    rows: list[list[Any]] = [[t.name, t.type, t.count] for t in sorted(reader.topics.values(), key=lambda t: t.name)]
    size = sum(f.stat().st_size for f in reader.files)
    state = "complete" if reader.complete else "not complete"
    lost = f"; {checked.lost_bytes} bytes lost" if checked.lost_bytes else ""
    notes = "".join(f"<li>{escape(str(f))}</li>" for f in checked.findings[:30])
    facts = f"{len(reader.files)} file(s), {size / 1e6:.3g} MB, {checked.messages} messages, {state}{lost}"
    repeated = f", {run.duplicates} repeated samples" if run.duplicates else ""
    return _table(["topic", "type", "messages"], rows, (2,)) + f"<p>{facts}{repeated}.</p><ul>{notes}</ul>"
