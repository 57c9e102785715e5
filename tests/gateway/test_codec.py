# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Numbers in registers, against struct; blocks, against what they must cover; field paths; assembly."""

import math
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ros2_deepc.gateway import LinkError, loads
from ros2_deepc.gateway import modbus_codec as codec
from ros2_deepc.gateway.assemble import Assembler, Quality, Scan
from ros2_deepc.gateway.modbus_codec import Block
from ros2_deepc.gateway.round_trip import RoundTrip

STRUCT = {"int16": "h", "uint16": "H", "int32": "i", "uint32": "I", "float32": "f", "float64": "d"}


def by_struct(value, kind, order):
    """The registers of one number by the standard library: words and bytes of words turned round by hand."""
    big = struct.pack(">" + STRUCT[kind], value)
    words = [big[i : i + 2] for i in range(0, len(big), 2)]
    if order in ("CDAB", "DCBA"):
        words.reverse()
    if order in ("BADC", "DCBA"):
        words = [word[::-1] for word in words]
    return [int.from_bytes(word, "big") for word in words]


@pytest.mark.parametrize("order", codec.WORD_ORDERS)
@pytest.mark.parametrize("kind", codec.TYPES)
@given(st.data())
@settings(max_examples=40, deadline=None)
def test_registers_are_those_of_struct_and_come_back(kind, order, data):
    low, high = codec.bounds(kind)
    if codec.whole(kind):
        values = data.draw(st.lists(st.integers(int(low), int(high)), min_size=1, max_size=5))
    else:
        values = data.draw(st.lists(st.floats(low, high, width=codec.size(kind) * 16), min_size=1, max_size=5))
    registers = codec.encode(values, kind, order)
    assert registers == [word for value in values for word in by_struct(value, kind, order)]
    np.testing.assert_array_equal(codec.decode(registers, kind, order), np.array(values, dtype=np.float64))


@pytest.mark.parametrize(("kind", "value"), [("int16", 40000), ("uint16", -1), ("float32", 1e39), ("int32", math.nan)])
def test_what_does_not_fit_is_not_written(kind, value):
    with pytest.raises(ValueError, match="does not fit"):
        codec.encode([value], kind)


@given(
    st.lists(st.integers(-5, 70000), max_size=9), st.sampled_from(list(codec.TYPES)), st.sampled_from(codec.WORD_ORDERS)
)
def test_any_registers_decode_or_are_refused(registers, kind, order):
    try:
        numbers = codec.decode(registers, kind, order)
    except LinkError:
        assert len(registers) % codec.size(kind) or min(registers) < 0 or max(registers) > 0xFFFF
    else:
        assert len(numbers) * codec.size(kind) == len(registers)


@given(
    st.lists(
        st.tuples(st.sampled_from(["holding", "input"]), st.integers(0, 400), st.sampled_from([1, 2, 4])), min_size=1
    ),
    st.integers(4, 125),
    st.sampled_from([0, 16]),
)
def test_blocks_cover_every_tag_whole_and_no_request_is_too_large(spans, largest, bridge):
    spans = [Block(table, 1, address, count) for table, address, count in spans]
    found = codec.blocks(spans, largest, bridge=bridge)
    assert all(any(block.covers(span) for block in found) for span in spans)
    assert all(block.count <= largest for block in found)
    if bridge == 0:
        wanted = {(s.table, a) for s in spans for a in range(s.address, s.address + s.count)}
        assert {(b.table, a) for b in found for a in range(b.address, b.address + b.count)} == wanted


def test_a_thousand_numbers_take_sixteen_requests():
    spans = [Block("input", 1, 2 * i, 2) for i in range(1000)]
    assert len(codec.blocks(spans, codec.LARGEST_READ, bridge=16)) == math.ceil(2000 / 124)


def scan(raw, source, counters=2, quality=0):
    n = len(raw) + counters
    return Scan(
        raw=np.array([*raw, *[0] * counters], dtype=float),
        quality=np.full(n, quality, dtype=np.uint8),
        source_ns=np.array([*source, *[0] * counters], dtype=np.int64),
    )


WALL = 1_700_000_000_000_000_000


def test_the_stamp_is_the_oldest_source_time(text):
    assembler = Assembler(loads(text))
    vector = assembler.take(scan([100, 1], [WALL - 30_000_000, WALL - 10_000_000]), 0.0, WALL)
    assert vector.stamp_ns == WALL - 30_000_000
    np.testing.assert_allclose(vector.values, [0.62831853, 2.5])


def test_one_tag_without_news_is_stale_and_the_others_are_not(text):
    assembler = Assembler(loads(text))
    for i in range(8):
        vector = assembler.take(scan([100 + i, 1], [WALL + i * 10**8, WALL]), 0.1 * i, WALL + i * 10**8)
        assert vector.quality.tolist() == [Quality.GOOD, Quality.STALE if 0.1 * i > 0.35 else Quality.GOOD]
    assert "y2 is STALE" in vector.reason


@pytest.mark.parametrize("wrong", [3600 * 10**9, -3600 * 10**9, -WALL + 1])
def test_a_wrong_clock_of_the_field_is_noticed_and_staleness_still_works(text, wrong):
    assembler = Assembler(loads(text))
    for i in range(4):
        vector = assembler.take(scan([1, 1], [WALL + wrong + i * 10**8] * 2), 0.1 * i, WALL + i * 10**8)
        assert vector.good
        assert vector.stamp_ns == WALL + i * 10**8
    assert abs(assembler.clock_error) >= 3600
    for i in range(4, 9):
        vector = assembler.take(scan([1, 1], [WALL + wrong + 3 * 10**8] * 2), 0.1 * i, WALL + i * 10**8)
    assert vector.quality.tolist() == [Quality.STALE] * 2


def test_a_frozen_tag_is_uncertain_if_the_map_says_that_it_must_move(text):
    assembler = Assembler(loads(text.replace("offset: 1.5,", "offset: 1.5, frozen_after: 0.5,")))
    for i in range(9):
        vector = assembler.take(scan([100, 1], [WALL + i * 10**8] * 2), 0.1 * i, WALL + i * 10**8)
    assert vector.quality.tolist() == [Quality.GOOD, Quality.UNCERTAIN]


@given(
    st.lists(st.floats(), min_size=2, max_size=2),
    st.lists(st.integers(0, 2**62), min_size=2, max_size=2),
    st.integers(0, 255),
)
def test_any_numbers_make_a_vector_that_says_how_good_it_is(tag_map, raw, source, quality):
    vector = Assembler(tag_map).take(scan(raw, source, quality=quality), 0.0, WALL)
    fine = np.isfinite(vector.values) & (np.abs(vector.values) <= [10, np.inf])
    assert (vector.quality[~fine] == Quality.BAD).all()
    assert (vector.quality <= Quality.BAD).all()
    assert bool(vector.reason) is not vector.good


def test_round_trips_of_lost_echoes_are_not_counted():
    trip = RoundTrip(0.1)
    for i in range(10):
        trip.sent(i, float(i))
        if i % 2:
            trip.returned(i, i + 0.03)
            trip.returned(i, i + 0.07)  # still standing there at the next look
    assert trip.median == pytest.approx(0.03)
    trip.returned(math.nan, 0.0)
    trip.returned(4, 99.0)  # an old one comes late: it was given up
    assert trip.median == pytest.approx(0.03)
