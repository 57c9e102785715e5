# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""A bag read by the libraries that Foxglove itself uses. Needs node, and `npm install` in tests/bags/js."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from ros2_deepc.bags import BagReader

HERE = Path(__file__).parent / "js"
THERE = shutil.which("node") and (HERE / "node_modules").is_dir()
needs_node = pytest.mark.skipif(
    not THERE and os.environ.get("PEERS") != "required", reason="no node, or no npm install in tests/bags/js"
)


def same(found, expected) -> bool:
    """A JSON value against a decoded one: 64-bit integers, -0 and what is not finite come as text."""
    if hasattr(expected, "__dict__"):
        fields = vars(expected)
        if set(found) == {"sec", "nsec"}:  # its own name for a time
            found = {"sec": found["sec"], "nanosec": found["nsec"]}
        return set(found) == set(fields) and all(same(found[name], value) for name, value in fields.items())
    if isinstance(expected, np.ndarray | list):
        return len(found) == len(expected) and all(map(same, found, list(expected)))
    if isinstance(expected, float) and isinstance(found, str):
        return repr(float(found)) == repr(expected)  # -0, NaN, Infinity
    return int(found) == expected if isinstance(found, str) and not isinstance(expected, str) else found == expected


@needs_node
def test_foxglove_libraries_read_every_field(record):
    bag = record(K=60, collect=30)
    command = ["node", "read.mjs", str(next(bag.folder.glob("*.mcap")))]
    out = subprocess.run(command, cwd=HERE, check=True, capture_output=True, text=True).stdout
    found = [json.loads(line) for line in out.splitlines()]
    expected = list(BagReader(bag.folder).decoded())
    assert len(found) == len(expected) == len(bag.messages)
    for (topic, time, fields), (raw, message) in zip(found, expected, strict=True):
        assert (topic, int(time)) == (raw.topic, raw.log_time)
        assert same(fields, message), topic
