# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The command analyze: verdicts on bags and tables, gaps included, are those of the library on the same samples."""

import json

import numpy as np
import pytest

from plant_sim import random_system
from ros2_deepc.bags import BagReader, load_run
from ros2_deepc.bags.export import export
from ros2_deepc.bags.records import load_records
from ros2_deepc.monitors import Prior, Verdict, analyze_records


@pytest.fixture
def table(tmp_path):
    """Writes a record of a random plant with q = 4 as a table with a time column; returns its path, u and y."""

    def write(K=300, drop=(), noise=0.0, uncontrollable=(), blank=(), s=1):
        rng = np.random.Generator(np.random.PCG64(5))
        plant = random_system(m=2, p=2, q=4, blocks=(s,), uncontrollable=list(uncontrollable), seed=rng)
        u = rng.uniform(-1, 1, (K + s - 1, 2))
        y = plant.system.simulate(u, rng.standard_normal(4)).y
        y = y + noise * y.std(axis=0) * rng.standard_normal(y.shape)
        u = u[:K]
        path = tmp_path / "plant.csv"
        with path.open("w") as file:
            file.write("time,pump 1,pump 2,level [m],flow [m3/s]\n")
            for k in range(K):
                if k not in drop:
                    cells = [repr(10.0 + 5.0 * k), *map(repr, map(float, u[k])), *map(repr, map(float, y[k]))]
                    file.write(",".join([*cells[:3], "" if k in blank else cells[3], cells[4]]) + "\n")
        return path, u, y

    return write


CHANNELS = ("--input", "pump 1", "--input", "pump 2", "--output", "level", "--output", "flow")


def test_a_table_is_proved_and_written(deepc, table, tmp_path):
    path, u, y = table(noise=1e-4)
    code, out, err = deepc(
        "analyze", path, *CHANNELS, "-q", 4, "--require", "r_controllability",
        "--out", tmp_path / "a.png", "--out", tmp_path / "a.json",
    )  # fmt: skip
    assert (code, err) == (0, "")
    assert "R-controllable  ● proved" in out
    expected = analyze_records([(u, y)], prior=Prior(q=4), noise=None)
    numbers = json.loads((tmp_path / "a.json").read_text())
    finding = numbers["r_controllability"]
    assert (finding["verdict"], finding["margin"]) == ("PROVED", expected.r_controllability.margin)
    assert numbers["c_controllability"]["margin"] is None
    assert len(numbers["modes"]) == 4
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


def test_an_uncontrollable_mode_is_named_and_fails_what_is_required(deepc, table):
    path, *_ = table(uncontrollable=[0.5])
    code, out, _ = deepc("analyze", path, *CHANNELS, "-q", 4, "--noise", 0, "--require", "r_controllability")
    assert code == 1
    assert "R-controllable  ● not proved" in out
    assert "mode at fault: λ = 0.500, inside the unit circle: it decays by itself" in out


def test_without_an_order_the_data_show_one_and_that_is_said(deepc, table):
    path, *_ = table()
    _, out, _ = deepc("analyze", path, *CHANNELS, "--noise", 0)
    assert "prior taken from the data (q = 4, s = 1), which only show lower bounds" in out


def test_gaps_split_the_record_and_prove_nothing_false(deepc, table):
    """Lost rows are noticed by the time; taken for regular, the same table contradicts every linear plant."""
    path, u, y = table(drop=(100, 101), blank=(200,))
    found = load_records(path, ["pump 1", "pump 2"], ["level", "flow"], time="time")
    assert [len(b) for _, b in found.records] == [100, 98, 99]
    assert found.sample_time == 5.0
    np.testing.assert_array_equal(found.records[2][0], u[201:])
    np.testing.assert_array_equal(found.records[2][1], y[201:])
    code, out, _ = deepc("analyze", path, *CHANNELS, "-q", 4, "--noise", 0, "--time", "time")
    assert code == 0
    assert "297 samples in 3 unbroken records" in out
    assert "R-controllable  ● proved" in out
    _, out, _ = deepc("analyze", path, *CHANNELS, "-q", 4, "--noise", 0)
    assert "R-controllable  ● prior violated" in out


