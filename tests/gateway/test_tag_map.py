# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Every mistake in a tag map is one line with file, line and column; no text whatever crashes the reader."""

import re
from contextlib import suppress

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ros2_deepc.gateway import GatewayError, loads
from ros2_deepc.gateway.field import find_plant
from ros2_deepc.gateway.field_tags import modbus_places, tag_map
from ros2_deepc.gateway.places import words
from ros2_deepc.gateway.units import check_registered


def test_a_good_map_is_read_as_written(text):
    tags = loads(text)
    assert [tag.name for tag in tags.reads] == ["y1", "y2", "scan", "echo"]
    assert [tag.name for tag in tags.writes] == ["u1", "u2", "beat"]
    assert (tags.period, tags.poll, tags.plant.s) == (0.1, 0.01, 1)
    assert words(tags.outputs[1].at) == "input 4 float32 ABCD unit 1"
    assert tags.modulus == {"scan": 65536, "echo": 65536, "beat": 65536}
    assert tags.outputs[0].stale_after == 0.35


def swap(old, new):
    return lambda text: text.replace(old, new, 1)


MISTAKES = {  # what is changed, and what the reader is told
    "unknown key": (
        swap("offset: 1.5", "ofset: 1.5"),
        r"line 11, column 25: outputs\[1\]\.ofset: .*did you mean offset",
    ),
    "unknown section": (lambda t: t + "extra: 1\n", r"line 15, column 1: extra: unknown key"),
    "key twice": (swap("unit: m,", "unit: m, unit: m,"), r"line 11, column 25: .*twice"),
    "two writers": (swap("at: {address: 3}", "at: {address: 2}"), r"line 14, .*u2 and u1 both write holding 2"),
    "beat on an input": (
        swap("{address: 0, type: uint16}", "{address: 2, type: uint16}"),
        r"line 6, .*beat and u1 both",
    ),
    "no limits": (swap("limits: [-1, 1], ", ""), r"line 13, column 5: inputs\[0\]: 'limits' is missing"),
    "no rate": (swap("max_rate: 5, ", ""), r"line 13.*'max_rate' is missing"),
    "no safe value": (swap("safe: 0, ", ""), r"line 13.*'safe' is missing"),
    "safe outside limits": (swap("safe: 0,", "safe: 3,"), r"line 13.*safe: 3 is outside the limits -1 to 1"),
    "limits turned round": (swap("[-1, 1]", "[1, -1]"), r"line 13.*1 should be below -1"),
    "limits infinite": (swap("[-1, 1]", "[-.inf, 1]"), r"line 13, column 35: .*expected a number, found .-.inf"),
    "stale too soon": (
        swap("stale_after: 0.35", "stale_after: 0.15"),
        r"line 4, column 15: .*below two periods: at least 0.2",
    ),
    "fallback before stale": (swap("fallback_after: 1.0", "fallback_after: 0.3"), r"line 4, .*below stale_after"),
    "unit without scale": (swap("scale: 0.0062831853, ", ""), r"line 10.*mHz to rad/s needs a scale"),
    "scale zero": (swap("scale: 0.0062831853", "scale: 0"), r"line 10.*would lose the value"),
    "ramp faster than the rate": (swap("seconds: 2.0", "seconds: 0.1"), r"line 8, .*max_rate: give 0.2 s or more"),
    "name twice": (swap("name: y2", "name: y1"), r"line 11.*'y1' is taken"),
    "a text for a number": (swap("offset: 1.5", "offset: much"), r"line 11.*expected a number, found 'much'"),
    "not in the list": (swap("kind: modbus", "kind: modbuss"), r"line 2, column 14: link.kind: .*did you mean modbus"),
    "writing an input register": (
        swap("at: {address: 3}", "at: {table: input, address: 30}"),
        r"line 14.*cannot be written",
    ),
    "behind the last register": (swap("address: 3}", "address: 65535}"), r"line 14.*ends behind register 65535"),
    "limits that the type cannot hold": (swap("[-2, 2]", "[-1e39, 1e39]"), r"line 14.*float32 cannot hold"),
    "a counter that is no counter": (swap("address: 0, type: uint16}}", "address: 0}}"), r"line 3.*give type: uint16"),
    "an echo of nothing": (swap("  write: {address: 0, type: uint16}\n", ""), r"echo: nothing is written"),
    "not YAML": (swap("plant: {", "plant: {{"), r"line \d+, column \d+: not valid YAML"),
    "a list for a section": (
        swap("{kind: modbus, host: 127.0.0.1, port: 5020}", "[1]"),
        r"line 2, column 7: .*expected a section",
    ),
}  # fmt: skip


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_one_line_that_says_where(text, mistake):
    change, expected = MISTAKES[mistake]
    assert change(text) != text
    with pytest.raises(GatewayError) as caught:
        loads(change(text), "site.yaml")
    message = str(caught.value)
    assert "\n" not in message
    assert re.search(rf"^site\.yaml, .*{expected}", message), message


