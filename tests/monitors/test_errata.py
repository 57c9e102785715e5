# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The examples of the errata run, and each of them can fail."""

import re
from pathlib import Path

PAGE = Path(__file__).parents[2] / "docs" / "errata.md"


def test_every_example_runs():
    text = PAGE.read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", text, flags=re.S)
    assert len(blocks) == text.count("\n## ")  # the set-up and one for each point but the last
    names: dict[str, object] = {}
    for block in blocks:
        exec(compile(block, PAGE.name, "exec"), names)
    assert all("assert" in block for block in blocks[1:])
