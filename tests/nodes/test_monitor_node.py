# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The monitor node on the wire: reports, indicator, diagnostics, parameters that change while it runs."""

import json
import time

import numpy as np
import pytest
from deepc_msgs.msg import Change, Indicator, MonitorReport, PlantInfo, Sample
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from rclpy.parameter import Parameter

from ros2_deepc.monitors import Verdict
from ros2_deepc.nodes.monitor_node import MonitorNode, change_live, make_live, report_message
from ros2_deepc.ros import topics
from ros2_deepc.ros.convert import sample
from ros2_deepc.ros.qos import profile
from ros2_deepc.ros.run import Spinner, make_executor, ros

DEADLINE = 60.0  # [s]
A, B, C = np.array([[0.9, 0.2], [-0.1, 0.8]]), np.array([0.3, 1.0]), np.array([1.0, 0.0])


class Source(Node):
    """A plant of order 2 and whoever commands it, and a reader of all that the monitor says."""

    def __init__(self, **kwargs):
        super().__init__("source", **kwargs)
        self.x, self.k = np.array([1.0, -1.0]), 0
        self.rng = np.random.Generator(np.random.PCG64(1))
        self.u_log, self.y_log = [], []
        self.info = PlantInfo(name="p", epoch=1, sample_time=1.0, q=2, s=1, n=2, lockstep=True)
        self.info.input_names, self.info.output_names = ["u"], ["y"]
        self.info_topic = self.create_publisher(PlantInfo, "plant_info", profile(topics.PLANT_INFO))
        self.inputs, self.outputs = (self.create_publisher(Sample, n, profile(t)) for n, t in
                                     (("inputs", topics.INPUTS), ("outputs", topics.OUTPUTS)))  # fmt: skip
        self.reports, self.indicators, self.changes, self.diagnostics = [], [], [], []
        self.wake = lambda: None
        for kind, topic, heard in (
            (MonitorReport, topics.REPORT, self.reports),
            (Indicator, topics.INDICATOR, self.indicators),
            (Change, topics.MONITOR_CHANGES, self.changes),
            (DiagnosticArray, topics.DIAGNOSTICS, self.diagnostics),
        ):
            self.create_subscription(kind, topic.name, self._keeps(heard), profile(topic))

    def _keeps(self, heard):
        return lambda msg: (heard.append(msg), self.wake())

    def sample(self, u=None):
        u = self.rng.uniform(-1, 1) if u is None else u
        y = float(C @ self.x)
        self.x = A @ self.x + B * u
        self.u_log.append([u])
        self.y_log.append([y])
        self.inputs.publish(sample("p", 1, self.k, np.array([u]), self.k + 1))
        self.outputs.publish(sample("p", 1, self.k, np.array([y]), self.k + 1))
        self.k += 1


@pytest.fixture
def rig(domain_id):
    """The monitor node and its source in one process, and helpers to drive them."""
    with ros([], domain_id) as context:
        executor = make_executor("events", context)

        class Rig:
            def start(self, **values):
                overrides = [Parameter(name, value=value) for name, value in values.items()]
                self.node = MonitorNode(context=context, parameter_overrides=overrides, use_global_arguments=False)
                self.source = Source(context=context, use_global_arguments=False)
                self.spinner = Spinner(executor)
                self.source.wake = self.spinner.wake
                executor.add_node(self.node)
                executor.add_node(self.source)
                self.node.start()
                self.source.info_topic.publish(self.source.info)
                self.until(lambda: self.source.inputs.get_subscription_count() == 1)
                self.until(lambda: self.source.outputs.get_subscription_count() == 1)
                for topic in ("monitor/report", "monitor/indicator", "monitor/changes"):
                    self.until(lambda topic=topic: self.source.count_publishers(topic) == 1)
                self.until(lambda: self.node._report.connected and self.node._record.connected)

            def until(self, condition):
                end = time.monotonic() + DEADLINE
                self.spinner.until(lambda: condition() or time.monotonic() > end)
                assert condition()

            def run(self, samples, u=None):
                for _ in range(samples):
                    self.source.sample(u)
                    self.until(lambda: self.node._live._next == self.source.k)

            def report(self, k):
                self.until(lambda: any(msg.k == k for msg in self.source.reports))
                return next(msg for msg in self.source.reports if msg.k == k)

            def set(self, **values):
                client = self.source.create_client(SetParameters, "monitor/set_parameters")
                self.until(client.service_is_ready)
                asked = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
                future = client.call_async(SetParameters.Request(parameters=asked))
                self.until(future.done)
                (result,) = future.result().results
                return result

        made = Rig()
        yield made
        executor.shutdown()
        made.node.stop()
        made.node.destroy_node()
        made.source.destroy_node()


