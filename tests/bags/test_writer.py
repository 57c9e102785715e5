# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""What a bag holds while it is written, after a kill, and when the disk refuses."""

import os
import signal
import subprocess
import sys
import textwrap

import pytest
import yaml
from mcap.reader import make_reader

from ros2_deepc.bags import BagError, BagReader, BagWriter, load_run

STRING = "std_msgs/msg/String"


def test_marker_exists_until_close(tmp_path):
    bag = BagWriter(tmp_path / "bag")
    bag.add_topic("/a", STRING)
    bag.write("/a", b"x" * 8, 1)
    assert (tmp_path / "bag" / "INCOMPLETE").exists()
    assert not (tmp_path / "bag" / "metadata.yaml").exists()
    assert not BagReader(tmp_path / "bag").complete
    bag.close()
    bag.close()
    assert not (tmp_path / "bag" / "INCOMPLETE").exists()
    assert BagReader(tmp_path / "bag").complete


def test_existing_folder_is_refused_in_one_line(tmp_path):
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "other").write_text("mine")
    with pytest.raises(BagError, match="not empty") as caught:
        BagWriter(tmp_path / "bag")
    assert "\n" not in str(caught.value)
    assert sorted(p.name for p in (tmp_path / "bag").iterdir()) == ["other"]


@pytest.mark.parametrize("folder", ["/proc/bag", "file/bag"])
def test_folder_that_cannot_be_made(tmp_path, folder):
    (tmp_path / "file").write_text("not a folder")
    with pytest.raises(BagError, match="cannot record into"):
        BagWriter(tmp_path / folder)