@pytest.mark.parametrize(
    ("link", "expected"),
    [
        ("{kind: opcua, url: 'http://x'}", "should be like opc.tcp"),
        ("{kind: opcua, url: 'opc.tcp://plc:4840', allow_insecure_loopback: true}", "only encrypted links leave"),
        ("{kind: opcua, url: 'opc.tcp://plc:4840', user: me}", "belong together"),
    ],
)
def test_links_that_are_not_safe_are_refused(text, link, expected):
    with pytest.raises(GatewayError, match=expected):
        loads(text.replace("{kind: modbus, host: 127.0.0.1, port: 5020}", link))


def test_one_entry_may_stand_for_many_tags(text):
    many = text.replace("{name: y2,", "{name: z, count: 1000,").replace("address: 4}", "address: 100}")
    tags = loads(many)
    assert len(tags.outputs) == 1001
    assert tags.outputs[1000].name == "z999"
    assert tags.outputs[1000].at.address == 100 + 999 * 2


@pytest.mark.parametrize("plant", ["wscc9", "net3"])
def test_the_tag_map_of_a_served_plant_is_valid_and_its_own(plant):
    found = find_plant(plant, {})
    made = tag_map(found, "{kind: modbus}", modbus_places("float64"), registered=plant, options={}, speed=10.0)
    check_registered(loads(made))


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("unit: 'rad/s'", "unit: Hz", r"line 14, column 5: outputs\[0\]: x1 is in 'Hz', the plant's is in 'rad/s'"),
        ("name: c0", "name: c1", r"line 15, .*is called c1, the plant's is c0"),
        ("limits: [-1, 1]", "limits: [-3, 3]", r"line 17, .*reach beyond the plant's \[-1, 1\]"),
        ("sample_time: 0.1", "sample_time: 0.2", r"sample_time is 0.2 s, wscc9 has 0.1 s"),
        ("registered: wscc9", "registered: nosuch", r"unknown plant 'nosuch'"),
    ],
)
def test_names_units_and_limits_must_be_those_of_the_plant(old, new, expected):
    made = tag_map(
        find_plant("wscc9", {}), "{kind: modbus}", modbus_places("float64"), registered="wscc9", options={}, speed=1.0
    )
    changed = made.replace(old, new, 1).replace("max_rate: 20", "max_rate: 60").replace("seconds: 2}", "seconds: 9}")
    with pytest.raises(GatewayError, match=expected):
        check_registered(loads(changed, "site.yaml"))


@settings(max_examples=300, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.data())
def test_a_damaged_map_is_read_or_refused_but_never_crashes(text, data):
    kind = data.draw(st.sampled_from(["cut", "insert", "replace", "double"]))
    i = data.draw(st.integers(0, len(text)))
    junk = data.draw(
        st.text(max_size=8) | st.sampled_from(["&a *a", "<<: *x", "!!python/object:os.system", "[[[", "\0", "\t"])
    )
    j = data.draw(st.integers(i, min(len(text), i + 30)))
    damaged = {"cut": text[:i] + text[j:], "insert": text[:i] + junk + text[i:], "replace": text[:i] + junk + text[j:],
               "double": text[:j] + text[i:]}[kind]  # fmt: skip
    with suppress(GatewayError):
        loads(damaged)


@given(st.text(max_size=200))
@settings(max_examples=200, deadline=None)
def test_any_text_is_read_or_refused(text):
    with pytest.raises(GatewayError):
        loads(text)


@pytest.mark.parametrize(
    "bomb",
    [
        "[" * 100_000,
        "a: &a [*a]",
        "a: &a [x,x]\nb: &b [*a,*a]\nc: &c [*b,*b]\nplant: *c",
        "? [a, b]\n: 1",
        "a: " + "x" * 5_000_000,
    ],
    ids=["deep", "cycle", "laughs", "odd key", "large"],
)
def test_bombs(bomb):
    with pytest.raises(GatewayError):
        loads(bomb)
