# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The short version of benchmarks/gateway_scale.py: a thousand tags, and no vector from two scans of the field."""

import asyncio
import importlib.util
from pathlib import Path

import pytest

pytest.importorskip("pymodbus")
pytest.importorskip("asyncua")


@pytest.fixture(scope="module")
def scale():
    path = Path(__file__).parents[2] / "benchmarks" / "gateway_scale.py"
    spec = importlib.util.spec_from_file_location("gateway_scale", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("protocol", ["modbus", "opcua"])
def test_a_thousand_tags_belong_together(scale, protocol, free_port, monkeypatch):
    monkeypatch.setitem(scale.PORTS, protocol, free_port())
    text, parts = scale.modbus() if protocol == "modbus" else scale.opcua(array=True)
    ages, torn, _ = asyncio.run(scale.measure(text, *parts, seconds=1.0))
    assert len(ages) > 0
    assert torn == 0
