# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The examples of the integration guide are valid."""

import re
from pathlib import Path

import pytest

from ros2_deepc.gateway import loads

GUIDE = (Path(__file__).parents[2] / "docs" / "integration.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```yaml\n(.*?)```", GUIDE, re.DOTALL)


def test_there_are_three():
    assert [loads(text).kind for text in EXAMPLES] == ["modbus", "opcua", "ros"]


@pytest.mark.parametrize("text", EXAMPLES)
def test_each_names_what_it_writes(text):
    tags = loads(text)
    assert all(tag.low < tag.high and tag.low <= tag.safe <= tag.high for tag in tags.inputs)
