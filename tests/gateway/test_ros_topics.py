# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""A grid simulator on plain topics, at different rates, through the gateway node and its services."""

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from deepc_msgs.msg import PlantInfo, Sample
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_msgs.msg import Float64, Float64MultiArray
from std_srvs.srv import SetBool, Trigger

from ros2_deepc.gateway.field_path import look_up, put, put_array, steps
from ros2_deepc.gateway.gateway_node import GatewayNode
from ros2_deepc.gateway.round_trip import load as load_round_trip
from ros2_deepc.ros import topics
from ros2_deepc.ros.convert import sample
from ros2_deepc.ros.parameters import ConfigError
from ros2_deepc.ros.qos import profile
from ros2_deepc.ros.run import Spinner, make_executor, ros

TAGS = """\
plant: {name: sim, sample_time: 0.05}
link: {kind: ros}
sampling: {by: scan, counter: {topic: sim/y, type: std_msgs/msg/Float64MultiArray, field: message_count}}
supervision: {stale_after: 0.4, fallback_after: 0.6}
fallback: {policy: ramp, seconds: 0.2}
outputs:
  - {name: y, unit: m, count: 2, scale: 2.0, at: {topic: sim/y, type: std_msgs/msg/Float64MultiArray, field: 'data[0]'}}
  - {name: z, unit: '', at: {topic: sim/z, type: diagnostic_msgs/msg/DiagnosticArray, field: header.stamp.nanosec}}
inputs:
  - {name: u, unit: '', count: 2, limits: [-1, 1], max_rate: 40, safe: 0.25,
     at: {topic: sim/u, type: std_msgs/msg/Float64MultiArray, field: 'data[0]'}}
  - {name: v, unit: '', limits: [-1, 1], max_rate: 40, safe: 0, at: {topic: sim/v}}
"""


class Simulator(Node):
    """Publishes at 20 and 10 Hz, keeps what it is told, and plays the controller."""

    def __init__(self, **kwargs):
        super().__init__("simulator", **kwargs)
        self.told, self.samples, self.infos, self.reports, self.ticks = [], [], [], [], 0
        self.running = True
        self.create_subscription(Float64MultiArray, "sim/u", lambda msg: self.told.append(list(msg.data)), 10)
        self.create_subscription(Float64, "sim/v", lambda msg: self.told.append(msg.data), 10)
        self.create_subscription(Sample, "outputs", self.samples.append, profile(topics.OUTPUTS, lockstep=False))
        self.create_subscription(PlantInfo, "plant_info", self.infos.append, profile(topics.PLANT_INFO))
        self.create_subscription(DiagnosticArray, "/diagnostics", self.reports.append, 10)
        self.y = self.create_publisher(Float64MultiArray, "sim/y", 10)
        self.z = self.create_publisher(DiagnosticArray, "sim/z", 10)
        self.inputs = self.create_publisher(Sample, "inputs", profile(topics.INPUTS, lockstep=False))
        self.auto = self.create_client(SetBool, "gateway/auto")
        self.acknowledge = self.create_client(Trigger, "gateway/acknowledge")
        self.new_data = self.create_client(Trigger, "gateway/new_data")
        self.create_timer(0.05, self.tick)

    def tick(self):
        if not self.running:
            return
        self.ticks += 1
        if self.ticks % 2:
            msg = DiagnosticArray()
            msg.header.stamp = self.get_clock().now().to_msg()
            msg.header.stamp.nanosec = msg.header.stamp.nanosec // 1000 * 1000 + 7
            self.z.publish(msg)
        self.y.publish(Float64MultiArray(data=[float(self.ticks), -1.5]))

    def send(self, k, values, epoch, sender=0):
        self.inputs.publish(sample("sim", epoch, k, np.asarray(values, float), 1, sender=sender))


@pytest.fixture
def world(domain_id, tmp_path, request):
    """A simulator and a gateway on one executor, and a way to wait; a parameter is added to the tag map."""
    path = tmp_path / "tags.yaml"
    path.write_text(TAGS + getattr(request, "param", ""))
    (tmp_path / "kept.json").write_text('{"round_trip": 0.5}')
    with ros([], domain_id) as context:
        executor = make_executor("events", context)
        spinner = Spinner(executor)
        gateway = GatewayNode(
            context=context, parameter_overrides=[Parameter("tags", value=str(path))], use_global_arguments=False
        )
        simulator = Simulator(context=context, use_global_arguments=False)
        executor.add_node(gateway)
        executor.add_node(simulator)

        def until(condition):
            end = time.monotonic() + 60.0
            spinner.until(lambda: bool(condition()) or time.monotonic() > end)
            assert condition(), (gateway.gateway.supervisor.reason, gateway.fault)

        def ask(client, request):
            until(client.service_is_ready)
            future = client.call_async(request)
            until(future.done)
            return future.result()

        gateway.start()
        yield gateway, simulator, until, ask
        gateway.quiesce()
        executor.shutdown()
        gateway.stop()
        for node in (gateway, simulator):
            node.destroy_node()


def as_typed(until, *request):
    """What `ros2-deepc ask` answers: exit code and text."""
    command = Path(sys.executable).parent / "ros2-deepc"
    child = subprocess.Popen([command, "ask", *request], stdout=subprocess.PIPE, text=True)
    with child:
        until(lambda: child.poll() is not None)
        return child.returncode, child.stdout.read()


