# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Tables as they come out of historians and spreadsheets."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ros2_deepc.bags import BagError
from ros2_deepc.bags.table import Table


@pytest.fixture
def table(tmp_path):
    def write(text, name="t.csv"):
        (tmp_path / name).write_text(text, encoding="utf-8")
        return Table(tmp_path / name)

    return write


@pytest.mark.parametrize(
    "text",
    [
        "time,u 1,y [m]\n0,1.5,-2e3\n1,2.5,4\n",
        "time;u 1;y [m]\n0;1,5;-2e3\n1;2,5;4\n",  # decimal comma
        "# made by hand\n\ntime\tu 1\ty [m]\n0\t1.5\t-2e3\n1\t2.5\t4\n",
        "\ufefftime, u 1, y [m]\r\n0, 1.5, -2e3\r\n1, 2.5, 4\r\n",  # a spreadsheet's byte-order mark
    ],
)
def test_separators_and_decimal_marks_are_found_out(table, text):
    read = table(text)
    assert read.names == ("time", "u 1", "y [m]")
    np.testing.assert_array_equal(read.numbers("u 1"), [1.5, 2.5])
    np.testing.assert_array_equal(read.numbers("y"), [-2000.0, 4.0])  # without its unit


def test_columns_without_names_are_numbered(table):
    read = table("1,2\n3,4\n5,6\n")
    assert read.names == ("1", "2")
    np.testing.assert_array_equal(read.numbers("2"), [2.0, 4.0, 6.0])


def test_a_single_column(table):
    np.testing.assert_array_equal(table("level\n1\n2.5\n").numbers("level"), [1.0, 2.5])


def test_empty_cells_are_missing(table):
    read = table("u,y\n1,\n2,NaN\n3,n/a\n4,7\n")
    np.testing.assert_array_equal(read.numbers("y"), [np.nan, np.nan, np.nan, 7.0])


def test_times_are_seconds_or_iso(table):
    read = table("t,when,word\n0.5,2026-03-01T00:00:00+01:00,a\n1.5,2026-03-01T00:01:00+01:00,b\n")
    np.testing.assert_array_equal(read.seconds("t"), [0.5, 1.5])
    assert np.diff(read.seconds("when")) == 60.0
    with pytest.raises(BagError, match="column 'word': neither seconds nor ISO 8601"):
        read.seconds("word")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "has no rows"),
        ("u,y\n", "has no rows"),
        ("u,y\n1,2\n3\n", "row 2: 1 cells, the table has 2 columns"),
        ("u,y,u\n1,2,3\n", "two columns called 'u'"),
    ],
)
def test_broken_tables_are_one_line(table, text, words):
    with pytest.raises(BagError, match=words) as caught:
        table(text)
    assert "\n" not in str(caught.value)


def test_wrong_columns_and_cells_are_named(table):
    read = table("u,y\n1,2\n3,on\n")
    with pytest.raises(BagError, match="no column 'z'; it has u, y"):
        read.numbers("z")
    with pytest.raises(BagError, match="row 2 of column 'y': 'on' is no number"):
        read.numbers("y")


def test_a_missing_file_is_one_line(tmp_path):
    with pytest.raises(BagError, match="No such file"):
        Table(tmp_path / "none.csv")


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(*[st.floats(allow_nan=False, allow_infinity=False)] * 3), min_size=1, max_size=20))
def test_numbers_come_back_to_the_bit(tmp_path_factory, rows):
    path = tmp_path_factory.mktemp("table") / "t.csv"
    path.write_text("a,b,c\n" + "".join(",".join(map(repr, row)) + "\n" for row in rows))
    read = Table(path)
    np.testing.assert_array_equal(np.stack([read.numbers(name) for name in "abc"], axis=1), rows)


def test_parquet(tmp_path):
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    pq.write_table(pa.table({"u": [1.0, None, 3.0], "y": [1, 2, 3]}), tmp_path / "t.parquet")
    read = Table(tmp_path / "t.parquet")
    np.testing.assert_array_equal(read.numbers("u"), [1.0, np.nan, 3.0])
    np.testing.assert_array_equal(read.numbers("y"), [1.0, 2.0, 3.0])
