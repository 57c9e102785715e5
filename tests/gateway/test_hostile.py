# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Servers that send anything at all: every answer is a scan or a LinkError, in time, and nothing else happens."""

import asyncio
from datetime import UTC, datetime

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ros2_deepc.gateway import LinkError, loads
from ros2_deepc.gateway.assemble import Assembler, Quality, Scan
from ros2_deepc.gateway.field import find_plant
from ros2_deepc.gateway.field_tags import modbus_places, tag_map
from ros2_deepc.gateway.link import make_link

ua = pytest.importorskip("asyncua").ua
pytest.importorskip("pymodbus")
from ros2_deepc.gateway.opcua_link import take  # noqa: E402 - needs the extra


async def tries(link, count, deadline):
    """How often a link failed and how often it read a scan; each try must end before the deadline [s]."""
    failed = 0
    for _ in range(count):
        try:
            async with asyncio.timeout(deadline):
                await link.connect()
                scan = await link.read()
            assert len(scan.raw) == len(scan.quality) == len(scan.source_ns)
        except LinkError:
            failed += 1
    await link.close()
    return failed, count - failed


def test_a_modbus_server_that_babbles(free_port):
    port = free_port()
    text = tag_map(find_plant("wscc9", {}), f"{{kind: modbus, host: 127.0.0.1, port: {port}, timeout: 0.02}}",
                   modbus_places("float32"), registered="wscc9", options={})  # fmt: skip
    rng = np.random.Generator(np.random.PCG64(1))

    async def babble(reader, writer):
        while request := await reader.read(1000):
            head = request[:7] if rng.random() < 0.5 else rng.bytes(7)
            writer.write(head + rng.bytes(int(rng.integers(0, 300))))
            if rng.random() < 0.3:
                break
        writer.close()

    async def run():
        server = await asyncio.start_server(babble, "127.0.0.1", port)
        try:
            return await tries(make_link(loads(text)), 60, 60.0)
        finally:
            server.close()
            await server.wait_closed()

    failed, _ = asyncio.run(run())
    assert failed > 30


OPCUA = """\
plant: {{name: p, sample_time: 0.1}}
link: {{kind: opcua, url: 'opc.tcp://127.0.0.1:{port}', allow_insecure_loopback: true, timeout: 0.1}}
outputs:
  - {{name: y, unit: '', at: {{node: 'nsu=urn:p;s=y'}}}}
  - {{name: a, unit: '', count: 3, at: {{node: 'nsu=urn:p;s=a'}}}}
inputs:
  - {{name: u, unit: '', limits: [-1, 1], max_rate: 9, safe: 0, at: {{node: 'nsu=urn:p;s=u'}}}}
"""


def test_an_opcua_server_whose_bytes_are_damaged_on_the_way(free_port):
    """From the first handshake on: flipped, lost, doubled and invented bytes."""
    from ros2_deepc.gateway.opcua_server import Access, OpcuaServer

    port, true = free_port(), free_port()
    rng = np.random.Generator(np.random.PCG64(3))

    def damage(data):
        data = bytearray(data)
        i = int(rng.integers(len(data)))
        match int(rng.integers(5)):
            case 0:
                data[i] ^= 1 << int(rng.integers(8))
            case 1:
                data[i : i + 4] = rng.bytes(4)
            case 2:
                del data[i:]
            case 3:
                data[i:i] = data[: int(rng.integers(40))]
            case 4:
                data[4:8] = int(rng.integers(2**32)).to_bytes(4, "little")  # the length of the message
        return bytes(data)

    async def pump(reader, writer, change):
        try:
            while data := await reader.read(65536):
                writer.write(damage(data) if change and rng.random() < 0.25 else data)
        except OSError:
            pass
        finally:
            writer.close()

    async def between(reader, writer):
        there, back = await asyncio.open_connection("127.0.0.1", true)
        await asyncio.gather(pump(reader, back, False), pump(there, writer, True))

    async def run():
        server = OpcuaServer("p", "urn:p", f"opc.tcp://127.0.0.1:{true}", Access())
        await server.start({"y": 1.0, "a": [1.0, 2.0, 3.0], "u": 0.0})
        relay = await asyncio.start_server(between, "127.0.0.1", port)
        try:
            return await tries(make_link(loads(OPCUA.format(port=port))), 25, 60.0)
        finally:
            relay.close()
            await relay.wait_closed()
            await server.stop()

    failed, read = asyncio.run(run())
    assert failed > 5
    assert read > 0


