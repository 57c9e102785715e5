# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""What a report shows of a run, as plain data for the page's script."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .figure import sample_axis, verdict_words
from .run import MODES, NO_MODE, PROPERTIES, VERDICTS, Array, Run
from .stretches import stretches, thin
from .style import INPUTS, MODE, OUTPUT, PROPERTY, REFERENCE, VERDICT

MAX_LINES = 8  # in one panel


def page_data(run: Run) -> dict[str, Any]:
    """Panels, bands and looks of a run; numbers with seven digits, at most some 4000 points a line."""
    x, label = sample_axis(run)
    panels = [*_output_panels(run, x), _input_panel(run, x)]
    panels += [
        p for p in (_verdict_panel(run, x), _solve_panel(run, x), _data_panel(run, x), _steady_panel(run, x)) if p
    ]
    return {
        "range": [float(x[0]), float(x[-1] + 1)],
        "label": label,
        "bands": [[a, b, MODE[m].fill] for a, b, m in _modes(run, x) if MODE[m].fill != "#ffffff"],
        "looks": {k: {"word": v.word, "fill": v.fill, "text": v.text} for k, v in (VERDICT | MODE).items()},
        "panels": panels,
    }


def _line(name: str, x: Array, y: Array, color: str, **options: Any) -> dict[str, Any]:
    xs, ys = thin(x, y)
    line = {"name": name, "x": numbers(xs), "y": numbers(ys), "color": color, "width": 1.5, "dash": [], "step": False}
    return line | {"dots": False} | options


def _panel(title: str, lines: Sequence[Mapping[str, Any]], height: int = 150, **options: Any) -> dict[str, Any]:
    return {"title": title, "lines": list(lines), "height": height, "limits": [], "zero": False, **options}


