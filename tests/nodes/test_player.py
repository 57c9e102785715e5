# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""A bag published again: every message, in order, with its bytes, to readers as the recorded publishers had them."""

import threading
from collections import defaultdict

import pytest
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

from ros2_deepc.bags import BagReader, BagWriter
from ros2_deepc.bags.convert import from_cdr, to_cdr
from ros2_deepc.bags.layout import qos_entry
from ros2_deepc.nodes.player import Player, offered
from ros2_deepc.ros import topics
from ros2_deepc.ros.qos import profile
from ros2_deepc.ros.run import Spinner, ros

TOPICS = ("/played/outputs", "/played/inputs", "/played/info")
COUNT = 3000


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """Two streams, a latched word, what nodes say by themselves, and an hour of silence in the middle."""
    folder = tmp_path_factory.mktemp("played") / "bag"
    with BagWriter(folder) as writer:
        for topic in (*TOPICS, "/rosout"):
            durability = "transient_local" if topic.endswith("info") else "volatile"
            writer.add_topic(topic, "std_msgs/msg/String", [qos_entry(durability=durability, history="unknown")])
        writer.write("/played/info", to_cdr(String(data="a plant")), 0)
        writer.write("/rosout", to_cdr(String(data="not again")), 0)
        for i in range(COUNT):
            time = i * 1000 + (3600 * 10**9 if i >= COUNT // 2 else 0)
            for topic in TOPICS[:2]:
                writer.write(topic, to_cdr(String(data=f"{topic} {i}")), time)
    return folder


class Listener(Node):
    """Keeps the words of each topic, and the clock."""

    def __init__(self, **kwargs):
        super().__init__("listener", **kwargs)
        self.heard = defaultdict(list)
        self.clock = []
        everything = QoSProfile(history=HistoryPolicy.KEEP_ALL, reliability=ReliabilityPolicy.RELIABLE)
        for topic in TOPICS[:2]:
            self.create_subscription(String, topic, self._keeps(topic), everything)
        self.create_subscription(Clock, "/clock", lambda msg: self.clock.append(msg.clock.sec), profile(topics.CLOCK))

    def listen_late(self):
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.create_subscription(String, TOPICS[2], self._keeps(TOPICS[2]), latched)

    def _keeps(self, topic):
        return lambda msg: self.heard[topic].append(msg.data)


@pytest.fixture
def played(bag, domain_id):
    """Plays the bag in a thread; returns the listener when it has heard all, and what the player returned."""

    def run(**options):
        with ros([], domain_id) as context:
            listener = Listener(context=context, use_global_arguments=False)
            executor = SingleThreadedExecutor(context=context)
            executor.add_node(listener)
            player = Player(BagReader(bag), context=context, use_global_arguments=False, **options)
            Spinner(executor).until(lambda: all(listener.count_publishers(t) for t in TOPICS))
            returned = []

            def play():
                player.wait_for_readers(60.0)
                returned.append(player.play())

            thread = threading.Thread(target=play)
            thread.start()
            Spinner(executor).until(lambda: bool(returned) and all(len(listener.heard[t]) == COUNT for t in TOPICS[:2]))
            thread.join()
            listener.listen_late()
            Spinner(executor).until(lambda: bool(listener.heard[TOPICS[2]]))
            executor.shutdown()
            player.destroy_node()
            listener.destroy_node()
            return listener, returned[0]

    return run


def check(listener, count):
    for topic in TOPICS[:2]:
        assert listener.heard[topic] == [f"{topic} {i}" for i in range(COUNT)]
    assert listener.heard[TOPICS[2]] == ["a plant"]  # it came late
    assert count == 2 * COUNT + 1
    assert listener.clock == sorted(listener.clock)
    assert 3600 in listener.clock


def test_as_fast_as_the_reader_takes_it(played):
    check(*played(rate=0.0))


def test_an_hour_of_silence_is_cut_short(played):
    check(*played(rate=1.0, pause=0.01))


def test_step_by_step(played):
    steps = []
    listener, count = played(rate=0.0, gate=lambda: steps.append(len(steps)))
    check(listener, count)
    assert len(steps) == COUNT


def test_profiles_serve_whoever_was_served(bag):
    profiles = {name: offered(info) for name, info in BagReader(bag).topics.items()}
    assert profiles["/played/info"].durability == DurabilityPolicy.TRANSIENT_LOCAL
    assert profiles["/played/outputs"].history == HistoryPolicy.KEEP_ALL
    info = BagReader(bag).topics["/played/outputs"]
    info.qos = "- {reliability: best_effort, durability: volatile}\n"
    assert offered(info).reliability == ReliabilityPolicy.BEST_EFFORT
    info.qos += "- {reliability: reliable, durability: transient_local}\n"
    assert offered(info).reliability == ReliabilityPolicy.RELIABLE
    assert offered(info).durability == DurabilityPolicy.TRANSIENT_LOCAL


def test_the_bytes_are_those_of_the_bag(bag):
    raw = next(iter(BagReader(bag).messages([TOPICS[0]])))
    assert serialize_message(from_cdr(raw.data, raw.type)).startswith(raw.data)
