# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Damaged bags: what is whole comes back, the loss is stated; faults in the samples are found where they are."""

import shutil
from itertools import pairwise

import numpy as np
import pytest

from ros2_deepc.bags import BagError, BagReader, BagWriter, load_run
from ros2_deepc.bags.check import check, repair
from ros2_deepc.bags.convert import to_cdr
from ros2_deepc.bags.scan import read_summary

CHUNK = 3000


@pytest.fixture(scope="module")
def whole(make, tmp_path_factory):
    """A finished bag of many small chunks, its messages, and where each chunk lies in the file."""
    folder = tmp_path_factory.mktemp("whole") / "bag"
    u, y, ref = make.simulate(60, 3, 30)
    make.write_bag(folder, make.run_messages(u, y, ref, 30), chunk_size=CHUNK, metadata={"seed": "3"})
    chunks = read_summary(folder / "bag_0.mcap").chunk_indexes
    ends = [(c.chunk_start_offset, c.chunk_start_offset + c.chunk_length) for c in chunks]
    return folder, list(BagReader(folder).messages()), ends


def per_chunk(whole) -> list[list]:
    """The messages of each chunk."""
    folder, messages, _ = whole
    sizes = [sum(1 for m in messages if c.message_start_time <= m.log_time <= c.message_end_time)
             for c in read_summary(folder / "bag_0.mcap").chunk_indexes]  # fmt: skip
    assert sum(sizes) == len(messages)
    edges = np.cumsum([0, *sizes])
    return [messages[a:b] for a, b in pairwise(edges)]


def cut_copy(whole, folder, data: bytes):
    folder.mkdir()
    (folder / "bag_0.mcap").write_bytes(data)
    (folder / "INCOMPLETE").touch()
    return folder


@pytest.mark.parametrize("seed", range(50))
def test_truncated_anywhere_gives_back_every_whole_chunk(whole, tmp_path, seed):
    folder, _, ends = whole
    data = (folder / "bag_0.mcap").read_bytes()
    at = int(np.random.Generator(np.random.PCG64(seed)).integers(9, len(data)))
    expected = [m for part, (_, end) in zip(per_chunk(whole), ends, strict=True) if end <= at for m in part]
    reader = BagReader(cut_copy(whole, tmp_path / "cut", data[:at]))
    assert list(reader.messages()) == expected
    assert not reader.complete
    assert reader.losses
    if expected:
        result = repair(tmp_path / "cut", tmp_path / "new")
        assert result.messages == len(expected)
        again = BagReader(tmp_path / "new")
        assert again.complete
        assert list(again.messages()) == expected
        assert again.metadata["ros2_deepc"]["seed"] == "3"
        assert {t.name: t.type_hash for t in again.topics.values()} == {
            t.name: t.type_hash for t in reader.topics.values() if t.count
        }
        assert check(tmp_path / "new").ok
    else:
        with pytest.raises(BagError, match="nothing can be read"):
            repair(tmp_path / "cut", tmp_path / "new")


@pytest.mark.parametrize("position", [0, 1, 4, 8])
def test_hardly_anything_left(whole, tmp_path, position):
    data = (whole[0] / "bag_0.mcap").read_bytes()
    reader = BagReader(cut_copy(whole, tmp_path / "cut", data[:position]))
    assert list(reader.messages()) == []
    assert not reader.complete


@pytest.mark.parametrize("seed", range(40))
def test_one_flipped_bit_never_changes_a_message(whole, tmp_path, seed):
    """Of every chunk either all messages come back as they were, or none, and then the loss is stated."""
    folder, messages, ends = whole
    data = bytearray((folder / "bag_0.mcap").read_bytes())
    rng = np.random.Generator(np.random.PCG64(seed))
    at = int(rng.integers(len(data)))
    data[at] ^= 1 << int(rng.integers(8))
    broken = tmp_path / "bag"
    shutil.copytree(folder, broken)
    (broken / "bag_0.mcap").write_bytes(data)
    hit = [i for i, (start, end) in enumerate(ends) if start <= at < end]
    try:
        saved = repair(broken, tmp_path / "new")
    except BagError:
        assert at < 8  # the file does not even begin like an MCAP file
        return
    found = list(BagReader(tmp_path / "new").messages())
    parts = per_chunk(whole)
    without = [m for i, part in enumerate(parts) if i not in hit for m in part]
    assert found in (messages, without)
    assert len(found) == len(messages) or saved.findings
    if len(found) != len(messages):  # then reading through the index finds the damage, too
        assert not check(broken).ok
        with pytest.raises(BagError, match="damaged inside"):
            list(BagReader(broken).messages())


def test_framing_lost_in_the_middle_goes_on_at_the_next_chunk(whole, tmp_path):
    folder, _, ends = whole
    data = bytearray((folder / "bag_0.mcap").read_bytes())
    start, end = ends[2]
    data[start : start + 200] = b"\xff" * 200
    broken = tmp_path / "bag"
    shutil.copytree(folder, broken)
    (broken / "bag_0.mcap").write_bytes(data)
    result = repair(broken, tmp_path / "new")
    parts = per_chunk(whole)
    assert list(BagReader(tmp_path / "new").messages()) == [m for i, p in enumerate(parts) if i != 2 for m in p]
    assert result.lost_bytes >= end - start


