# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Many messages decoded by column are what each gives when it is decoded alone, whatever their lengths and damage."""

from types import SimpleNamespace

import numpy as np
import pytest
from deepc_msgs.msg import ControllerState, MonitorReport, Sample
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from ros2_deepc.bags import BagError
from ros2_deepc.bags.convert import to_cdr, type_name
from ros2_deepc.bags.decode import decoder
from ros2_deepc.bags.messages import Messages
from ros2_deepc.bags.outline import Block, outliner
from ros2_deepc.bags.schema import message_definition


def block_of(kind, encoded):
    """A block of messages that lie in one buffer with rubbish between them."""
    sizes = np.array([len(d) for d in encoded])
    start = np.cumsum([3, *(sizes[:-1] + 5)])
    buffer = b"...".join([b"", *(d + b"--" for d in encoded)])
    zero = np.zeros(len(encoded))
    name = type_name(kind)
    messages = Messages(buffer, start, sizes, zero.astype("u2"), zero.astype("u8"), zero.astype("u8"))
    return Block(messages, outliner(name, message_definition(name)))


def numbers(value, path="", out=None):
    """Every number and array of numbers of a decoded message, by path."""
    out = {} if out is None else out
    if isinstance(value, SimpleNamespace):
        for name, inner in vars(value).items():
            numbers(inner, f"{path}.{name}" if path else name, out)
    elif isinstance(value, list):
        for i, inner in enumerate(value):
            numbers(inner, f"{path}[{i}]", out)
    elif not isinstance(value, str):
        out[path] = value
    return out


def random_message(rng, kind):
    words = "ä" * int(rng.integers(4)) + "b" * int(rng.integers(5))
    if kind is Sample:
        message = Sample(epoch=int(rng.integers(9)), k=int(rng.integers(2**63)) * 2, held=int(rng.integers(2**32)))
        message.values = rng.standard_normal(int(rng.integers(4))).tolist()
        message.quality = rng.integers(0, 4, int(rng.integers(3))).tolist()
    elif kind is ControllerState:
        message = ControllerState(k=int(rng.integers(99)), reason=words, limited=bool(rng.integers(2)))
        message.reference, message.input_plan = [1.5] * int(rng.integers(3)), rng.random(int(rng.integers(3))).tolist()
        message.solve_time = float(rng.random())
    elif kind is MonitorReport:
        message = MonitorReport(k=int(rng.integers(99)), data_age=float("nan"))
        message.c_observability.reason, message.c_observability.margin = words, float(rng.random())
        message.modes_re = rng.random(int(rng.integers(3))).tolist()
    else:
        pairs = [KeyValue(key=words, value="v") for _ in range(rng.integers(3))]
        status = [DiagnosticStatus(level=b"\x02", message=words, values=pairs) for _ in range(rng.integers(3))]
        message = DiagnosticArray(status=status)
    message.header.stamp.sec, message.header.frame_id = int(rng.integers(2**31)), words
    return message


@pytest.mark.parametrize("kind", [Sample, ControllerState, MonitorReport, DiagnosticArray])
@pytest.mark.parametrize("seed", range(3))
def test_columns_are_the_messages(kind, seed):
    rng = np.random.Generator(np.random.PCG64(seed))
    encoded = [to_cdr(random_message(rng, kind)) for _ in range(150)]
    block = block_of(kind, encoded)
    decode = decoder(type_name(kind), message_definition(type_name(kind)))
    expected = [numbers(decode(data)) for data in encoded]
    assert block.bad == []
    for path in {path for message in expected for path in message}:
        values = [message.get(path) for message in expected]
        if any(isinstance(v, np.ndarray) for v in values):
            found, widths = block.vectors(path)
            assert widths.tolist() == [0 if v is None else len(v) for v in values]
            for row, width, v in zip(found, widths, values, strict=True):
                np.testing.assert_array_equal(row[:width], [] if v is None else v)
                assert np.isnan(row[width:]).all()
        elif all(isinstance(v, int) for v in values):
            assert block.column(path, np.uint64, 0).tolist() == values
        else:
            np.testing.assert_array_equal(block.column(path), [np.nan if v is None else v for v in values])
    assert np.isnan(block.column("no.such.field")).all()
    assert block.vectors("no_such_field")[0].shape == (150, 0)


@pytest.mark.parametrize("kind", [Sample, ControllerState, MonitorReport, DiagnosticArray])
def test_damage_is_found_in_the_same_messages(kind):
    """Cut short, or with a byte changed: both ways of decoding refuse the same ones, or give the same numbers."""
    rng = np.random.Generator(np.random.PCG64(5))
    decode = decoder(type_name(kind), message_definition(type_name(kind)))
    encoded = []
    for _ in range(400):
        data = bytearray(to_cdr(random_message(rng, kind)))
        if rng.integers(2):
            data = data[: rng.integers(4, len(data))]
        else:
            data[rng.integers(4, len(data))] = rng.integers(256)
        encoded.append(bytes(data))
    block = block_of(kind, encoded)
    refused = []
    for row, data in enumerate(encoded):
        try:
            decode(data)
        except BagError:
            refused.append(row)
    assert sorted(row for row, _ in block.bad) == refused
    assert 0 < len(refused) < len(encoded)
    k = block.column("k", np.uint64, 7) if kind is not DiagnosticArray else None
    if k is not None:
        assert [int(k[row]) for row in range(len(encoded)) if row not in refused] == [
            decode(data).k for row, data in enumerate(encoded) if row not in refused
        ]


def test_big_endian_messages():
    text = "uint16 a\nfloat64[] b\n"
    data = b"\x00\x00\x00\x00" + b"\x01\x02" + b"\0\0" + (2).to_bytes(4, "big") + np.array([1.5, -2.0], ">f8").tobytes()
    zero = np.zeros(2)
    both = Messages(
        data * 2, np.array([0, len(data)]), np.full(2, len(data)), zero, zero.astype("u8"), zero.astype("u8")
    )
    block = Block(both, outliner("x_msgs/msg/Big", text))
    assert block.column("a").tolist() == [258, 258]
    np.testing.assert_array_equal(block.vectors("b")[0], [[1.5, -2.0]] * 2)