def test_unknown_topic_type_and_compression(tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        with pytest.raises(BagError, match="call add_topic"):
            bag.write("/a", b"", 0)
        with pytest.raises(BagError, match="no definition of nobody_msgs/msg/Nothing"):
            bag.add_topic("/a", "nobody_msgs/msg/Nothing")
        bag.add_topic("/a", STRING)
        bag.add_topic("/a", STRING)
        with pytest.raises(BagError, match="is std_msgs/msg/String"):
            bag.add_topic("/a", "std_msgs/msg/Bool")
    with pytest.raises(BagError, match="closed"):
        bag.write("/a", b"", 0)
    with pytest.raises(BagError, match="unknown compression"):
        BagWriter(tmp_path / "other", compression="rar")


@pytest.mark.parametrize("compression", ["zstd", "none"])
def test_bytes_times_and_attachments_come_back(tmp_path, compression):
    sent = [(f"/t{i % 3}", bytes([i % 256]) * (i % 50), 1000 + i, 900 + i) for i in range(500)]
    with BagWriter(tmp_path / "bag", compression=compression, chunk_size=2000, metadata={"seed": "3"}) as bag:
        for i in range(3):
            bag.add_topic(f"/t{i}", STRING)
        for message in sent:
            bag.write(*message)
        bag.attach("config.yaml", "application/yaml", b"a: 1\n", 5)
        bag.add_metadata("extra", {"empty": ""})
    reader = BagReader(tmp_path / "bag")
    assert [(m.topic, m.data, m.log_time, m.publish_time) for m in reader.messages()] == sent
    assert [(a.name, a.media_type, a.data) for a in reader.attachments()] == [
        ("config.yaml", "application/yaml", b"a: 1\n")
    ]
    assert reader.metadata["ros2_deepc"] == {"seed": "3"}
    assert reader.metadata["extra"] == {"empty": ""}
    assert (reader.message_count, reader.start, reader.end) == (500, 1000, 1499)
    assert [m.log_time for m in reader.messages(["/t1"], start=1100, end=1110)] == [1100, 1103, 1106, 1109]


@pytest.mark.parametrize("options", [{"max_bytes": 20_000}, {"max_duration": 100e-9}, {"max_chunks": 50}])
def test_rolls_into_files_that_each_stand_alone(tmp_path, options):
    data = os.urandom(400)
    with BagWriter(tmp_path / "bag", chunk_size=1000, metadata={"seed": "3"}, **options) as bag:
        bag.add_topic("/a", STRING)
        for i in range(500):
            bag.write("/a", data, i)
    reader = BagReader(tmp_path / "bag")
    assert len(reader.files) > 3
    assert [m.log_time for m in reader.messages()] == list(range(500))
    single = [BagReader(f) for f in reader.files]
    assert sum(r.message_count for r in single) == 500
    assert all(r.complete and r.metadata["ros2_deepc"] == {"seed": "3"} for r in single)
    info = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert [f["message_count"] for f in info["files"]] == [r.message_count for r in single]
    assert info["relative_file_paths"] == [f.name for f in reader.files]
    assert info["message_count"] == 500


@pytest.mark.parametrize(("size", "period"), [(100, 60.0), (10**6, 0.0)])
def test_no_file_has_more_chunks_than_asked_for(tmp_path, size, period):
    """Whether chunks are full or flushed: their index is what grows in memory until a file is finished."""
    with BagWriter(tmp_path / "bag", chunk_size=size, flush_period=period, max_chunks=30) as bag:
        bag.add_topic("/a", STRING)
        for i in range(400):
            bag.write("/a", os.urandom(60), i)
    reader = BagReader(tmp_path / "bag")
    chunks = []
    for file in reader.files:
        with file.open("rb") as stream:
            chunks.append(len(make_reader(stream).get_summary().chunk_indexes))
    assert len(chunks) > 5
    assert max(chunks) <= 30
    assert [m.log_time for m in reader.messages()] == list(range(400))


def test_killed_recorder_leaves_what_it_flushed(tmp_path):
    code = f"""
        import os, signal
        from ros2_deepc.bags import BagWriter
        bag = BagWriter({str(tmp_path / "bag")!r})
        bag.add_topic("/a", {STRING!r})
        for i in range(1000):
            bag.write("/a", b"x" * 20, i)
            if i == 899:
                bag.flush()
        os.kill(os.getpid(), signal.SIGKILL)
    """
    process = subprocess.run([sys.executable, "-c", textwrap.dedent(code)], check=False)
    assert process.returncode == -signal.SIGKILL
    reader = BagReader(tmp_path / "bag")
    assert not reader.complete
    assert [m.log_time for m in reader.messages()] == list(range(900))
    assert reader.topics["/a"].count == 900


FULL = """
    import os, resource
    resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, 40_000))  # the kernel refuses to let a file grow further
    from ros2_deepc.bags import BagError, BagWriter
    bag = BagWriter({folder!r}, chunk_size=5000)
    bag.add_topic("/a", {kind!r})
    errors = []
    for i in range(1000):
        try:
            bag.write("/a", os.urandom(100), i)
        except BagError as error:
            errors.append((i, str(error)))
    bag.close()
    print(errors[0][0], len({{text for _, text in errors}}), len(errors), errors[0][1], sep="|")
"""


def test_full_disk_is_one_error_and_leaves_a_readable_marked_bag(tmp_path):
    code = textwrap.dedent(FULL.format(folder=str(tmp_path / "bag"), kind=STRING))
    process = subprocess.run([sys.executable, "-c", code], check=False, capture_output=True, text=True)
    assert process.returncode == 0, process.stderr
    assert process.stderr == ""
    first, different, count, text = process.stdout.strip().split("|")
    assert (int(different), int(count)) == (1, 1000 - int(first))  # the same answer ever after, at once
    assert text == f"recording into {tmp_path / 'bag'} stopped: File too large"
    reader = BagReader(tmp_path / "bag")
    assert not reader.complete
    assert "the file ends within a record" in reader.losses[0]
    times = [m.log_time for m in reader.messages()]
    assert times == list(range(len(times)))
    assert int(first) - 100 < len(times) <= int(first)  # at most two chunks of 5000 bytes are missing


def test_time_zero_is_a_time(tmp_path):
    """Before the first /clock a recorder on simulated time logs at zero."""
    with BagWriter(tmp_path / "bag", max_bytes=1) as bag:
        bag.add_topic("/a", STRING)
        for time in (0, 5, 3):
            bag.write("/a", b"x", time)
    reader = BagReader(tmp_path / "bag")
    assert (reader.start, reader.end) == (0, 5)


def test_empty_bag_is_a_bag(tmp_path):
    with BagWriter(tmp_path / "bag"):
        pass
    reader = BagReader(tmp_path / "bag")
    assert reader.message_count == 0
    assert list(reader.messages()) == []
    with pytest.raises(BagError, match="holds no message: nothing was recorded"):
        load_run(reader)