NUMBERS = {"SByte": 8, "Int16": 16, "Int32": 32, "Int64": 64}
FLOATS = st.floats() | st.sampled_from([float("nan"), float("inf"), -float("inf"), 1.7976931348623157e308])
scalars = {
    "Boolean": st.booleans(),
    "Double": FLOATS,
    "Float": st.floats(width=32),
    "String": st.text(max_size=5) | st.none(),
    "ByteString": st.binary(max_size=5) | st.none(),
    "Guid": st.uuids(),
    "DateTime": st.datetimes(datetime(1601, 1, 2), datetime(9999, 1, 1)),
    "NodeId": st.integers(0, 255).map(ua.NodeId),
    "StatusCode": st.integers(0, 2**32 - 1).map(ua.StatusCode),
    "LocalizedText": st.text(max_size=5).map(ua.LocalizedText),
} | {kind: st.integers(-(2 ** (n - 1)), 2 ** (n - 1) - 1) for kind, n in NUMBERS.items()}
scalars |= {("U" + kind).replace("USByte", "Byte"): st.integers(0, 2**n - 1) for kind, n in NUMBERS.items()}


@st.composite
def answers(draw):
    """What a server may say of a value: any type, a scalar, an array or a matrix, any status, any time, or nothing."""
    kind = draw(st.sampled_from(sorted(scalars)))
    value = draw(scalars[kind] | st.lists(scalars[kind], max_size=4))
    dimensions = None
    if isinstance(value, list) and len(value) == 4 and draw(st.booleans()):
        value, dimensions = [value[:2], value[2:]], [2, 2]
    if isinstance(value, list) or value is not None:
        variant = ua.Variant(value, ua.VariantType[kind], dimensions, isinstance(value, list))
    else:
        variant = ua.Variant()
    time = draw(st.none() | st.datetimes(datetime(1601, 1, 2), datetime(9999, 1, 1)))
    return ua.DataValue(
        draw(st.sampled_from([variant, None])), draw(st.integers(0, 2**32 - 1).map(ua.StatusCode)), SourceTimestamp=time
    )


@given(answers(), st.integers(-1, 5))
@settings(max_examples=150, deadline=None)
def test_any_value_is_a_number_or_none(answer, index):
    raw, quality, source = take(answer, index)
    assert isinstance(raw, float)
    assert abs(source) < 2**63
    assert quality in (Quality.GOOD, Quality.UNCERTAIN, Quality.BAD)
    value = answer.Value.Value if answer.Value is not None else None
    if index >= 0:
        value = value[index] if isinstance(value, list) and index < len(value) else None
    expected = float(value) if isinstance(value, (bool, int, float)) else np.nan
    np.testing.assert_equal(raw, expected)
    time = answer.SourceTimestamp
    if time is not None and 1980 < time.year < 2200:
        assert source / 1e9 == pytest.approx(time.replace(tzinfo=UTC).timestamp())


@given(answers(), st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)), max_size=4))
@settings(max_examples=150, deadline=None)
def test_bytes_that_still_decode_after_damage_are_taken_or_refused(answer, damage):
    """Whatever asyncua makes of damaged bytes, be it no DataValue at all, ``take`` takes."""
    from asyncua.ua.ua_binary import Buffer, struct_from_binary, struct_to_binary

    data = bytearray(struct_to_binary(answer))
    for where, byte in damage:
        data[where % len(data)] = byte
    try:
        damaged = struct_from_binary(ua.DataValue, Buffer(bytes(data)))
    except Exception:  # the library refuses in many words; the link makes a LinkError of each
        return
    raw, quality, source = take(damaged, -1)
    assert isinstance(raw, float)
    assert quality in tuple(Quality)
    assert abs(source) < 2**63


@pytest.mark.parametrize("answer", [None, 1.0, ua.DataValue(), ua.DataValue(ua.Variant("1"))])
def test_what_is_no_value_is_bad_once_assembled(answer, text):
    raw, quality, source = take(answer, -1)
    assert raw != raw
    tags = loads(text)
    n = len(tags.reads)
    scan = Scan(
        raw=np.full(n, raw), quality=np.full(n, quality, dtype=np.uint8), source_ns=np.full(n, source, dtype=np.int64)
    )
    assert (Assembler(tags).take(scan, 0.0, 10**18).quality == Quality.BAD).all()
