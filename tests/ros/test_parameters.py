# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Parameter tables: what they accept, what they say."""

import pytest

from ros2_deepc.ros.parameters import ConfigError, Param, check, markdown

TABLE = (
    Param("count", 3, "how many", "samples", low=1, high=10),
    Param("gain", 0.5, "how much", low=0.0),
    Param("kind", "a", "which", choices=("a", "b")),
    Param("weights", [1.0], "one for all or shape (p,)", low=0.0),
    Param("on", True, "whether"),
)


@pytest.mark.parametrize(
    "given",
    [{}, {"count": 10}, {"gain": 0.0}, {"kind": "b"}, {"weights": [1.0, 2.0]}, {"on": False}, {"use_sim_time": True}],
)
def test_values_that_fit(given):
    check("node", TABLE, given)


@pytest.mark.parametrize(
    ("given", "hint"),
    [
        ({"count": 0}, "count = 0 is out of range 1..10: how many"),
        ({"count": 11}, "out of range"),
        ({"count": 2.0}, "should be like 3"),
        ({"count": True}, "should be like 3"),
        ({"gain": -1.0}, "out of range 0.0..inf"),
        ({"gain": 1}, "write a decimal point"),
        ({"gain": float("nan")}, "out of range"),
        ({"kind": "c"}, "not one of a, b"),
        ({"weights": 1.0}, "should be like"),
        ({"weights": [1.0, -1.0]}, "out of range"),
        ({"weights": ["x"]}, "should be like"),
        ({"on": 1}, "should be like True"),
        ({"cuont": 1}, "did you mean count?"),
        ({"zzz": 1}, "it has count, gain"),
    ],
)
def test_values_that_do_not_fit_are_named_in_one_line(given, hint):
    with pytest.raises(ConfigError) as caught:
        check("node", TABLE, given)
    message = str(caught.value)
    assert hint in message
    assert message.startswith("node")
    assert "\n" not in message


def test_markdown_has_a_row_for_each():
    text = markdown(TABLE)
    assert text.count("\n") == len(TABLE) + 1
    assert "| `count` | `3` | how many [samples]; 1 to 10 |" in text
