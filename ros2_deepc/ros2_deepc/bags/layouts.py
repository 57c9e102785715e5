# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Layouts for Foxglove and PlotJuggler that show a zone's topics, made from one table of panels."""

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

from .errors import BagError, why
from .run import PROPERTIES
from .style import INPUTS, OUTPUT, PROPERTY, REFERENCE

OUTPUTS, INPUT, STATE, REPORT = "outputs", "inputs", "controller/state", "monitor/report"


@dataclass(frozen=True, slots=True)
class Curve:
    """One number over time: relative topic, field path, label, colour, and whether it is drawn dashed."""

    topic: str
    field: str
    label: str
    color: str
    dashed: bool = False


@dataclass(frozen=True, slots=True)
class Panel:
    """Curves that share axes; ``states`` for enumerations that are shown as coloured strips."""

    title: str
    curves: tuple[Curve, ...]
    states: bool = False
    share: float = 1.0


def panels(output_names: Sequence[str], input_names: Sequence[str]) -> list[Panel]:
    """The panels of a zone, top to bottom."""
    table = [
        Panel(
            name,
            (
                Curve(OUTPUTS, f"values[{i}]", name, OUTPUT),
                Curve(STATE, f"reference[{i}]", "reference", REFERENCE, dashed=True),
            ),
            share=2.0,
        )
        for i, name in enumerate(output_names)
    ]
    inputs = [Curve(INPUT, f"values[{i}]", n, INPUTS[i % len(INPUTS)]) for i, n in enumerate(input_names)]
    verdicts = [Curve(REPORT, f"{name}.verdict", PROPERTY[name], OUTPUT) for name in PROPERTIES]
    return [
        *table,
        Panel("inputs", tuple(inputs), share=2.0),
        Panel("mode and verdicts", (Curve(STATE, "mode", "mode", OUTPUT), *verdicts), states=True, share=1.5),
        Panel(
            "rank of the data",
            (
                Curve(STATE, "rank", "rank", OUTPUT),
                Curve(STATE, "rank_need", "rank needed", OUTPUT, dashed=True),
                Curve(STATE, "excitation", "excitation", INPUTS[1]),
                Curve(STATE, "excitation_need", "excitation needed", INPUTS[1], dashed=True),
            ),
        ),
        Panel("solve time [s]", (Curve(STATE, "solve_time", "solve time", OUTPUT),)),
    ]


def foxglove(table: Sequence[Panel], namespace: str) -> str:
    """A Foxglove layout (JSON, File > Import layout)."""
    configs = {}
    for i, panel in enumerate(table):
        kind = "StateTransitions" if panel.states else "Plot"
        paths = [_foxglove_path(curve, namespace) for curve in panel.curves]
        config = {"paths": paths, "isSynced": True, "foxglovePanelTitle": panel.title}
        if not panel.states:
            config |= {"xAxisVal": "timestamp", "showLegend": True, "showXAxisLabels": True, "showYAxisLabels": True}
        configs[f"{kind}!panel{i}"] = config
    layout = {
        "configById": configs,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": _column(list(configs), [panel.share for panel in table]),
    }
    return json.dumps(layout, indent=2) + "\n"


def _foxglove_path(curve: Curve, namespace: str) -> dict[str, object]:
    path = {
        "value": f"{namespace}/{curve.topic}.{curve.field}",
        "label": curve.label,
        "enabled": True,
        "timestampMethod": "headerStamp",
    }
    return path | {"color": curve.color, "lineSize": 1.5, "lineStyle": "dashed" if curve.dashed else "solid"}


def _column(names: list[str], shares: list[float]) -> object:
    """Panels one above the other, as Foxglove's nested pairs."""
    if len(names) == 1:
        return names[0]
    share = 100 * shares[0] / sum(shares)
    rest = _column(names[1:], shares[1:])
    return {"direction": "column", "first": names[0], "second": rest, "splitPercentage": round(share, 3)}


def plotjuggler(table: Sequence[Panel], namespace: str) -> str:
    """A PlotJuggler layout (XML, Layout > Load)."""
    root = ET.Element("root")
    window = ET.SubElement(root, "tabbed_widget", {"parent": "main_window", "name": "Main Window"})
    tab = ET.SubElement(window, "Tab", containers="1", tab_name=namespace.strip("/") or "run")
    total = sum(panel.share for panel in table)
    sizes = ";".join(f"{panel.share / total:.4f}" for panel in table)
    container = ET.SubElement(tab, "Container")
    splitter = ET.SubElement(container, "DockSplitter", orientation="-", sizes=sizes, count=str(len(table)))
    for panel in table:
        area = ET.SubElement(splitter, "DockArea", name=panel.title)
        style = "Steps" if panel.states else "Lines"
        plot = ET.SubElement(area, "plot", mode="TimeSeries", style=style, flip_x="false", flip_y="false")
        ET.SubElement(plot, "limitY")
        for curve in panel.curves:
            name = f"{namespace}/{curve.topic}/{curve.field.replace('.', '/')}"
            ET.SubElement(plot, "curve", name=name, color=curve.color)
    ET.SubElement(window, "currentTabIndex", index="0")
    ET.SubElement(root, "use_relative_time_offset", enabled="1")
    ET.indent(root, " ")
    return "<?xml version='1.0' encoding='UTF-8'?>\n" + ET.tostring(root, encoding="unicode") + "\n"


def layouts(namespace: str, output_names: Sequence[str], input_names: Sequence[str]) -> dict[str, str]:
    """The layout of a zone for each viewer, as text by file name."""
    table = panels(output_names, input_names)
    return {"foxglove.json": foxglove(table, namespace), "plotjuggler.xml": plotjuggler(table, namespace)}


def write_layouts(
    folder: str | os.PathLike[str], namespace: str, output_names: Sequence[str], input_names: Sequence[str]
) -> list[Path]:
    """Writes foxglove.json and plotjuggler.xml into a folder and returns their paths.

    Raises:
        BagError: if the folder cannot be written.
    """
    files = layouts(namespace, output_names, input_names)
    paths = []
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
        for name, text in files.items():
            paths.append(Path(folder) / name)
            paths[-1].write_text(text, encoding="utf-8")
    except OSError as error:
        raise BagError(f"cannot write layouts into {folder}: {why(error)}") from error
    return paths