def test_parameters_change_at_a_sample_and_a_replay_can_follow(rig):
    rig.start(window=50, period=20)
    rig.run(40)
    assert rig.report(39).r_controllability.verdict == Verdict.PROVED
    for name, value in (("period", 5), ("noise", [0.5]), ("window", 60)):
        assert rig.set(**{name: value}).successful
    rig.run(25)
    noisy = rig.report(44)
    assert noisy.r_controllability.verdict == Verdict.UNDECIDED
    assert "last proved at k = 39, 5 samples ago" in noisy.r_controllability.reason
    assert rig.set(noise=[0.0]).successful
    rig.run(5)
    again = rig.report(69)
    assert again.r_controllability.verdict == Verdict.PROVED
    assert again.window == 60
    assert sorted(msg.k for msg in rig.source.reports) == [19, 39, 44, 49, 54, 59, 64, 69]

    rig.until(lambda: len(rig.source.changes) == 2)
    assert [msg.k for msg in rig.source.changes] == [40, 65]
    parameters, reports = {"window": 50, "period": 20}, {}
    live = make_live(parameters, rig.source.info)
    for k, (u, y) in enumerate(zip(rig.source.u_log, rig.source.y_log, strict=True)):
        for msg in rig.source.changes:
            if msg.k == k:
                parameters |= json.loads(msg.value)
                change_live(live, k, parameters, rig.source.info)
        for job in live.input(k, u) + live.output(k, y):
            reports[job.k] = report_message(live.analyse(job))
    for msg in rig.source.reports:
        assert msg.r_controllability == reports[msg.k].r_controllability
        assert (msg.window, msg.rank) == (reports[msg.k].window, reports[msg.k].rank)


@pytest.mark.parametrize(
    ("name", "value", "hint"),
    [
        ("noise", [0.1, 0.1, 0.1], "noise has 3 entries, the plant 1 outputs"),
        ("noise", [-1.0], "out of range"),
        ("window", 0, "out of range"),
        ("q", 3, "read-only"),
    ],
)
def test_what_cannot_be_is_refused_with_a_reason(rig, name, value, hint):
    rig.start(window=50, period=20)
    rig.run(20)
    result = rig.set(**{name: value})
    assert not result.successful
    assert hint in result.reason
    rig.run(20)
    assert rig.report(39).r_controllability.verdict == Verdict.PROVED
    assert rig.source.changes == []


def test_lost_excitation_is_said_with_orders_and_the_age_of_the_last_proof(rig):
    rig.start(window=40, period=20)
    rig.run(40)
    rig.run(60, u=0.5)
    assert rig.report(39).r_controllability.verdict == Verdict.PROVED
    lost = rig.report(99)
    assert lost.r_controllability.verdict == Verdict.UNDECIDED
    assert "persistently exciting of order 1 only, this window needs 3" in lost.r_controllability.reason
    assert "last proved at k = " in lost.r_controllability.reason
    assert (lost.excitation, lost.excitation_need) == (1, 5)
    rig.until(lambda: any(msg.k == 99 for msg in rig.source.indicators))
    assert rig.source.indicators[-1].r_controllability == -np.inf
    texts = [status.message for array in rig.source.diagnostics for status in array.status if status.name == "monitor"]
    assert any("r_controllability PROVED" in text for text in texts)
    rig.until(lambda: any("r_controllability UNDECIDED" in status.message
                          for array in rig.source.diagnostics for status in array.status))  # fmt: skip
    last = rig.source.diagnostics[-1].status[0]
    values = {pair.key: pair.value for pair in last.values}
    assert "last proved" in values["r_controllability"]
    assert values["excitation"] == "1 of 5"


def test_an_analysis_in_a_thread_says_the_same(rig):
    rig.start(window=60, period=30, worker=True)
    rig.run(30)
    rig.report(29)
    rig.until(lambda: rig.node._busy.done())
    rig.run(30)
    report = rig.report(59)
    live = make_live({"window": 60, "period": 30}, rig.source.info)
    jobs = [job for k in range(60) for job in live.input(k, rig.source.u_log[k]) + live.output(k, rig.source.y_log[k])]
    assert report.r_controllability == report_message(live.analyse(jobs[-1])).r_controllability
