# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Every path in a layout is a field that the topic's message has, with an index that the plant has."""

import json
import re
from xml.etree import ElementTree as ET

import pytest

from ros2_deepc.bags import BagError
from ros2_deepc.bags.decode import parse_definition
from ros2_deepc.bags.layouts import panels, write_layouts
from ros2_deepc.bags.schema import message_definition
from ros2_deepc.ros import topics


@pytest.fixture
def files(tmp_path):
    return write_layouts(tmp_path / "layouts", "/grid", ["x1", "c0"], ["P12", "P13", "P23"])


def walk(layout):
    """Names of the panels in Foxglove's nested pairs."""
    return [layout] if isinstance(layout, str) else walk(layout["first"]) + walk(layout["second"])


def check(topic: str, field: str) -> None:
    """Follows a field path through the definition of the topic's type."""
    row = next(t for t in topics.ALL if f"/grid/{t.name}" == topic)
    types = parse_definition(row.type_name, message_definition(row.type_name))
    kind = row.type_name.replace("/msg/", "/")
    for step in field.split("."):
        name, index = re.fullmatch(r"(\w+)(?:\[(\d)\])?", step).groups()
        found = next(f for f in types[kind] if f.name == name)
        assert (found.length is None) == (index is None)
        kind = found.type
    assert kind in ("float64", "uint8", "uint32")


def test_foxglove_paths_are_real_fields(files):
    layout = json.loads(files[0].read_text())
    assert sorted(walk(layout["layout"])) == sorted(layout["configById"])
    values = [p["value"] for c in layout["configById"].values() for p in c["paths"]]
    assert "/grid/outputs.values[1]" in values
    assert "/grid/monitor/report.c_observability.verdict" in values
    for value in values:
        check(*value.split(".", 1))


def test_plotjuggler_curves_are_the_same_fields(files):
    root = ET.fromstring(files[1].read_text())
    curves = [c.attrib["name"] for c in root.iter("curve")]
    expected = [
        f"/grid/{c.topic}/{c.field.replace('.', '/')}" for p in panels(["x1", "c0"], ["a", "b", "c"]) for c in p.curves
    ]
    assert curves == expected
    splitter = next(root.iter("DockSplitter"))
    sizes = [float(s) for s in splitter.attrib["sizes"].split(";")]
    assert len(sizes) == int(splitter.attrib["count"]) == len(list(splitter))
    assert sum(sizes) == pytest.approx(1, abs=1e-3)


def test_folder_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(BagError, match="cannot write layouts"):
        write_layouts(tmp_path / "file", "/grid", ["x"], ["u"])