def test_from_shadow_to_run_to_fallback_and_back(world):
    gateway, sim, until, ask = world
    until(lambda: len(sim.samples) > 3 and sim.infos)
    assert sim.infos[0].input_names == ["u0", "u1", "v"]
    first = sim.samples[-1]
    assert (first.epoch, list(first.quality)) == (0, [1, 1, 1])
    assert first.values[1] == -3.0
    assert sim.told == []
    sim.send(0, [0, 0, 0], epoch=1)

    assert ask(sim.auto, SetBool.Request(data=True)).success
    until(lambda: sim.infos[-1].epoch == 2)
    assert not ask(sim.acknowledge, Trigger.Request()).success
    sim.send(0, [0.5, -0.5, 0.125], epoch=2, sender=3)
    until(lambda: len(sim.told) == 2)
    sim.send(1, [0.5, -0.5, 0.125], epoch=2, sender=4)  # another controller, while the first is still there
    until(lambda: gateway.gateway.guard.counts.refused["another commands"] == 1)
    assert [0.5, -0.5] in sim.told
    assert 0.125 in sim.told
    until(lambda: sim.samples[-1].epoch == 2)
    assert len(sim.samples[-1].quality) == 0
    assert sim.samples[-1].sender == 3

    # nobody sends commands any more: DEGRADED, then FALLBACK with the safe values
    until(lambda: gateway.gateway.state == "FALLBACK")
    until(lambda: [0.25, 0.25] in sim.told and 0.0 in sim.told)
    until(lambda: sim.samples[-1].epoch == 0)
    assert ask(sim.acknowledge, Trigger.Request()).success
    until(lambda: sim.infos[-1].epoch == 3)
    levels = {status.level for report in sim.reports for status in report.status if status.name == "gateway"}
    assert levels == {b"\x00", b"\x01", b"\x02"}


def test_a_simulator_that_stops_is_noticed_and_its_return_needs_no_restart(world):
    gateway, sim, until, ask = world
    until(lambda: len(sim.samples) > 3)
    assert as_typed(until, "auto") == (0, "commands are passed on after a few good samples\n")
    until(lambda: sim.infos[-1].epoch == 2)
    code, said = as_typed(until, "acknowledge")
    assert code == 1
    assert said.startswith("nothing to acknowledge in ")
    sim.running = False
    until(lambda: gateway.gateway.state == "FALLBACK")
    assert "no sample" in gateway.gateway.supervisor.reason
    sim.running = True

    def running():  # a loaded machine may delay samples again between the look and the request
        if gateway.gateway.state == "FALLBACK" and gateway.gateway._steady():
            ask(sim.acknowledge, Trigger.Request())
        return gateway.gateway.state == "RUN"

    until(running)


@pytest.mark.parametrize("world", ["round_trip: {file: kept.json}\n"], indirect=True)
def test_the_round_trip_of_the_data_outlives_the_session(world, tmp_path):
    """The file says 0.5 s, 10 samples away from now: AUTO is refused until new data are announced, then kept anew."""
    gateway, sim, until, ask = world
    kept = tmp_path / "kept.json"
    until(lambda: len(sim.samples) > 5)
    answer = ask(sim.auto, SetBool.Request(data=True))
    assert not answer.success
    assert "it was 500 ms when the data were collected: collect new data" in answer.message
    assert ask(sim.new_data, Trigger.Request()).success
    assert not kept.exists()
    assert ask(sim.auto, SetBool.Request(data=True)).success
    until(kept.exists)
    assert load_round_trip(kept) == gateway.gateway.round_trip.reference < 0.1
    kept.write_text('{"round_trip": -1}')
    with pytest.raises(ValueError, match="is impossible"):
        load_round_trip(kept)
    kept.write_text("[]")
    with pytest.raises(ValueError, match=r"holds no round trip .* delete it if new data will be collected"):
        load_round_trip(kept)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("field: header.stamp.nanosec", "field: nosuch", "has no field nosuch; it has header, status"),
        ("diagnostic_msgs/msg/DiagnosticArray", "diagnostic_msgs/msg/Nosuch", "is not installed here"),
        ("at: {topic: sim/v}", "at: {topic: sim/v, field: nosuch}", "is not a number of Float64"),
        ("'data[0]'}}\n  - {name: v", "'data[1]'}}\n  - {name: v", "needs all elements from 0 on"),
        ("limits: [-1, 1], max_rate", "max_rate", "line 10, column 5: .*'limits' is missing"),
    ],
)
def test_what_cannot_work_is_said_before_anything_runs(domain_id, tmp_path, old, new, expected):
    path = tmp_path / "tags.yaml"
    assert old in TAGS
    path.write_text(TAGS.replace(old, new, 1))
    with ros([], domain_id) as context:
        node = GatewayNode(
            context=context, parameter_overrides=[Parameter("tags", value=str(path))], use_global_arguments=False
        )
        with pytest.raises(ConfigError, match=expected):
            node.start()
        node.stop()
        node.destroy_node()


def test_field_paths():
    msg = DiagnosticArray()
    put(msg, steps("header.stamp.sec"), 12.0)
    assert look_up(msg, steps("header.stamp.sec")) == 12.0
    assert np.isnan(look_up(msg, steps("status[0].level")))
    assert np.isnan(look_up(msg, steps("header.frame_id")))
    array = Float64MultiArray()
    put_array(array, steps("data"), [1.0, 2.0])
    assert look_up(array, steps("data[1]")) == 2.0
    assert np.isnan(look_up(array, steps("data[2]")))
