# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Bags recorded by others (here: written by rosbags) become (u, y) data that the monitors can use."""

import numpy as np
import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from ros2_deepc.bags import BagError
from ros2_deepc.bags.mapping import Channel, load_signals
from ros2_deepc.monitors import Prior, Verdict, analyze

TYPES = get_typestore(Stores.ROS2_JAZZY)
K, TS = 300, 0.5


def plant(seed=3):
    """u (K, 2), y (K, 2) of a controllable and observable second-order plant."""
    rng = np.random.Generator(np.random.PCG64(seed))
    A, B = np.array([[0.9, 0.2], [-0.1, 0.8]]), np.array([[0.3, 0.0], [0.1, 0.5]])
    u, y, x = rng.uniform(-1, 1, (K, 2)), np.zeros((K, 2)), np.array([1.0, -1.0])
    for k in range(K):
        y[k], x = x, A @ x + B @ u[k]
    return u, y


@pytest.fixture(scope="module", params=["none", "zstd"])
def foreign(request, tmp_path_factory):
    """Inputs in one Float64MultiArray, outputs in a Float64 and in a PointStamped, each on its own jittering clock."""
    folder = tmp_path_factory.mktemp("foreign") / "bag"
    u, y = plant()
    rng = np.random.Generator(np.random.PCG64(9))
    types = TYPES.types
    bag = Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP)
    if request.param == "zstd":
        bag.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with bag:
        names = {"/plc/u": "std_msgs/msg/Float64MultiArray", "/plc/level": "std_msgs/msg/Float64",
                 "/gps": "geometry_msgs/msg/PointStamped", "/noise": "std_msgs/msg/String"}  # fmt: skip
        conn = {n: bag.add_connection(n, t, typestore=TYPES) for n, t in names.items()}

        def write(topic, message, time):
            bag.write(conn[topic], round(time * 1e9) + 10**18, TYPES.serialize_cdr(message, names[topic]))

        layout = types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
        for k in range(K):
            late = rng.uniform(0, 0.2, 3)
            stamp = types["builtin_interfaces/msg/Time"](sec=10**9, nanosec=0)
            stamp.sec, stamp.nanosec = 10**9 + int(k * TS), round(k * TS % 1 * 1e9)
            header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="")
            point = types["geometry_msgs/msg/Point"](x=0.0, y=float(y[k, 1]), z=0.0)
            write(
                "/plc/u",
                types["std_msgs/msg/Float64MultiArray"](layout=layout, data=np.r_[7.0, u[k]]),
                k * TS + late[0],
            )
            write("/plc/level", types["std_msgs/msg/Float64"](data=float(y[k, 0])), k * TS + late[1])
            write("/gps", types["geometry_msgs/msg/PointStamped"](header=header, point=point), k * TS + late[2])
            write("/noise", types["std_msgs/msg/String"](data="x"), k * TS)
    return folder, u, y


INPUTS, OUTPUTS = ["/plc/u:data[1]", "/plc/u:data[2]"], ["/plc/level", "/gps:point.y"]


def test_channels_become_data_that_prove_something(foreign):
    folder, u, y = foreign
    signals = load_signals(folder, INPUTS, OUTPUTS, sample_time=TS, phase=0.2)  # later than any jitter
    rows = len(signals.t)
    assert rows >= K - 1
    np.testing.assert_array_equal(signals.u, u[:rows])
    np.testing.assert_array_equal(signals.y, y[:rows])
    report = analyze(signals.u, signals.y, prior=Prior(q=2, s=1, n=2))
    assert report.r_controllability.verdict is Verdict.PROVED
    assert report.r_observability.verdict is Verdict.PROVED


def test_period_and_age(foreign):
    signals = load_signals(foreign[0], INPUTS, OUTPUTS)
    assert signals.sample_time == pytest.approx(TS, rel=0.2)  # the median of a jittering clock
    signals = load_signals(foreign[0], INPUTS, OUTPUTS, sample_time=TS)
    assert (signals.age >= 0).all()
    assert signals.age.max() < TS + 0.2


def test_header_clock(foreign):
    signals = load_signals(foreign[0], ["/gps:point.x"], ["/gps:point.y"], stamps="header")
    assert signals.sample_time == TS
    np.testing.assert_array_equal(signals.y[:, 0], foreign[2][:, 1])
    with pytest.raises(BagError, match="have no header"):
        load_signals(foreign[0], INPUTS, OUTPUTS, stamps="header")


@pytest.mark.parametrize(("inputs", "outputs", "words"), [
    (["/none"], ["/gps:point.y"], "has no topic /none; it has /gps"),
    (["/plc/u:data[9]"], ["/gps:point.y"], "is no number"),
    (["/plc/u:nothing"], ["/gps:point.y"], "the message has layout, data"),
    (["/plc/u"], ["/gps:point.y"], "/plc/u:data is no number"),
    (["/noise"], ["/gps:point.y"], "is no number"),
    ([], ["/gps:point.y"], "at least one input"),
    (["plc"], ["/gps:point.y"], "write /topic"),
    (["/plc/u:data[x]"], ["/gps:point.y"], "write /topic"),
])  # fmt: skip
def test_wrong_channels_are_one_line(foreign, inputs, outputs, words):
    with pytest.raises(BagError) as caught:
        load_signals(foreign[0], inputs, outputs)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_other_clock_and_missing_period(foreign):
    with pytest.raises(BagError, match="one of log, publish, header"):
        load_signals(foreign[0], INPUTS, OUTPUTS, stamps="wall")


def test_channel_text():
    assert Channel.parse("/a/b") == Channel("/a/b", "")
    assert Channel.parse("/a:x.y[3].z") == Channel("/a", "x.y[3].z")


@pytest.mark.parametrize("mode", [CompressionMode.FILE, CompressionMode.MESSAGE])
def test_compression_that_hides_the_messages_is_refused(tmp_path, mode):
    bag = Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP)
    bag.set_compression(mode, CompressionFormat.ZSTD)
    with bag:
        bag.add_connection("/a", "std_msgs/msg/Float64", typestore=TYPES)
    with pytest.raises(BagError, match=f"compressed by {mode.name.lower()}"):
        load_signals(tmp_path / "bag", ["/a"], ["/a"])


def test_sqlite_bag_is_refused_with_advice(tmp_path):
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.SQLITE3) as bag:
        bag.add_connection("/a", "std_msgs/msg/Float64", typestore=TYPES)
    with pytest.raises(BagError, match="convert it first"):
        load_signals(tmp_path / "bag", ["/a"], ["/a"])
