# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The examples of the integration guide are valid, and the one on topics runs."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from ros2_deepc.gateway import loads
from ros2_deepc.gateway.commands import check
from ros2_deepc.nodes.config import load as load_zone
from ros2_deepc.nodes.config import validate

DOCS = Path(__file__).parents[2] / "docs"
GUIDE = (DOCS / "integration.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```yaml\n(.*?)```", GUIDE, re.DOTALL)


def test_there_are_three():
    assert [loads(text).kind for text in EXAMPLES] == ["modbus", "opcua", "ros"]


@pytest.mark.parametrize("text", EXAMPLES)
def test_each_names_what_it_writes(text):
    tags = loads(text)
    assert all(tag.low < tag.high and tag.low <= tag.safe <= tag.high for tag in tags.inputs)


def test_the_simulator_on_topics_is_seen_whole(tmp_path, until):
    tags = tmp_path / "topics.yaml"
    tags.write_text(EXAMPLES[2])
    validate(load_zone(DOCS / "gateway" / "zone.yaml"))
    with subprocess.Popen([sys.executable, DOCS / "gateway" / "grid_simulator.py"]) as simulator:
        try:
            rows = until(lambda: [rows for rows in (check(tags),) if rows[0][-1] == "GOOD"])[0]
        finally:
            simulator.kill()
    assert [row[0] for row in rows] == ["f0", "f1", "f2", "p1", "scan", "u0", "u1", "u2"]
    assert [row[-1] for row in rows[:5]] == ["GOOD"] * 5
    speeds = [float(row[6]) for row in rows[:3]]
    assert 0.0 < max(map(abs, speeds)) < 0.3
