# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ros2_deepc.behavior import DataWindow, Record, data_matrix, hankel


@settings(max_examples=80, deadline=None)
@given(
    capacity=st.integers(1, 9),
    events=st.lists(st.sampled_from(["push", "push", "push", "cut", "clear"]), max_size=40),
)
def test_holds_the_last_samples_in_their_records(capacity, events):
    window, model, counter = DataWindow(2, 1, capacity), [[]], 0.0
    for event in events:
        if event == "push":
            window.push([counter, -counter], [10 * counter])
            model[-1].append(counter)
            counter += 1.0
        elif event == "cut":
            window.cut()
            model.append([])
        else:
            window.clear()
            model = [[]]
    flat = [(i, value) for i, record in enumerate(model) for value in record][-capacity:]
    expected = [[v for i, v in flat if i == record] for record in range(len(model))]
    expected = [record for record in expected if record]
    assert [list(r.u[:, 0]) for r in window.records()] == expected
    assert [list(r.y[:, 0] / 10) for r in window.records()] == expected
    assert len(window) == len(flat)
    newest = [v for i, v in flat if i == len(model) - 1]
    assert list(window.newest().u[:, 0]) == newest


def test_what_leaves_is_a_copy():
    window = DataWindow(1, 1, 3)
    window.push([1.0], [2.0])
    window.records()[0].u[0, 0] = 99.0
    assert window.records()[0].u[0, 0] == 1.0


def test_a_bad_sample_changes_nothing():
    window = DataWindow(1, 2, 3)
    window.push([1.0], [2.0, 3.0])
    for u, y, text in [
        ([1.0], [np.nan, 0], r"y\[0\] is nan"),
        ([1.0, 2], [0, 0], "u must have shape"),
        ([1], [[0, 0]], "y must"),
    ]:
        with pytest.raises(ValueError, match=text):
            window.push(u, y)
    assert len(window) == window.pushed == 1
    with pytest.raises(ValueError, match="capacity = 0"):
        DataWindow(1, 1, 0)


def test_no_column_spans_a_gap():
    rng = np.random.Generator(np.random.PCG64(3))
    a, b, short = (Record(rng.normal(size=(n, 2)), rng.normal(size=(n, 1))) for n in (9, 7, 3))
    H = data_matrix((a, short, b), 4, 4)
    assert np.array_equal(H[:, :6], np.vstack([hankel(a.u, 4), hankel(a.y, 4)]))
    assert np.array_equal(H[:, 6:], np.vstack([hankel(b.u, 4), hankel(b.y, 4)]))
    assert data_matrix((short,), 4, 4).shape == (12, 0)


def test_inputs_may_be_known_further_than_outputs():
    u, y = np.arange(8.0)[:, None], np.arange(6.0)[:, None]
    H = data_matrix([Record(u, y)], 5, 3)
    assert H.shape == (8, 4)
    assert H[:, -1].tolist() == [3, 4, 5, 6, 7, 3, 4, 5]
