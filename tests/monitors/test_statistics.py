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
        ("noise", 2),
        ("undeclared", 1),
        ("wrong_prior", 20),
        ("closed_loop", 6),
        ("structure", 3),
    ],
)
def test_no_claim_is_broken(tables, name, plants):
    assert tables[name][0](plants).broken == []


def test_only_the_certificate_is_right_about_every_kind():
    answers = load("monitors").answers(8)
    assert list(answers["analyze (certificate)"].values()) == [100.0, 0.0, 100.0]
    assert answers["matrix_rank, random lambda"]["uncontrollable"] == 100.0
