# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""A bag read by code that others wrote: every message of every topic, every field, equal to what was recorded."""

import array
import warnings

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from ros2_deepc.bags import BagReader


def plain(value):
    """A message of any library as nested dicts, lists and numbers."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, np.ndarray | array.array):
        return value.tolist()
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if hasattr(value, "__slots__"):
        return {name: plain(getattr(value, name)) for name in value.__slots__}
    if hasattr(value, "__dict__"):
        return {name: plain(v) for name, v in vars(value).items() if not name.startswith("_")}
    return value.item() if isinstance(value, np.generic) else value


def same(found, expected) -> bool:
    if isinstance(expected, dict):
        return all(same(found[name], value) for name, value in expected.items())
    if isinstance(expected, list):
        return len(found) == len(expected) and all(map(same, found, expected))
    return found == expected or (found != found and expected != expected)


@pytest.fixture
def bag(record):
    return record(K=60, collect=30, metadata={"seed": "1", "note": "grün"})


@pytest.fixture
def expected(bag):
    return [(f"/grid/{name}", plain(message)) for name, message in bag.messages]


def check(found, expected):
    found = list(found)
    assert len(found) == len(expected)
    for (topic, message), (wanted_topic, wanted) in zip(found, expected, strict=True):
        assert topic == wanted_topic
        assert same(plain(message), wanted), topic


def test_rosbags_reads_every_field(bag, expected):
    with AnyReader([bag.folder], default_typestore=get_typestore(Stores.EMPTY)) as reader:
        check(((c.topic, reader.deserialize(data, c.msgtype)) for c, _, data in reader.messages()), expected)


def test_rosbags_reads_the_folder_metadata(bag, expected):
    with Reader(bag.folder) as reader:
        assert reader.message_count == len(expected)
        assert {c.topic: c.msgcount for c in reader.connections} == {
            t.name: t.count for t in BagReader(bag.folder).topics.values()
        }
        assert reader.ros_distro == "kilted"
        qos = reader.connections[0].ext.offered_qos_profiles
        assert qos[0].reliability.name == "RELIABLE"
        assert qos[0].deadline.sec == 9223372036


def test_mcap_ros2_support_reads_every_field(bag, expected):
    with open(next(bag.folder.glob("*.mcap")), "rb") as stream, warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        check(((channel.topic, m) for _, channel, _, m in reader.iter_decoded_messages()), expected)


def test_our_own_decoder_reads_every_field(bag, expected):
    check(((raw.topic, message) for raw, message in BagReader(bag.folder).decoded()), expected)


def test_the_file_says_what_rosbag2_expects(bag):
    with open(next(bag.folder.glob("*.mcap")), "rb") as stream:
        reader = make_reader(stream)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        metadata = {m.name: m.metadata for m in reader.iter_metadata()}
    assert {c.message_encoding for c in summary.channels.values()} == {"cdr"}
    assert {s.encoding for s in summary.schemas.values()} == {"ros2msg"}
    assert {c.compression for c in summary.chunk_indexes} == {"zstd"}
    channel = next(c for c in summary.channels.values() if c.topic == "/grid/outputs")
    assert channel.metadata["topic_type_hash"].startswith("RIHS01_")
    assert yaml.safe_load(channel.metadata["offered_qos_profiles"])[0]["history"] == "keep_last"
    inside = yaml.safe_load(metadata["rosbag2"]["serialized_metadata"])
    outside = yaml.safe_load((bag.folder / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert inside == outside
    assert outside["version"] == 9
    assert outside["custom_data"] == {"seed": "1", "note": "grün"}
    assert metadata["ros2_deepc"] == {"seed": "1", "note": "grün"}
