# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The disk fills up under the recorder: that is said, the loop goes on, and what was written can be read."""

import os
import subprocess
import sys

import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from ros2_deepc.bags import BagReader
from ros2_deepc.demo import RunError
from ros2_deepc.nodes.config import merged, text_of
from ros2_deepc.nodes.stack import running
from ros2_deepc.ros import topics
from ros2_deepc.ros.qos import profile

ZONE = "/full"
STEPS = 600


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 256 kB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", str(folder)]
    if subprocess.run(command, check=False, capture_output=True).returncode:
        pytest.skip("mounting a small disk needs root; the limit on file sizes below is tested everywhere")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


def parameters(parameters_of, folder, readers):
    changes = {
        "plant": {"steps": STEPS, "readers": 1 + readers},
        "controller": {"readers_inputs": 1 + readers, "readers_state": 1 + readers},
        "operator": {"readers": 1 + readers},
        "recorder": {"folder": str(folder), "max_size": 0.03},
    }
    base = {name: values for name, values in parameters_of("wscc9").items() if name != "monitor"}
    return text_of(merged(base, changes))


def run(roles, file, domain_id, before=lambda stack: None):
    """Runs to the last sample; what finishing said, and the levels and words of the recorder on /diagnostics."""
    said = []
    with running(roles, file, namespace=ZONE, domain_id=domain_id, log_level="fatal") as stack:
        seen = stack.observer

        def hear(msg):
            said.extend((s.level, s.message) for s in msg.status if s.name == "full/recorder")

        topic = topics.DIAGNOSTICS
        seen.create_subscription(topic.type, topic.name, hear, profile(topic))
        before(stack)
        stack.spinner.until(lambda: bool(stack.failure()) or (seen.state is not None and seen.state.k == STEPS - 1))
        assert stack.failure() == ""
        assert seen.state.mode == seen.state.CONTROLLING
        stack.spinner.until(lambda: bool(said))
        return stack.finish(), said


def check_bag(folder):
    """Several files, marked, readable without a gap as far as they go."""
    reader = BagReader(folder)
    assert not reader.complete
    assert len(reader.files) > 1
    ks = [message.k for _, message in reader.decoded([f"{ZONE}/outputs"])]
    assert ks == list(range(len(ks)))
    assert 0 < len(ks) < STEPS


def test_a_full_disk_ends_the_recording_not_the_loop(small_disk, tmp_path, domain_id, parameters_of):
    file = tmp_path / "parameters.yaml"
    file.write_text(parameters(parameters_of, small_disk / "bag", 1))
    trouble, said = run(("recorder", "controller", "operator", "plant"), file, domain_id)
    reason = f"recording into {small_disk / 'bag'} stopped: No space left on device"
    assert trouble == reason
    assert said == [(DiagnosticStatus.ERROR, reason)]
    check_bag(small_disk / "bag")


def test_a_demo_on_a_full_disk_goes_to_its_end_and_says_what_it_could_not_keep(small_disk, demo, tmp_path):
    (tmp_path / "run").symlink_to(small_disk, target_is_directory=True)
    with pytest.raises(RunError, match="No space left on device"):
        demo("wscc9", changes={"plant": {"steps": STEPS}})
    reader = BagReader(small_disk / "bag")
    assert not reader.complete
    assert reader.message_count > 0


def test_a_recorder_that_may_not_write_more_lives_on_until_it_is_told(tmp_path, domain_id, parameters_of):
    """In a process of its own, to which the kernel refuses files above a size."""
    file = tmp_path / "parameters.yaml"
    file.write_text(parameters(parameters_of, tmp_path / "bag", 1).replace("max_size: 0.03", "max_size: 1.0"))
    code = (
        "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (120_000, 120_000));"
        "from ros2_deepc.nodes.recorder_node import main; raise SystemExit(main())"
    )
    arguments = ["--ros-args", "-r", f"__ns:={ZONE}", "--params-file", str(file)]
    env = dict(os.environ, ROS_DOMAIN_ID=str(domain_id), FASTDDS_BUILTIN_TRANSPORTS="UDPv4")
    with subprocess.Popen([sys.executable, "-c", code, *arguments], env=env, stderr=subprocess.PIPE) as recorder:
        _, said = run(("controller", "operator", "plant"), file, domain_id)
        assert recorder.poll() is None
        recorder.terminate()
        _, complaint = recorder.communicate(timeout=60)
    assert recorder.returncode == 1
    assert said == [(DiagnosticStatus.ERROR, f"recording into {tmp_path / 'bag'} stopped: File too large")]
    assert b"File too large" in complaint
    reader = BagReader(tmp_path / "bag")
    assert not reader.complete
    assert 0 < sum(1 for _ in reader.messages([f"{ZONE}/outputs"])) < STEPS
