# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""What the bag holds is what went over the topics: every message of every topic, read by code that others wrote."""

import json
import math
import os
import shutil
import subprocess
from collections import defaultdict
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rclpy.node import Node
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from ros2_deepc.bags import BagReader, BagWriter, provenance, replay
from ros2_deepc.bags.convert import from_cdr, to_cdr
from ros2_deepc.bags.provenance import revision
from ros2_deepc.bags.report import write_report
from ros2_deepc.nodes.config import load, merged, text_of
from ros2_deepc.nodes.replaying import cores
from ros2_deepc.nodes.stack import running
from ros2_deepc.ros import topics
from ros2_deepc.ros.qos import profile

ZONE = "/zone"
STEPS = 120
SPOKEN = (
    topics.PLANT_INFO,
    topics.OUTPUTS,
    topics.INPUTS,
    topics.REFERENCE,
    topics.STATE,
    topics.REPORT,
    topics.INDICATOR,
)
JAVASCRIPT = Path(__file__).parents[1] / "bags" / "js"
SAID = "grüße from the listener"
ROLES = ("recorder", "monitor", "controller", "operator", "plant")


class Listener(Node):
    """Hears everything, as its own subscriber."""

    def __init__(self, **kwargs):
        super().__init__("listener", **kwargs)
        self.heard = defaultdict(list)
        for topic in topics.ALL:
            self.create_subscription(topic.type, topic.name, self._keeps(topic), profile(topic))

    def _keeps(self, topic):
        name = self.resolve_topic_name(topic.name)
        return lambda msg: self.heard[name].append(msg)


def plain(value):
    """A message of any library as nested lists and dictionaries."""
    if isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, (bytes, bytearray)):
        return value[0] if len(value) == 1 else list(value)  # the type `byte`
    if isinstance(value, np.generic):
        return value.item()
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if is_dataclass(value):
        names = [f.name for f in fields(value) if f.name != "__msgtype__" and not f.name.isupper()]  # not the constants
        return {name: plain(getattr(value, name)) for name in names}
    if hasattr(value, "__slots__") and not hasattr(value, "__len__"):
        return {name: plain(getattr(value, name)) for name in value.__slots__}
    if isinstance(value, SimpleNamespace):
        return {name: plain(item) for name, item in vars(value).items()}
    return [plain(item) for item in value]


def same(a, b):
    """Whether all fields are there, and equal to the bit; any NaN equals any NaN."""
    if isinstance(b, dict):
        return set(a) == set(b) and all(same(a[key], b[key]) for key in b)
    if isinstance(b, list):
        return len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
    if isinstance(b, float):
        return (a == b and math.copysign(1, a) == math.copysign(1, b)) or (a != a and b != b)
    return isinstance(a, bool) == isinstance(b, bool) and a == b


@pytest.fixture(scope="module", params=["wscc9", "net3"])
def recorded(tmp_path_factory, domain_id, parameters_of, request):
    """A run, the bag's folder and what a listener heard."""
    out = tmp_path_factory.mktemp("recorded")
    changes = {
        "plant": {"steps": STEPS, "readers": 5},
        "controller": {"readers_inputs": 4, "readers_state": 3},
        "monitor": {"readers": 3, "log": str(out / "verdicts"), "indicator": True},
        "operator": {"readers": 3},
        "recorder": {"folder": str(out / "bag"), "figure": True, "attach": [str(out / "parameters.yaml")]},
    }
    (out / "parameters.yaml").write_text(text_of(merged(parameters_of(request.param), changes)))
    with running(ROLES, out / "parameters.yaml", namespace=ZONE, domain_id=domain_id) as stack:
        listener = Listener(context=stack.observer.context, namespace=ZONE, use_global_arguments=False)
        stack.executor.add_node(listener)
        listener.get_logger().error(SAID)
        listener.declare_parameter("heard", 3)
        stack.spinner.until(
            lambda: (
                len(listener.heard[f"{ZONE}/controller/state"]) == STEPS
                and len(listener.heard[f"{ZONE}/monitor/report"]) == STEPS // 10
            )
        )
        assert not stack.failure()
        stack.finish()
        listener.destroy_node()
    return out, listener.heard


def check(heard, found):
    """Everything but the best-effort clock must be there, in order, equal."""
    for topic in topics.ALL:
        name = topic.name if topic.name.startswith("/") else f"{ZONE}/{topic.name}"
        if topic is topics.CLOCK:
            known = [plain(msg) for msg in heard[name]]
            assert all(msg in known for msg in found[name])
            continue
        expected = [plain(msg) for msg in heard[name]]
        assert len(found[name]) == len(expected), name
        assert expected or topic not in SPOKEN, name
        for a, b in zip(found[name], expected, strict=True):
            assert same(a, b), f"{name}: {a} is not {b}"


def test_counts(recorded):
    _, heard = recorded
    assert len(heard[f"{ZONE}/outputs"]) == STEPS
    assert len(heard[f"{ZONE}/inputs"]) == STEPS + 1  # the controller answers the last outputs, too
    assert len(heard[f"{ZONE}/reference"]) == 2


def with_rosbags(bag):
    """Topic, log time and fields of every message, as rosbags reads them."""
    with AnyReader([bag], default_typestore=get_typestore(Stores.EMPTY)) as reader:
        for connection, time, data in reader.messages():
            yield connection.topic, time, plain(reader.deserialize(data, connection.msgtype))


def with_mcap_ros2_support(bag):
    """The same, as mcap-ros2-support reads them."""
    with (bag / "bag_0.mcap").open("rb") as file:
        messages = make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
        for _, channel, raw, message in messages:
            yield channel.topic, raw.log_time, plain(message)