def _titled(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name


def _output_panels(run: Run, x: Array) -> list[dict[str, Any]]:
    panels = []
    for i, name in enumerate(run.output_names[:MAX_LINES]):
        lines = [_line(name, x, run.y[:, i], OUTPUT, width=1.8)]
        if np.isfinite(run.ref[:, i]).any():
            lines.insert(0, _line("reference", x, run.ref[:, i], REFERENCE, dash=[5, 3], step=True, width=1.2))
        panels.append(_panel(_titled(name, run.output_units[i]), lines))
    if len(run.output_names) > MAX_LINES:
        rest = range(MAX_LINES, min(3 * MAX_LINES, len(run.output_names)))
        lines = [_line(run.output_names[i], x, run.y[:, i], INPUTS[i % len(INPUTS)]) for i in rest]
        panels.append(_panel("further outputs", lines))
    return panels


def _input_panel(run: Run, x: Array) -> dict[str, Any]:
    lines = [
        _line(name, x, run.u[:, i], INPUTS[i % len(INPUTS)], step=True)
        for i, name in enumerate(run.input_names[: 3 * MAX_LINES])
    ]
    units = set(run.input_units)
    limits = sorted({float(v) for v in (*run.input_min, *run.input_max) if np.isfinite(v)})
    title = _titled("inputs, dotted: limits" if limits else "inputs", units.pop() if len(units) == 1 else "")
    return _panel(title, lines, limits=limits[:12])


def _verdict_panel(run: Run, x: Array) -> dict[str, Any] | None:
    strips = [{"name": "mode", "parts": [[a, b, m, MODE[m].word] for a, b, m in _modes(run, x)]}]
    reports = run.reports
    if len(reports.k):
        start = np.interp(reports.t, run.t, x)
        ends = np.r_[start[1:], x[-1] + 1]
        for j, name in enumerate(PROPERTIES):
            parts = []
            for a, b, verdict in stretches(reports.verdict[:, j]):
                key = VERDICTS[verdict]
                words = verdict_words(VERDICT[key].word, reports.lambda_star[b - 1, j], key)
                parts.append([float(start[a]), float(ends[b - 1]), key, words])
            strips.append(
                {"name": PROPERTY[name].replace("controllable", "ctrl.").replace("observable", "obs."), "parts": parts}
            )
    return {"title": "mode and verdicts", "strips": strips} if any(s["parts"] for s in strips) else None


def _solve_panel(run: Run, x: Array) -> dict[str, Any] | None:
    known = np.isfinite(run.solve_time)
    if not known.any():
        return None
    lines = [_line("solve", x[known], 1e3 * run.solve_time[known], OUTPUT, dots=True)]
    return _panel("solve time [ms]", lines, height=100, zero=True)


def _data_panel(run: Run, x: Array) -> dict[str, Any] | None:
    """Excitation and rank, have against need: the controller's where it reports, else the monitor's."""
    if np.isfinite(run.state["rank"]).any():
        series, at = run.state, x
    elif len(run.reports.k):
        series, at = run.reports.series, np.interp(run.reports.t, run.t, x)
    else:
        return None
    lines = []
    for name, color in (("rank", OUTPUT), ("excitation", INPUTS[1])):
        lines.append(_line(name, at, series[name], color, step=True))
        if np.nanmax(series[f"{name}_need"], initial=0) > 0:
            lines.append(_line(f"{name} needed", at, series[f"{name}_need"], color, dash=[5, 3], width=1.0, step=True))
    return _panel("rank and order of excitation of the data", lines, height=120, zero=True)


def _steady_panel(run: Run, x: Array) -> dict[str, Any] | None:
    lines = [
        _line(name, x, run.state[key], color, step=True)
        for name, key, color in (("to steady state", "distance", OUTPUT), ("slack", "slack", INPUTS[1]))
        if np.nanmax(np.abs(run.state[key]), initial=0) > 0
    ]
    return (
        _panel("reference to the nearest steady state in reach; slack", lines, height=100, zero=True) if lines else None
    )


def _modes(run: Run, x: Array) -> list[tuple[float, float, str]]:
    edges = np.r_[x, x[-1] + 1]
    return [(float(edges[a]), float(edges[b]), MODES[m]) for a, b, m in stretches(run.mode) if m != NO_MODE]


def events(run: Run) -> list[tuple[int, int, float, str]]:
    """What happened, as (epoch, k, seconds, words): modes, references, failures, missing inputs."""
    out: list[tuple[int, Any, str]] = []
    parts = [part for part in stretches(run.mode) if part[2] != NO_MODE]
    out += [(a, run.k[a], f"mode {MODE[MODES[m]].word}") for a, _, m in parts]
    out += [(a, run.k[a], f"new epoch {e}") for a, _, e in stretches(run.epoch)[1:]]
    out += [(a, run.k[a], "reference changes") for a in _changes(run.ref)]
    for name, words in (
        ("failures", "optimisation failed"),
        ("deadline_misses", "deadline missed"),
        ("refused", "samples refused"),
    ):
        counts = np.nan_to_num(run.state[name])
        grown = np.flatnonzero(np.diff(counts, prepend=0) > 0)
        out += [(row, run.k[row], f"{words}, {counts[row]:.0f} in all") for row in grown[:50]]
    missing = np.flatnonzero(np.isnan(run.u).any(axis=1)) if run.u.shape[1] else np.array([], int)
    out += [(row, run.k[row], "input not recorded") for row in missing[:50]]
    return [
        (int(run.epoch[row]), int(k), float(run.t[row]), words) for row, k, words in sorted(out, key=lambda e: e[0])
    ]


def _changes(ref: Array) -> list[int]:
    known = ~np.isnan(ref).any(axis=1)
    moved = (np.diff(np.nan_to_num(ref), axis=0) != 0).any(axis=1)
    both = np.flatnonzero(known)
    return [int(i) + 1 for i in np.flatnonzero(moved) if i in both and i + 1 in both][:200]


def numbers(values: Array) -> list[float | None]:
    """For JSON: seven significant digits, None for what is not finite."""
    return [float(f"{v:.7g}") if np.isfinite(v) else None for v in values.tolist()]
