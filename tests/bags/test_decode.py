# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The decoder against two that others wrote, on random types and on every type that is installed."""

import sys
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from ros2_deepc.bags import BagError
from ros2_deepc.bags.convert import message_class, to_cdr
from ros2_deepc.bags.decode import Decoder, parse_definition
from ros2_deepc.bags.schema import SEPARATOR, message_definition, type_hash

NUMBERS = ["bool", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64"]
SIZES = {"": 0, "[]": 0, "[<=5]": 0, "[3]": 3}
BASES = [*NUMBERS, "string", "x_msgs/Inner"]
INNER = "uint8 a\nstring b\nfloat64 c"
LETTERS = "aZ0 äß€漢🦉"


def value(rng, base, size):
    """A value of a field: a number, a text, an Inner as a tuple, or an array of them."""
    if size:
        items = [value(rng, base, "") for _ in range(SIZES[size] or rng.integers(6))]
        return np.array(items, dtype=base) if base in NUMBERS else items
    if base == "x_msgs/Inner":
        return value(rng, "uint8", ""), value(rng, "string", ""), value(rng, "float64", "")
    if base == "string":
        return "".join(rng.choice(list(LETTERS), rng.integers(9)))
    if base == "bool":
        return bool(rng.integers(2))
    if base.startswith("float"):
        special = [np.nan, np.inf, -0.0, 5e-324, np.finfo(base).max]
        return float(np.dtype(base).type(rng.choice([*special, *rng.standard_normal(5)])))
    bounds = np.iinfo(base)
    return int(rng.integers(bounds.min, bounds.max, dtype=base, endpoint=True))


def message(rng):
    """A random type with one nested type: its text, and a value for each field."""
    fields = [(rng.choice(BASES), rng.choice(list(SIZES))) for _ in range(rng.integers(1, 12))]
    lines = [f"{base}{size} f{i}  # comment" for i, (base, size) in enumerate(fields)]
    lines.insert(rng.integers(len(lines) + 1), "uint8 CONSTANT=7")
    return "\n".join(lines), [value(rng, base, size) for base, size in fields]


def same(found, expected) -> bool:
    if isinstance(expected, list | np.ndarray):
        return len(found) == len(expected) and all(map(same, found, expected))
    if isinstance(expected, tuple):
        return all(map(same, (found.a, found.b, found.c), expected))
    return found == expected or (found != found and expected != expected)


@pytest.mark.parametrize("seed", range(40))
def test_random_types_as_rosbags_writes_them(seed):
    rng = np.random.Generator(np.random.PCG64(seed))
    text, given_values = message(rng)
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(INNER, "x_msgs/msg/Inner"))
    store.register(get_types_from_msg(text, "x_msgs/msg/Outer"))
    outer, nested = store.types["x_msgs/msg/Outer"], store.types["x_msgs/msg/Inner"]

    def theirs(item):
        if isinstance(item, tuple):
            return nested(*item)
        return [theirs(v) for v in item] if isinstance(item, list) else item

    filled = outer(*(theirs(v) for v in given_values))
    decoder = Decoder("x_msgs/msg/Outer", f"{text}\n{SEPARATOR}\nMSG: x_msgs/Inner\n{INNER}")
    for little in (True, False):
        data = bytes(store.serialize_cdr(filled, "x_msgs/msg/Outer", little_endian=little))
        found = decoder(data)
        for i, expected in enumerate(given_values):
            assert same(getattr(found, f"f{i}"), expected), (i, expected)
        assert len(data) - 3 <= decoder.size(data) <= len(data)  # rosbags may pad the end


def installed() -> list[str]:
    share = Path(sys.prefix) / "share"
    return sorted(f"{p.parts[-3]}/msg/{p.stem}" for p in share.glob("*/msg/*.msg") if "WString" not in p.stem)


@pytest.mark.parametrize("package", sorted({name.split("/")[0] for name in installed()}))
def test_every_installed_type_decodes_its_default(package):
    count = 0
    for name in installed():
        if not name.startswith(f"{package}/"):
            continue
        message = message_class(name)()
        found = Decoder(name, message_definition(name))(to_cdr(message))
        expected = message.get_fields_and_field_types()
        assert set(vars(found)) == (set(expected) or {"structure_needs_at_least_one_member"})
        count += 1
    assert count


@pytest.mark.parametrize("kind", ["Sample", "PlantInfo", "ControllerState", "MonitorReport", "Verdict"])
def test_type_hash_is_that_of_the_definition(kind):
    name = f"deepc_msgs/msg/{kind}"
    store = get_typestore(Stores.EMPTY)
    text = message_definition(name)
    first, *rest = text.split(SEPARATOR)
    store.register(get_types_from_msg(first, name))
    for part in rest:
        head, _, body = part.strip("\n").partition("\n")
        store.register(get_types_from_msg(body, head.removeprefix("MSG: ").replace("/", "/msg/")))
    assert type_hash(name) == store.hash_rihs01(name)


def test_definition_is_concatenated_as_rosbag2_does():
    text = message_definition("deepc_msgs/msg/MonitorReport")
    heads = [line for line in text.splitlines() if line.startswith("MSG: ")]
    assert heads == ["MSG: deepc_msgs/Verdict", "MSG: std_msgs/Header", "MSG: builtin_interfaces/Time"]
    assert text.count("=" * 80) == 3
    assert "# What the live data prove" in text  # comments stay
    assert type_hash("nobody_msgs/msg/Nothing") == ""


def test_definitions_are_looked_for_in_order(tmp_path):
    for folder, field in (("a", "int8 x"), ("b", "int8 y")):
        (tmp_path / folder / "x_msgs" / "msg").mkdir(parents=True)
        (tmp_path / folder / "x_msgs" / "msg" / "T.msg").write_text(field)
    assert message_definition("x_msgs/msg/T", [tmp_path / "a", tmp_path / "b"]) == "int8 x"
    assert message_definition("x_msgs/msg/T", [tmp_path / "b"]) == "int8 y"
    with pytest.raises(BagError, match="no definition of x_msgs/msg/U under"):
        message_definition("x_msgs/msg/U", [tmp_path / "a"])


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=60))
def test_bytes_of_no_sense_are_one_clear_error(data):
    decoder = Decoder("deepc_msgs/msg/Verdict", message_definition("deepc_msgs/msg/Verdict"))
    with suppress(BagError):  # no other exception
        assert isinstance(decoder(data), SimpleNamespace)


@pytest.mark.parametrize(("text", "words"), [
    ("int32", "cannot read the line 'int32'"),
    ("wstring w", "wstring is not supported"),
    ("x_msgs/Lost l", "the definition of x_msgs/Lost is missing"),
])  # fmt: skip
def test_wrong_definitions(text, words):
    with pytest.raises(BagError, match=words):
        Decoder("x_msgs/msg/T", text)


def test_defaults_bounds_and_constants():
    text = 'string<=9 name "a b"\nint32 n 5\nfloat64[<=3] v [1.0, 2.0]\nint8 A=1\nstring B="x # y"\nT2[2] two\n' + (
        f"{SEPARATOR}\nMSG: x_msgs/T2\nbool b true\n"
    )
    types = parse_definition("x_msgs/msg/T", text)
    fields = [(f.name, f.type, f.length) for f in types["x_msgs/T"]]
    expected = [("name", "string", None), ("n", "int32", None), ("v", "float64", 0), ("two", "x_msgs/T2", 2)]
    assert fields == expected
    assert [f.name for f in types["x_msgs/T2"]] == ["b"]
