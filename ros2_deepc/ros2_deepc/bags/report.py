# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""A run as one self-contained HTML page: no network, no other files."""

import json
import os
from collections.abc import Iterable, Sequence
from html import escape
from importlib.resources import files
from typing import Any

import numpy as np
import yaml

from .check import Check, check
from .errors import check_target, write_text
from .events import Events
from .figure import seconds
from .panels import page_data
from .progress import Progress, no_progress
from .reader import BagReader
from .recording import Recording
from .run import PROPERTIES, VERDICTS, Reports, Run
from .spoken import spoken
from .style import PROPERTY, VERDICT
from .trends import Trends

PHASES = 12  # errors in one cell at most
SPOKEN = 200  # warnings and errors shown at most
SETTINGS = "settings.yaml"  # attachment with the parameters of the run, by node


def write_report(
    bag: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    namespace: str | None = None,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Writes the report of a bag; memory does not grow with its length.

    Args:
        bag: folder or file.
        out: the HTML file.
        namespace: of the plant; default the only one.
        progress: called now and then with what is done and what there is in all.

    Returns:
        The summary, see ``summarize``.

    Raises:
        BagError: if the bag cannot be read or the file cannot be written.
    """
    check_target(out)
    reader = BagReader(bag)
    total = max(reader.message_count, 1)

    def third(number: int) -> Progress:
        return lambda done, of: progress(round(total * (number + done / max(of, 1))), 3 * total)

    with Recording(reader, namespace, progress=third(0)) as recording:
        trends = Trends.of(recording, third(1))
    summary = trends.summary.result()
    checked = check(bag, progress=third(2))
    page = _page(trends, reader, summary, checked)
    write_text(out, page)
    return summary


def _page(trends: Trends, reader: BagReader, summary: dict[str, Any], checked: Check) -> str:
    here, run = files(__package__), trends.run
    title = " · ".join(filter(None, (run.plant or "run", run.variant)))
    data = json.dumps(page_data(trends), separators=(",", ":"), allow_nan=False).replace("</", "<\\/")
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
<div class="cards">{_cards(trends.reports_at_end, summary)}</div>
<h2>The run</h2>
<p class="hint">Drag to zoom, double-click for all, point to read values. Shaded: the controller is not in control.</p>
<noscript>The plots need JavaScript; the tables below do not.</noscript>
<div id="panels"></div>
<div class="columns">
<div><h2>Outputs</h2>{_outputs(run, summary)}</div>
<div><h2>Verdicts at the end</h2>{_verdicts(trends.reports_at_end)}</div>
</div>
<div class="columns">
<div><h2>Events</h2>{_events(trends.events)}</div>
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
    parts = [f"{run.total} samples"]
    if not np.isnan(run.sample_time):
        parts.append(f"one every {seconds(run.sample_time)}")
    if summary["seed"] is not None:
        parts.append(f"seed {summary['seed']}")
    return f"{escape(', '.join(parts))}; loop hash <code>{summary['loop_hash']}</code>"


def _warnings(checked: Check) -> str:
    errors = [f for f in checked.findings if f.level == "error"]
    return "".join(f'<p class="warn">{escape(f.where)}: {escape(f.text)}</p>' for f in errors[:10])


def _cards(reports: Reports, summary: dict[str, Any]) -> str:
    cards = []
    if len(reports.k):
        for j, name in enumerate(PROPERTIES):
            look = VERDICT[VERDICTS[reports.verdict[-1, j]]]
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
        rmse, more = values["rmse"][:PHASES], len(values["rmse"]) - PHASES
        words = ", ".join(map(_text, rmse)) + (f" and {more} more" if more > 0 else "")
        rows.append([name, unit, words, values["peak_to_peak"]])
    return _table(["output", "unit", "RMSE at the end of each reference", "peak to peak in control"], rows, (2, 3))


def _verdicts(reports: Reports) -> str:
    if not len(reports.k):
        return "<p>No monitor was recorded.</p>"
    rows = []
    for j, name in enumerate(PROPERTIES):
        look = VERDICT[VERDICTS[reports.verdict[-1, j]]]
        margin = reports.margin[-1, j]
        rows.append([PROPERTY[name], look.word, "–" if np.isnan(margin) else f"{margin:.4g} dB", reports.reason[j]])
    return _table(["property", "verdict", "margin", "why"], rows)


def _events(events: Events) -> str:
    rows = [[epoch, k, seconds(t), words] for epoch, k, t, words in events.first]
    more = f"<p>and {events.count - len(rows)} more</p>" if events.count > len(rows) else ""
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
