# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The example of a plant of one's own over topics: found, proved and controlled, with the commands of its docstring."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from deepc_msgs.msg import Verdict

from ros2_deepc.nodes.observer import Observer
from ros2_deepc.ros.run import Spinner, make_executor, ros

EXAMPLE = Path(__file__).parents[2] / "docs" / "own_plant"
COMMAND = Path(sys.executable).parent / "ros2-deepc"
DEADLINE = 90.0  # [s]


@pytest.fixture
def start(tmp_path, domain_id):
    """Starts a command and sees to its end."""
    env = dict(os.environ, ROS_DOMAIN_ID=str(domain_id))
    running = []

    def go(*command):
        with (tmp_path / f"log{len(running)}").open("w") as log:
            running.append(subprocess.Popen(list(map(str, command)), stdout=log, stderr=log, env=env, cwd=tmp_path))
        return running[-1]

    yield go
    for process in running:
        process.kill()
        process.wait()


def test_a_plant_of_ones_own_is_proved_and_controlled(start, tmp_path, domain_id):
    plant = start(sys.executable, EXAMPLE / "two_tanks.py", "--ros-args", "-p", "sample_time:=0.02")
    zone = start(COMMAND, "run", EXAMPLE / "tanks.yaml", "--record", "today")
    with ros([], domain_id) as context:
        seen = Observer(context=context, use_global_arguments=False)
        executor = make_executor("events", context)
        executor.add_node(seen)
        end = time.monotonic() + DEADLINE

        proved = set()  # a proof ends when its data do: at rest nothing moves any more

        def settled():
            for name in ("r_controllability", "r_observability"):
                if seen.report is not None and getattr(seen.report, name).verdict == Verdict.PROVED:
                    proved.add(name)
            return len(proved) == 2 and abs(seen.outputs.values[0] - 0.5) < 1e-3

        def done():
            return settled() or time.monotonic() > end or zone.poll() is not None

        spinner = Spinner(executor)
        seen.on_change = lambda: spinner.wake() if settled() else None
        spinner.until(done)
        executor.shutdown()
        seen.destroy_node()
    log = (tmp_path / "log1").read_text()
    assert time.monotonic() < end, log
    zone.send_signal(signal.SIGINT)
    assert zone.wait(DEADLINE) == 0, log
    plant.send_signal(signal.SIGINT)
    assert plant.wait(DEADLINE) == 0, (tmp_path / "log0").read_text()
    checked = subprocess.run(
        [COMMAND, "report", "today", "--out", "r.html"], cwd=tmp_path, capture_output=True, text=True
    )
    assert checked.returncode == 0, checked.stderr