def test_a_run_speaks_like_the_table_exported_from_it(deepc, record, tmp_path):
    bag = record(K=300, collect=300)
    export(load_run(BagReader(bag.folder)), tmp_path / "run.csv")
    names = [f"--{kind}put={name}{i}" for kind, name in (("in", "valve"), ("out", "head")) for i in (0, 1)]
    _, from_bag, err = deepc("analyze", bag.folder, "--noise", 0, "--printed")
    assert err == ""
    assert "bench two: 300 samples, 2 inputs, 2 outputs; noise exact" in from_bag
    assert "prior q = 2, s = 1, n = 2" in from_bag
    assert "Theorem 3 as printed holds" in from_bag
    _, from_table, _ = deepc("analyze", tmp_path / "run.csv", *names, "-q", 2, "-n", 2, "--noise", 0, "--printed")
    assert from_bag.splitlines()[2:] == from_table.splitlines()[2:]


def test_an_unknown_operating_point(deepc, table):
    """Constants beside the plant are a mode that no input reaches; increments do not see them."""
    path, *_ = table()
    lines = path.read_text().splitlines()
    moved = [line.rsplit(",", 1)[0] + f",{float(line.rsplit(',', 1)[1]) + 50.0!r}" for line in lines[1:]]
    path.write_text("\n".join([lines[0], *moved]) + "\n")
    _, out, _ = deepc("analyze", path, *CHANNELS, "-q", 5, "--noise", 0)
    assert "R-controllable  ● not proved" in out
    code, out, _ = deepc("analyze", path, *CHANNELS, "-q", 4, "--noise", 0, "--form", "incremental")
    assert code == 0
    assert "R-controllable  ● proved" in out


def test_index_two_uses_the_inputs_after_each_output(table):
    path, u, y = table(s=2)
    found = load_records(path, ["pump 1", "pump 2"], ["level", "flow"])
    report = analyze_records(found.records, prior=Prior(q=4, s=2))
    assert report.r_controllability.verdict is Verdict.PROVED
    expected = analyze_records([(u, y[:-1])], prior=Prior(q=4, s=2))
    assert report.r_controllability.margin == expected.r_controllability.margin


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["none.csv", *CHANNELS], "No such file"),
        (["nowhere"], "nowhere"),
        (["plant.csv"], "plant.csv has the columns time, pump 1, pump 2, level [m], flow [m3/s]"),
        (["plant.csv", "--input", "pump 3", "--output", "level"], "no column 'pump 3'"),
        (["plant.csv", *CHANNELS, "--time", "clock"], "no column 'clock'"),
        (["plant.csv", *CHANNELS, "--noise", "much"], "write auto, one number, or one per output"),
        (["plant.csv", *CHANNELS, "-q", 4, "--noise", "1,2,3"], "noise is given for 3 outputs"),
        (["plant.csv", *CHANNELS, "--form", "relative"], "one of absolute, incremental"),
        (["plant.csv", *CHANNELS, "--form", "incremental"], "give its level"),
        (["plant.csv", *CHANNELS, "--require", "beauty"], "one of r_controllability"),
        (["plant.csv", *CHANNELS, "--out", "x.gif"], "end it in .png, .svg, .pdf or .json"),
    ],
)
def test_bad_input_is_one_line(deepc, table, monkeypatch, tmp_path, arguments, words):
    table(K=60)
    monkeypatch.chdir(tmp_path)
    code, _, err = deepc("analyze", *arguments)
    assert code == 1
    assert words in err
    assert err.startswith("error: ")
    assert err.count("\n") == 1


def test_too_short_a_record_asks_for_more(deepc, table):
    path, *_ = table(K=12)
    _, out, _ = deepc("analyze", path, *CHANNELS, "-q", 4)
    assert "more samples needed" in out
    code, _, err = deepc("analyze", path, *CHANNELS)
    assert code == 1
    assert "give it with -q, or more data" in err
