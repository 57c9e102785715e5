# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Tables that hold the same bits as the run."""

import csv

import numpy as np
import pytest

from ros2_deepc.bags import BagError, load_run
from ros2_deepc.bags.export import export


@pytest.fixture
def run(record):
    return load_run(record(K=50, collect=30).folder)


def test_csv_reads_back_to_the_same_bits(run, tmp_path):
    export(run, tmp_path / "run.csv")
    with open(tmp_path / "run.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 50
    for i in range(2):
        np.testing.assert_array_equal([float(r[f"head{i} [m]"]) for r in rows], run.y[:, i])
        np.testing.assert_array_equal([float(r[f"valve{i} [m3/s]"]) for r in rows], run.u[:, i])
        np.testing.assert_array_equal([float(r[f"head{i} reference [m]"]) for r in rows], run.ref[:, i])
    assert [int(r["k"]) for r in rows] == list(range(50))
    assert {r["mode"] for r in rows[:30]} == {"COLLECTING"}
    assert rows[0]["solve_time [s]"] == ""
    assert float(rows[40]["solve_time [s]"]) == run.solve_time[40]
    assert [rows[i]["r_observability"] for i in (0, 8, 9, 49)] == ["", "", "UNDECIDED", "UNDECIDED"]


def test_parquet_reads_back(run, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    export(run, tmp_path / "run.parquet")
    table = parquet.read_table(tmp_path / "run.parquet")
    np.testing.assert_array_equal(table["head0 [m]"].to_numpy(), run.y[:, 0])
    assert table.schema.metadata[b"loop_hash"].decode() == run.loop_hash


def test_picture_and_unknown_ending(run, tmp_path):
    export(run, tmp_path / "run.pdf")
    assert (tmp_path / "run.pdf").read_bytes().startswith(b"%PDF")
    with pytest.raises(BagError, match=r"must end in \.csv"):
        export(run, tmp_path / "run.xlsx")
    with pytest.raises(BagError, match="cannot write"):
        export(run, tmp_path / "none" / "run.csv")


def test_input_and_output_of_one_name_stay_apart(make, tmp_path):
    info = make.plant_info()
    info.input_names, info.input_units = ["head0", "valve"], ["m", ""]
    messages = [("plant_info", info), ("inputs", make.sample(0, [1, 2])), ("outputs", make.sample(0, [3, 4]))]
    make.write_bag(tmp_path / "bag", messages)
    export(load_run(tmp_path / "bag"), tmp_path / "run.csv")
    with open(tmp_path / "run.csv", newline="") as file:
        row = next(csv.DictReader(file))
    assert (row["head0 [m]"], row["head0 input [m]"], row["valve"]) == ("3.0", "1.0", "2.0")
