# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""A plant on one host, its controller and monitor on another; the cable between them is pulled and plugged in again."""

import json
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest
from deepc_msgs.msg import Sample

from ros2_deepc.control.modes import Mode
from ros2_deepc.nodes.config import load, merged, shipped, text_of

from .hosts import COMMAND, Hosts, NoRightsError, environment

DEADLINE = 60.0  # [s]
HOLD = 5  # samples
STEADY = 15  # samples in control, one after the other
NAMESPACE = "/grid"


class Process:
    """A process on a host, and what it prints."""

    def __init__(self, hosts, host, folder, domain_id, *words):
        self.file = folder / f"{host}-{'-'.join(map(str, words[-3:])).replace('/', '_')}.log"
        with self.file.open("w") as log, self.file.with_suffix(".err").open("w") as err:
            command = hosts.command(host, *words)
            self.child = subprocess.Popen(command, stdout=log, stderr=err, env=environment(domain_id))

    def lines(self, topic):
        """What a watcher printed of a topic, as far as whole lines are there."""
        whole = self.file.read_text().rpartition("\n")[0].splitlines()
        return [line for line in map(json.loads, whole) if line["topic"] == topic]

    def stop(self):
        self.child.terminate()
        return self.child.wait(DEADLINE)


@pytest.fixture
def start(tmp_path, domain_id):
    """Starts processes on two hosts: start(host, *words); start.hosts has the cable."""
    try:
        hosts = Hosts()
    except NoRightsError as error:
        pytest.skip(str(error))
    running = []

    def go(host, *words):
        running.append(Process(hosts, host, tmp_path, domain_id, *words))
        return running[-1]

    go.hosts, go.running, go.folder = hosts, running, tmp_path
    yield go
    for process in running:
        process.child.kill()
        process.child.wait()
    hosts.close()


def until(start, condition):
    """Waits until the condition holds; no process may end meanwhile."""
    end = time.monotonic() + DEADLINE
    while not condition() and time.monotonic() < end:
        with suppress(subprocess.TimeoutExpired):
            start.running[0].child.wait(0.1)
        ended = [process.file.with_suffix(".err") for process in start.running if process.child.poll() is not None]
        assert not ended, f"{ended[0].name}: {ended[0].read_text()[-500:]}"
    words = [
        f"{p.file.name}: {p.file.read_text()[-150:]} {p.file.with_suffix('.err').read_text()[-300:]}"
        for p in start.running
    ]
    assert condition(), "\n".join(words)


def controlled(watch, since=0):
    """In control for a while after sample ``since``, with the rank of clean data."""
    newest = [line for line in watch.lines("state") if line["k"] > since][-STEADY:]
    steady = len(newest) == STEADY and all(line["mode"] == Mode.CONTROLLING for line in newest)
    return steady and newest[-1]["rank"] == newest[-1]["rank_need"]


@pytest.mark.timeout(300)
def test_a_zone_over_two_hosts_survives_a_pulled_cable(start):
    parameters = merged(
        load(shipped("wscc9")),
        {
            "plant": {"mode": "realtime", "speed": 5.0, "steps": 0, "hold": HOLD, "safe": [0.05]},
            "controller": {"max_gap": 10_000, "max_hold": 100_000},
            "operator": {"reference_k": [0], "reference_values": [0.3, 0.0]},
        },
    )
    for values in parameters.values():
        values.pop("use_sim_time", None)
    config = start.folder / "zone.yaml"
    config.write_text(text_of(parameters))
    places = {"plant": "left", "monitor": "right", "controller": "right", "operator": "right"}
    run = (COMMAND, "run", config, "--namespace", NAMESPACE, "--role")
    zone = [start(host, *run, role) for role, host in places.items()]
    watcher = Path(__file__).with_name("watch.py")
    field, room = (start(host, sys.executable, watcher, NAMESPACE) for host in ("left", "right"))

    until(start, lambda: controlled(room) and room.lines("report"))
    start.hosts.cable(plugged=False)
    until(start, lambda: field.lines("outputs")[-1]["held"] == Sample.OWN_INPUT)
    ages = [line["held"] for line in field.lines("outputs")]
    while ages[-1] == Sample.OWN_INPUT:
        ages.pop()
    assert ages[-HOLD:] == list(range(1, HOLD + 1))
    until(start, lambda: room.lines("state")[-1]["mode"] == Mode.HOLDING)

    start.hosts.cable(plugged=True)
    back = field.lines("outputs")[-1]["k"]
    until(start, lambda: controlled(room, back))
    until(start, lambda: field.lines("outputs")[-1]["held"] == 0)
    until(start, lambda: room.lines("report")[-1]["k"] > back)
    assert len({line["epoch"] for line in field.lines("outputs")}) == 1
    assert [process.stop() for process in zone] == [0] * len(zone)