def test_damage_never_goes_into_the_source(whole, tmp_path):
    broken = tmp_path / "bag"
    shutil.copytree(whole[0], broken)
    before = {p.name: p.read_bytes() for p in broken.iterdir()}
    repair(broken, tmp_path / "new")
    check(broken)
    assert {p.name: p.read_bytes() for p in broken.iterdir()} == before
    with pytest.raises(BagError, match="not empty"):
        repair(broken, broken)


def test_a_good_bag_has_no_errors(whole):
    result = check(whole[0])
    assert result.ok, result.findings
    assert result.messages == len(whole[1])
    assert result.lost_bytes == 0


def texts(result) -> str:
    return "\n".join(map(str, result.findings))


def test_faults_in_the_samples_are_found(make, tmp_path):
    u, y, ref = make.simulate(60, 3, 30)
    messages = make.run_messages(u, y, ref, 30)
    place = {(n, m.k): i for i, (n, m) in enumerate(messages) if n in ("outputs", "inputs")}
    jump = messages[place["outputs", 40]][1].header.stamp
    jump.sec += 100
    messages[place["outputs", 50]][1].values[0] = float("nan")
    messages[place["outputs", 55]] = ("outputs", make.sample(55, y[55], held=1))
    messages[place["inputs", 20]] = ("inputs", make.sample(19, [9, 9]))
    del messages[place["outputs", 10]]
    make.write_bag(tmp_path / "bag", messages)
    result = check(tmp_path / "bag")
    text = texts(result)
    assert not result.ok
    for expected in (
        "/grid/outputs: samples missing: 1 before epoch 0 k = 11",
        "/grid/inputs: sample repeated: epoch 0 k = 19 with other values",
        "/grid/outputs: clock jumps: epoch 0 k = 40 by 100.1 s instead of 0.1 s",
        "/grid/outputs: clock goes back or stands: epoch 0 k = 41",
        "/grid/outputs: values not finite: epoch 0 k = 50",
        "note: /grid/outputs: input held: epoch 0 k = 55",
    ):
        assert expected in text, (expected, text)


def test_wrong_counts_missing_topics_and_undecodable_messages(make, tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/grid/outputs", "deepc_msgs/msg/Sample")
        for k in range(3):
            bag.write("/grid/outputs", to_cdr(make.sample(k, [1.0])), 10 - k)
        bag.write("/grid/outputs", b"\0\1\0\0\7", 11)
    path = tmp_path / "bag" / "metadata.yaml"
    path.write_text(path.read_text().replace("message_count: 4", "message_count: 5"))
    text = texts(check(tmp_path / "bag"))
    assert "error: log time: goes back: 1e-09 s, 2e-09 s" in text
    assert "cannot be decoded: 5 bytes are no deepc_msgs/msg/Sample" in text
    assert "counts 5 messages, the files hold 4" in text
    assert "note: /grid/inputs: no messages" in text


def test_messages_that_the_recorder_lost_are_an_error(make, tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/grid/outputs", "deepc_msgs/msg/Sample")
        bag.write("/grid/outputs", to_cdr(make.sample(0, [1.0])), 10)
        bag.add_metadata("recorder", {"messages": "1", "lost": "7"})
    result = check(tmp_path / "bag")
    assert not result.ok
    assert "the recorder lost 7 messages" in texts(result)


def test_the_folder_of_a_killed_run_stands_for_its_bag(whole, tmp_path):
    data = (whole[0] / "bag_0.mcap").read_bytes()
    (tmp_path / "run").mkdir()
    cut_copy(whole, tmp_path / "run" / "bag", data[: len(data) // 2])
    for path in (tmp_path / "run", tmp_path / "run" / "bag"):
        assert not BagReader(path).complete
        assert "the recording was not closed" in texts(check(path))
    assert list(BagReader(tmp_path / "run").messages()) == list(BagReader(tmp_path / "run" / "bag").messages())


def test_no_bag(tmp_path):
    for broken in (
        lambda: check(tmp_path / "none"),
        lambda: load_run(tmp_path),
        lambda: BagReader(tmp_path / "x.mcap"),
    ):
        with pytest.raises(BagError):
            broken()
    (tmp_path / "text.mcap").write_text("hello")
    reader = BagReader(tmp_path / "text.mcap")
    assert reader.losses == ["text.mcap: 5 bytes lost at byte 0: not an MCAP file"]


def test_the_folder_of_a_run_stands_for_its_bag(whole, tmp_path):
    shutil.copytree(whole[0], tmp_path / "run" / "bag")
    assert len(load_run(tmp_path / "run").k) == len(load_run(whole[0]).k)
    found = check(tmp_path / "run")
    assert (found.messages, found.findings) == (len(whole[1]), check(whole[0]).findings)
