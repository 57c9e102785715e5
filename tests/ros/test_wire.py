# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Samples written and read without message objects are those that ROS writes and reads."""

import struct

import numpy as np
import pytest
from deepc_msgs.msg import Sample
from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message

from ros2_deepc.ros.convert import refusal, sample
from ros2_deepc.ros.run import Spinner, make_executor, ros
from ros2_deepc.ros.wire import pack, reading, unpack

LETTERS = ["a", "Z", "_", "é", "漢", "🌊"]


def arguments(rng):
    """Of any sample that can be said."""
    return {
        "frame": "".join(rng.choice(LETTERS, rng.integers(0, 9))),
        "epoch": int(rng.integers(2**32)),
        "k": int(rng.integers(2**64, dtype=np.uint64)),
        "values": rng.integers(0, 2**64, rng.integers(0, 70), dtype=np.uint64).view(np.float64),  # any bits, NaN too
        "time_ns": int(rng.integers(2**31 * 10**9)),
        "held": int(rng.integers(2**32)),
        "sender": int(rng.integers(2**64, dtype=np.uint64)),
    }


def fields(msg):
    bits = np.array(msg.values, dtype=np.float64).view(np.uint64).tolist()
    return msg.header, msg.epoch, msg.k, bits, list(msg.quality), msg.sender, msg.held


def test_what_is_written_is_what_ros_reads():
    rng = np.random.default_rng(1)
    for _ in range(500):
        given = arguments(rng)
        data = pack(**given)
        assert fields(deserialize_message(data, Sample)) == fields(sample(**given))
        assert len(data) <= len(serialize_message(sample(**given)))


def test_what_ros_writes_is_read():
    rng = np.random.default_rng(2)
    for _ in range(500):
        msg = sample(**arguments(rng))
        msg.quality = rng.integers(0, 4, rng.integers(0, 9), dtype=np.uint8).tolist()
        assert fields(unpack(bytes(serialize_message(msg)))) == fields(msg)


def test_what_a_machine_of_the_other_byte_order_writes_is_read():
    data = b"\x00\x00\x00\x00" + struct.pack(">iII2s2xI4xQI4xddI4xQI", 3, 4, 2, b"p\0", 5, 6, 2, 0.5, -1.5, 0, 7, 8)
    msg = unpack(data)
    assert (msg.time_ns, msg.frame, msg.epoch, msg.k, msg.values) == (3_000_000_004, "p", 5, 6, (0.5, -1.5))
    assert (list(msg.quality), msg.sender, msg.held) == ([], 7, 8)


def test_bytes_that_are_no_sample_are_refused_like_one_of_the_wrong_size():
    rng = np.random.default_rng(3)
    good = pack("p", 1, 2, np.array([0.5, 1.5]), 3)
    for length in range(len(good)):
        assert refusal(unpack(good[:length]), 2)
    for place, value in ((12, 0xFF), (15, 0xFF), (36, 3), (39, 0xFF), (60, 0xFF)):  # lengths that point beyond the end
        spoiled = bytearray(good)
        spoiled[place] = value
        assert refusal(unpack(bytes(spoiled)), 2)
    for _ in range(2000):  # whatever it is, it is read as something
        unpack(rng.integers(0, 256, rng.integers(0, 99), dtype=np.uint8).tobytes())


@pytest.mark.parametrize("kind", ["events", "single"])
def test_both_ways_over_dds(domain_id, kind):
    with ros([], domain_id) as context:
        node = Node("both", context=context, use_global_arguments=False)
        executor = make_executor(kind, context)
        executor.add_node(node)
        heard, read = [], []
        publisher = node.create_publisher(Sample, "x", 10)
        node.create_subscription(Sample, "x", heard.append, 10)
        node.create_subscription(Sample, "x", reading(read.append), 10, raw=True)
        spinner = Spinner(executor)
        spinner.until(lambda: publisher.get_subscription_count() == 2)
        values = np.array([1 / 3, -0.0, 5e-324])
        publisher.publish(pack("zone", 1, 2, values, 3, 4, 5))
        publisher.publish(b"\x00\x01\x00\x00 no sample at all")
        spinner.until(lambda: heard and len(read) == 2)
        assert fields(heard[0]) == fields(read[0]) == fields(sample("zone", 1, 2, values, 3, 4, 5))
        assert refusal(read[1], 3)
        executor.shutdown()
        node.destroy_node()