def with_javascript(bag):
    """The same, as @mcap/core and @foxglove/rosmsg2-serialization read them."""
    if shutil.which("node") is None or not (JAVASCRIPT / "node_modules").is_dir():
        missing = "no node, or no npm install in tests/bags/js"
        (pytest.fail if os.environ.get("PEERS") == "required" else pytest.skip)(missing)
    command = ["node", "read.mjs", str(bag / "bag_0.mcap")]
    lines = subprocess.run(command, cwd=JAVASCRIPT, check=True, capture_output=True, text=True).stdout.splitlines()
    ours = [message for _, message in BagReader(bag).decoded()]
    assert len(lines) == len(ours)
    for line, like in zip(lines, ours, strict=True):
        topic, time, message = json.loads(line)
        yield topic, int(time), typed(message, plain(like))


def typed(value, like):
    """What JSON has no type for: 64-bit integers, -0 and numbers that are not finite come as text; times as nsec."""
    if isinstance(like, dict):
        value = {"nanosec" if name == "nsec" else name: item for name, item in value.items()}
        return {name: typed(item, like.get(name)) for name, item in value.items()}
    if isinstance(like, list):
        return [typed(item, like[0] if like else None) for item in value]
    return type(like)(value) if isinstance(value, str) and isinstance(like, (int, float)) else value


@pytest.mark.parametrize("read", [with_rosbags, with_mcap_ros2_support, with_javascript])
def test_others_read_every_field_of_every_message(recorded, read):
    """Against what a subscriber of its own heard and, for all that is in the bag, against our decoder."""
    out, heard = recorded
    everything = list(read(out / "bag"))
    found = defaultdict(list)
    for topic, _, message in everything:
        found[topic].append(message)
    check(heard, found)
    assert {"/rosout", "/parameter_events", "/clock", "/diagnostics"} <= set(found)
    ours = list(BagReader(out / "bag").decoded())
    assert len(everything) == len(ours) == BagReader(out / "bag").message_count
    for (topic, time, message), (raw, expected) in zip(everything, ours, strict=True):
        assert (topic, time) == (raw.topic, raw.log_time)
        assert same(message, plain(expected)), f"{topic}: {message} is not {plain(expected)}"


def test_the_report_of_the_run_opens_in_a_browser(recorded, tmp_path, in_browser):
    out, _ = recorded
    write_report(out / "bag", tmp_path / "report.html")
    for seen in in_browser(tmp_path / "report.html"):
        assert (seen["said"], seen["wide"]) == ([], False)
        assert len(seen["canvases"]) >= 6
        assert min(seen["canvases"]) > 50


def test_one_flipped_bit_in_one_input_of_the_bag_is_caught_at_that_sample(recorded, tmp_path):
    out, _ = recorded
    parts = {"controller": cores(load(out / "parameters.yaml"))["controller"]}
    assert replay(out / "bag", parts).same
    rng = np.random.Generator(np.random.PCG64(7))
    for case in range(3):
        k, bit, reader = int(rng.integers(STEPS)), int(rng.integers(64)), BagReader(out / "bag")
        with BagWriter(tmp_path / f"bad{case}") as bad:
            for raw in reader.messages():
                bad.add_topic(raw.topic, raw.type)
                data = raw.data
                if raw.topic == f"{ZONE}/inputs" and (message := from_cdr(data, raw.type)).k == k:
                    values = np.array(message.values)
                    values.view(np.uint64)[0] ^= np.uint64(1 << bit)
                    message.values = values.tolist()
                    data = to_cdr(message)
                bad.write(raw.topic, data, raw.log_time, raw.publish_time)
        (found,) = replay(tmp_path / f"bad{case}", parts).differences
        assert (found.topic, found.k, found.field) == ("inputs", k, "values[0]")


def test_the_monitor_logs_its_reports(recorded):
    out, heard = recorded
    with (out / "verdicts" / "verdicts_0.mcap").open("rb") as file:
        logged = [plain(m) for *_, m in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages()]
    expected = [plain(msg) for msg in heard[f"{ZONE}/monitor/report"]]
    assert len(logged) == len(expected)
    assert all(same(a, b) for a, b in zip(logged, expected, strict=True))


def test_what_nodes_say_and_their_parameters_are_in_the_bag(recorded):
    out, _ = recorded
    reader = BagReader(out / "bag")
    assert SAID in [message.msg for _, message in reader.decoded(["/rosout"])]
    changes = [message for _, message in reader.decoded(["/parameter_events"]) if message.node == f"{ZONE}/listener"]
    assert ("heard", 3) in [(p.name, p.value.integer_value) for change in changes for p in change.new_parameters]


def test_the_bag_holds_what_explains_it(recorded):
    out, _ = recorded
    reader = BagReader(out / "bag")
    files = {a.name: (a.media_type, a.data) for a in reader.attachments()}
    assert files["parameters.yaml"] == ("application/yaml", (out / "parameters.yaml").read_bytes())
    assert files["figure.png"][1].startswith(b"\x89PNG")
    assert f"{ZONE}/outputs.values[1]" in files["foxglove.json"][1].decode()
    assert ET.fromstring(files["plotjuggler.xml"][1]).tag == "root"
    facts = reader.metadata["ros2_deepc"]
    assert facts["version_numpy"] == np.__version__
    assert ("git_revision" in facts) == bool(revision(Path(provenance.__file__)))
    assert reader.metadata["recorder"] == {"messages": str(reader.message_count), "lost": "0"}
    assert all(name.startswith("version_") or name == "git_revision" for name in facts)  # nothing of the machine


def test_nothing_says_incomplete_after_a_clean_end(recorded):
    out, _ = recorded
    for bag in ("bag", "verdicts"):
        assert not (out / bag / "INCOMPLETE").exists()
        assert (out / bag / "metadata.yaml").exists()
