# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""A slow or broken disk holds nobody up and takes no more memory than it was given; what is lost is counted."""

import os
import shutil
import threading

import pytest

from ros2_deepc.bags import BagReader, BagWriter
from ros2_deepc.bags.background import BackgroundWriter

STRING = "std_msgs/msg/String"
MESSAGE = os.urandom(1000)


def opened(folder, capacity=1_000_000, **options):
    bag = BackgroundWriter(BagWriter(folder, **options), capacity)
    bag.call(lambda writer: writer.add_topic("/a", STRING))
    return bag


def test_the_order_is_kept_and_nothing_is_lost(tmp_path):
    bag = opened(tmp_path / "bag")
    for i in range(5000):
        assert bag.write("/a", MESSAGE, i, patience=60.0)  # five times what may wait
        if i == 2000:
            bag.call(lambda writer: writer.add_topic("/b", STRING))
            assert bag.write("/b", b"", i, patience=60.0)
    bag.stop().close()
    assert bag.stop().message_count == 5001
    assert (bag.lost, bag.failure) == (0, "")
    reader = BagReader(tmp_path / "bag")
    assert [m.log_time for m in reader.messages(["/a"])] == list(range(5000))


def test_a_disk_that_stands_still_costs_messages_not_memory(tmp_path):
    bag = opened(tmp_path / "bag", capacity=100_000)
    moves = threading.Event()
    bag.call(lambda _: moves.wait(60))
    taken = [bag.write("/a", MESSAGE, i) for i in range(10_000)]
    assert 0 < sum(taken) <= 100
    assert bag.lost == len(taken) - sum(taken)
    moves.set()
    assert bag.write("/a", MESSAGE, 10_000, patience=60.0)  # moves again: there is room again
    bag.stop().close()
    times = [m.log_time for m in BagReader(tmp_path / "bag").messages()]
    assert times == [i for i, there in enumerate(taken) if there] + [10_000]


def test_who_can_wait_waits_for_the_disk(tmp_path):
    bag = opened(tmp_path / "bag", capacity=10_000)
    moves = threading.Event()
    bag.call(lambda _: moves.wait(60))
    full = sum(bag.write("/a", MESSAGE, i) for i in range(20))
    starter = threading.Timer(0.01, moves.set)
    starter.start()
    assert bag.write("/a", MESSAGE, 20, patience=60.0)
    starter.join()
    bag.stop().close()
    assert BagReader(tmp_path / "bag").message_count == full + 1


@pytest.mark.parametrize("trouble", ["the folder goes away", "a bug"])
def test_an_error_is_kept_for_who_asks_and_raised_to_nobody(tmp_path, trouble):
    bag = opened(tmp_path / "bag", max_bytes=20_000, chunk_size=1000)
    if trouble == "a bug":
        bag.call(lambda _: 1 / 0)
    else:
        shutil.rmtree(tmp_path / "bag")  # the next file cannot be made
    for i in range(1000):
        bag.write("/a", MESSAGE, i)
    writer = bag.stop()
    assert ("division by zero" if trouble == "a bug" else "No such file or directory") in bag.failure
    before = bag.lost
    assert before > 500
    bag.write("/a", MESSAGE, 0)
    assert bag.lost == before + 1
    writer.close()  # no error either: it was told once


def test_what_came_last_is_flushed_though_nothing_follows(tmp_path):
    bag = opened(tmp_path / "bag", flush_period=0.0)
    bag.write("/a", MESSAGE, 7)
    flushed = threading.Event()
    while not list(BagReader(tmp_path / "bag").messages()):
        flushed.wait(0.05)
    bag.stop().close()
