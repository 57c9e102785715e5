# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""A sample of the statistics in benchmarks/: no claim may be broken."""

import importlib.util
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


def load(name):
    spec = importlib.util.spec_from_file_location(name, BENCHMARKS / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def tables():
    return load("monitor_statistics").TABLES


@pytest.mark.parametrize(
    ("name", "plants"),
    [
        ("noise_free", 60),
        ("printed", 45),
        ("near", 3),
        ("undeclared", 1),
        ("wrong_prior", 20),
        ("closed_loop", 6),
        ("structure", 3),
    ],
)
def test_no_claim_is_broken(tables, name, plants):
    assert tables[name][0](plants).broken == []


def test_under_noise_nothing_false_is_proved_and_no_less_than_by_a_plain_test():
    for needed in ("monitor_statistics", "pencil_baseline"):  # its neighbours, which it imports by name
        load(needed)
    rows = list(load("noise_rates").rows(12, seed=4, cells=(1, 3), levels=(40, 100)))
    assert [claim for row in rows for claim in row.broken] == []
    assert sum(row.lead for row in rows) >= 0
    assert min(row.plain for row in rows[1::2]) >= 1  # at 100 dB: it does prove


def test_only_the_certificate_is_right_about_every_kind():
    answers = load("monitors").answers(8)
    assert list(answers["analyze (certificate)"].values()) == [100.0, 0.0, 100.0]
    assert answers["matrix_rank, random lambda"]["uncontrollable"] == 100.0
