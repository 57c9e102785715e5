# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""A sample of the statistics in benchmarks/monitor_statistics.py: no claim may be broken."""

import importlib.util
import sys
from pathlib import Path

import pytest

FILE = Path(__file__).parents[2] / "benchmarks" / "monitor_statistics.py"


@pytest.fixture(scope="module")
def tables():
    spec = importlib.util.spec_from_file_location("monitor_statistics", FILE)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module.TABLES


@pytest.mark.parametrize(
    ("name", "plants"),
    [
        ("noise_free", 60),
        ("printed", 45),
        ("near", 3),
        ("noise", 2),
        ("wrong_prior", 20),
        ("closed_loop", 6),
        ("structure", 3),
    ],
)
def test_no_claim_is_broken(tables, name, plants):
    assert tables[name][0](plants).broken == []
