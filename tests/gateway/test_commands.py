# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""`ros2-deepc field` comes with a tag map that fits; `gateway --check` reads every tag and writes nothing."""

import subprocess
import sys
import threading
from pathlib import Path

import pytest
from rclpy.node import Node
from std_msgs.msg import Float64, Float64MultiArray

from ros2_deepc.gateway import GatewayError
from ros2_deepc.gateway.commands import HEADER, FieldOptions, check, run_field
from ros2_deepc.ros.run import Spinner, make_executor, ros

COMMAND = Path(sys.executable).parent / "ros2-deepc"


def test_check_reads_every_tag_of_a_served_plant_and_writes_nothing(tmp_path, free_port, served):
    pytest.importorskip("pymodbus")
    tags = tmp_path / "tags.yaml"
    with served("net3", tags, "--modbus", "--port", free_port(), "--speed", 86400, "--type", "float32"):
        shown = subprocess.run([COMMAND, "gateway", tags, "--check"], capture_output=True, text=True, timeout=60)
        rows = check(tags)
    assert [row[0] for row in rows] == ["R1", "T3", "scan", "echo", *[row[0] for row in rows[4:7]], "beat"]
    assert all(len(row) == len(HEADER) for row in rows)
    assert [row[-1] for row in rows[:4]] == ["GOOD"] * 4
    assert [float(row[6]) for row in rows[:2]] == [4.0, 2.0]
    assert rows[3][6] == "0"  # no heartbeat was written
    assert shown.returncode == 0
    assert shown.stdout.splitlines()[0].split() == list(HEADER)
    assert [line.split()[0] for line in shown.stdout.splitlines()[1:]] == [row[0] for row in rows]
    with pytest.raises(GatewayError, match="no connection"):
        check(tags)


def test_a_field_that_cannot_be_served_says_why(tmp_path):
    with pytest.raises(GatewayError, match="unknown plant 'nosuch'; there are: "):
        run_field("nosuch", FieldOptions(protocol="modbus"))
    pytest.importorskip("pymodbus")
    with pytest.raises(GatewayError, match="--type float63: there are int16"):
        run_field("wscc9", FieldOptions(protocol="modbus", type="float63"))
    pytest.importorskip("asyncua")
    with pytest.raises(GatewayError, match=r"listen on 127\.0\.0\.1 only"):
        run_field("wscc9", FieldOptions(protocol="opcua", host="0.0.0.0"), lambda _: None)
    with pytest.raises(GatewayError, match="FIELD_CONTROLLER_PASSWORD"):
        run_field("wscc9", FieldOptions(protocol="opcua", pki=tmp_path), lambda _: None)


TOPICS = """\
plant: {name: sim, sample_time: 0.1}
link: {kind: ros}
outputs:
  - {name: y, unit: m, count: 2, scale: 2.0, at: {topic: sim/y, type: std_msgs/msg/Float64MultiArray, field: 'data[0]'}}
  - {name: silent, unit: '', at: {topic: sim/silent}}
inputs:
  - {name: u, unit: '', limits: [-1, 1], max_rate: 9, safe: 0, at: {topic: sim/u}}
"""


def test_check_listens_to_every_topic_and_publishes_on_none(tmp_path, domain_id):
    """A topic that stays silent is BAD, and the check ends all the same."""
    tags, done, told = tmp_path / "tags.yaml", threading.Event(), []
    tags.write_text(TOPICS)
    with ros([], domain_id) as context:
        node = Node("simulator", namespace="zone", context=context, use_global_arguments=False)
        publisher = node.create_publisher(Float64MultiArray, "sim/y", 10)
        node.create_timer(0.05, lambda: publisher.publish(Float64MultiArray(data=[1.5, -2.0])))
        node.create_subscription(Float64, "sim/u", told.append, 10)
        executor = make_executor("single", context)
        executor.add_node(node)
        thread = threading.Thread(target=lambda: Spinner(executor).until(done.is_set))
        thread.start()
        try:
            rows = check(tags, "/zone")
        finally:
            done.set()
            thread.join()
            executor.shutdown()
            node.destroy_node()
    assert [row[-2:] for row in rows] == [("3", "GOOD"), ("-4", "GOOD"), ("nan", "BAD"), ("-", "-")]
    assert told == []
