# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Signals: nodes and zones stop with a defined end, exit 0, a closed bag."""

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest
import yaml

from ros2_deepc.bags.reader import BagReader

BIN = Path(sys.executable).parent
CONFIG = Path(sys.prefix) / "share" / "ros2_deepc" / "config" / "wscc9.yaml"
DEADLINE = 60.0  # [s]


@pytest.fixture
def start(tmp_path, domain_id):
    """Starts a command; whatever still runs at the end is killed."""
    running = []

    def go(*command):
        env = dict(os.environ, ROS_DOMAIN_ID=str(domain_id))
        log = (tmp_path / f"log{len(running)}").open("w+")
        running.append(
            (subprocess.Popen([str(c) for c in command], stdout=log, stderr=log, env=env, cwd=tmp_path), log)
        )
        return running[-1]

    yield go
    for process, log in running:
        process.kill()
        process.wait()
        log.close()


def until(process, condition):
    """Waits for the process to end or for the condition to hold."""
    end = time.monotonic() + DEADLINE
    while process.poll() is None and not condition() and time.monotonic() < end:
        with suppress(subprocess.TimeoutExpired):
            process.wait(0.05)
    assert process.poll() is not None or condition()


def said(log):
    log.flush()
    log.seek(0)
    return log.read()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("role", ["plant", "controller", "monitor", "operator"])
def test_a_node_ends_with_0_on_a_signal(start, role, number):
    process, log = start(
        sys.executable, "-X", "faulthandler", BIN / f"ros2-deepc-{role}", "--ros-args", "-p", "use_sim_time:=false"
    )
    until(process, lambda: _ready(process))
    process.send_signal(number)
    process.wait(DEADLINE)
    assert process.returncode == 0, said(log)
    assert "Traceback" not in said(log)


def _ready(process):
    """Whether the node has installed its own signal handlers (bits in SigCgt)."""
    status = Path(f"/proc/{process.pid}/status").read_text()
    caught = int(next(line for line in status.splitlines() if line.startswith("SigCgt")).split()[1], 16)
    return caught >> (signal.SIGTERM - 1) & 1 == 1


MODES = {
    "COLLECTING": {"T": 5000},
    "CONTROLLING": {},
    "FALLBACK": {"trip_max": [-1e6], "trip_min": [-1e7]},
}


@pytest.mark.parametrize(
    ("mode", "processes"),
    [("COLLECTING", []), ("CONTROLLING", ["--processes"]), ("FALLBACK", [])],
)
def test_a_zone_in_real_time_ends_with_0_its_configured_input_and_a_closed_bag(start, tmp_path, mode, processes):
    tree = yaml.safe_load(CONFIG.read_text())
    tree["/**/plant"]["ros__parameters"] |= {"mode": "realtime", "speed": 10.0, "steps": 0}
    tree["/**/controller"]["ros__parameters"] |= MODES[mode] | {"u_safe": [0.125]}
    for role in ("controller", "monitor", "recorder"):
        (tree["/**/" + role]["ros__parameters"] or {}).pop("use_sim_time", None)
    (tmp_path / "zone.yaml").write_text(yaml.safe_dump(tree))
    process, log = start(BIN / "ros2-deepc", "run", "zone.yaml", "--record", "bag", "--namespace", "/grid", *processes)
    until(process, lambda: mode in said(log))
    until(process, lambda: (tmp_path / "bag" / "bag_0.mcap").stat().st_size > 5000)
    process.send_signal(signal.SIGTERM)
    process.wait(DEADLINE)
    assert process.returncode == 0, said(log)
    bag = BagReader(tmp_path / "bag")
    assert bag.complete
    assert bag.topics["/grid/outputs"].count > 0
    *_, (_, last) = bag.decoded(["/grid/inputs"])
    assert list(last.values) == [0.125] * 3


def test_a_bad_configuration_ends_with_1_and_one_line(start):
    process, log = start(BIN / "ros2-deepc-recorder")
    process.wait(DEADLINE)
    assert process.returncode == 1
    assert "error: recorder: give the parameter folder" in said(log)
