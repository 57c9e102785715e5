# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The short versions of benchmarks/soak.py and benchmarks/cycles.py: nothing grows, nothing drifts, nothing is left."""

import importlib
from pathlib import Path

import numpy as np
import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
SETTLED = 1100  # samples after which the longest memory of the nodes, 1000 samples, is full


@pytest.fixture
def benchmark(monkeypatch):
    """Imports a benchmark by name; cycles.py uses soak.py."""
    monkeypatch.syspath_prepend(BENCHMARKS)
    return importlib.import_module


def test_a_long_run_neither_grows_nor_drifts(benchmark, domain_id):
    soak = benchmark("soak")
    rows = soak.soak(SETTLED + 300, 14, domain_id=domain_id)
    late = rows[rows[:, 0] > SETTLED]
    samples, _, objects, threads, files, error = late.T[:6]
    assert np.ptp(threads) == np.ptp(files) == 0
    assert np.ptp(objects) < 0.1 * np.ptp(samples)  # an object kept a sample would be a leak
    assert np.nanmax(error) < soak.DRIFT


def test_zones_that_come_and_go_leave_nothing_behind(benchmark, domain_id):
    cycles = benchmark("cycles")
    rows = cycles.cycles(6, domain_id=domain_id)
    threads, files, shared, _ = cycles.left_over(rows)
    assert threads == files == shared == 0
    assert rows[-1, 2] - rows[2, 2] < 50  # objects
    assert cycles.others_in_the_graph(domain_id) == []
