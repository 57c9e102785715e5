# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""What a report shows of a run, as plain data for the page's script."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .figure import axis_label, modes, verdict_words
from .run import PROPERTIES, VERDICTS, Array
from .style import INPUTS, MODE, OUTPUT, PROPERTY, REFERENCE, VERDICT
from .trends import MAX_LINES, Trends

ALONE = 8  # outputs with a panel of their own


def page_data(trends: Trends) -> dict[str, Any]:
    """Panels, bands and looks of a run; numbers with seven digits, at most some 4000 points a line."""
    panels = [*_output_panels(trends), _input_panel(trends)]
    rest = (_verdict_panel(trends), _solve_panel(trends), _data_panel(trends), _steady_panel(trends))
    return {
        "range": [trends.start, trends.end],
        "label": axis_label(trends.run),
        "bands": [[a, b, MODE[m].fill] for a, b, m in modes(trends) if MODE[m].fill != "#ffffff"],
        "looks": {k: {"word": v.word, "fill": v.fill, "text": v.text} for k, v in (VERDICT | MODE).items()},
        "panels": panels + [panel for panel in rest if panel],
    }


def _line(name: str, points: tuple[Array, Array], color: str, **options: Any) -> dict[str, Any]:
    x, y = points
    line = {"name": name, "x": numbers(x), "y": numbers(y), "color": color, "width": 1.5, "dash": [], "step": False}
    return line | {"dots": False} | options


def _panel(title: str, lines: Sequence[Mapping[str, Any]], height: int = 150, **options: Any) -> dict[str, Any]:
    return {"title": title, "lines": list(lines), "height": height, "limits": [], "zero": False, **options}


def _titled(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name


def _shown(what: str, channels: int) -> str:
    return what if channels <= MAX_LINES else f"{what} (the first {MAX_LINES} of {channels})"


def _output_panels(trends: Trends) -> list[dict[str, Any]]:
    panels, names = [], trends.run.output_names
    for name, unit, y, ref in zip(names, trends.run.output_units, trends.y[:ALONE], trends.ref, strict=False):
        lines = [_line(name, y.points(), OUTPUT, width=1.8)]
        if np.isfinite(ref.last):
            lines.insert(0, _line("reference", ref.points(), REFERENCE, dash=[5, 3], step=True, width=1.2))
        panels.append(_panel(_titled(name, unit), lines))
    if len(names) > ALONE:
        rest = zip(names[ALONE:], trends.y[ALONE:], strict=False)
        lines = [_line(name, y.points(), INPUTS[i % len(INPUTS)]) for i, (name, y) in enumerate(rest, ALONE)]
        panels.append(_panel(_shown("further outputs", len(names)), lines))
    return panels


def _input_panel(trends: Trends) -> dict[str, Any]:
    run = trends.run
    lines = [
        _line(name, u.points(), INPUTS[i % len(INPUTS)], step=True)
        for i, (name, u) in enumerate(zip(run.input_names, trends.u, strict=False))
    ]
    units = set(run.input_units)
    limits = sorted({float(v) for v in (*run.input_min, *run.input_max) if np.isfinite(v)})
    title = _shown("inputs", len(run.input_names)) + (", dotted: limits" if limits else "")
    return _panel(_titled(title, units.pop() if len(units) == 1 else ""), lines, limits=limits[:12])


def _verdict_panel(trends: Trends) -> dict[str, Any] | None:
    strips = [{"name": "mode", "parts": [[a, b, m, MODE[m].word] for a, b, m in modes(trends)]}]
    for name, strip in zip(PROPERTIES, trends.verdicts, strict=True):
        parts = []
        for a, b, verdict, star in strip.runs(trends.end):
            key = VERDICTS[verdict]
            parts.append([a, b, key, verdict_words(VERDICT[key].word, star, key)])
        if parts:
            short = PROPERTY[name].replace("controllable", "ctrl.").replace("observable", "obs.")
            strips.append({"name": short, "parts": parts})
    return {"title": "mode and verdicts", "strips": strips} if any(s["parts"] for s in strips) else None


def _solve_panel(trends: Trends) -> dict[str, Any] | None:
    x, y = trends.solve.points()
    known = np.isfinite(y)
    if not known.any():
        return None
    line = _line("solve", (x[known], 1e3 * y[known]), OUTPUT, dots=True)
    return _panel("solve time [ms]", [line], height=100, zero=True)


def _data_panel(trends: Trends) -> dict[str, Any] | None:
    """Excitation and rank, have against need: the controller's where it reports, else the monitor's."""
    series = trends.state if np.isfinite(trends.state["rank"].last) else trends.reports
    if not len(series["rank"].points()[0]):
        return None
    lines = []
    for name, color in (("rank", OUTPUT), ("excitation", INPUTS[1])):
        lines.append(_line(name, series[name].points(), color, step=True))
        need = series[f"{name}_need"].points()
        if np.nanmax(need[1], initial=0) > 0:
            lines.append(_line(f"{name} needed", need, color, dash=[5, 3], width=1.0, step=True))
    return _panel("rank and order of excitation of the data", lines, height=120, zero=True)


def _steady_panel(trends: Trends) -> dict[str, Any] | None:
    lines = [
        _line(name, trends.state[key].points(), color, step=True)
        for name, key, color in (("to steady state", "distance", OUTPUT), ("slack", "slack", INPUTS[1]))
        if np.nanmax(np.abs(trends.state[key].points()[1]), initial=0) > 0
    ]
    return (
        _panel("reference to the nearest steady state in reach; slack", lines, height=100, zero=True) if lines else None
    )


def numbers(values: Array) -> list[float | None]:
    """For JSON: seven significant digits, None for what is not finite."""
    return [float(f"{v:.7g}") if np.isfinite(v) else None for v in values.tolist()]
