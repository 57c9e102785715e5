# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""What the diagnostics judge: quantities with hysteresis, deadlines that a sender missed, repeated reports."""

import math
import time

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from ros2_deepc.ros import topics
from ros2_deepc.ros.convert import sample
from ros2_deepc.ros.diagnostics import OK, WARN, Diagnostics
from ros2_deepc.ros.health import Band, Health
from ros2_deepc.ros.publisher import PatientPublisher
from ros2_deepc.ros.run import Spinner, make_executor, ros


def fed(health, samples, gap=0.1, answer=0.01, limited=False):
    return sum(health.sample(gap, answer, limited) for _ in range(samples))


def test_a_band_is_left_at_a_lower_value_than_it_is_entered():
    band = Band(0.5, 0.25, "uneven")
    assert [band.judge(value) for value in (0.4, 0.5, 0.4, 0.26, 0.24, 0.4, 0.6)] == [
        False, True, True, True, False, False, True,
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("trouble", "complaint"),
    [
        ({"gap": 0.2}, "outputs come unevenly"),
        ({"answer": 0.09}, "answers take most of the period"),
        ({"limited": True}, "inputs are at their limits most of the time"),
    ],
)
def test_trouble_is_told_and_forgotten_when_it_has_passed(trouble, complaint):
    health = Health(0.1)
    assert fed(health, 100) == 0
    assert health.complaints() == []
    fed(health, 100, **trouble)
    assert health.complaints() == [complaint]
    fed(health, 100)
    assert health.complaints() == []


def test_answers_that_take_longer_than_the_period_miss_their_deadline():
    health = Health(0.1)
    assert fed(health, 80) == 0
    assert fed(health, 20, answer=0.11) == 20
    assert "deadlines are missed" in health.complaints()
    assert health.values()["missed"] == pytest.approx(0.2)


def test_outputs_that_are_overdue_are_missed_too():
    health = Health(0.1)
    fed(health, 20)
    for _ in range(20):
        health.overdue()
    assert health.values()["missed"] == 0.5


def test_lockstep_knows_no_lateness():
    health = Health(0.0)
    assert fed(health, 100, gap=9.0, answer=9.0) == 0
    assert health.complaints() == []
    assert not any(math.isnan(value) for value in health.values().values())


def test_a_sender_counts_the_periods_in_which_it_kept_silent(domain_id):
    with ros([], domain_id) as context:
        node = Node("sender", context=context, use_global_arguments=False)
        publisher = PatientPublisher(node, topics.OUTPUTS, lockstep=False, sample_time=0.01)
        lockstep = PatientPublisher(node, topics.INPUTS, lockstep=True, sample_time=0.0)
        end = time.monotonic() + 0.1  # five deadlines of two periods
        msg = sample("p", 1, 0, [1.0], 1)
        for sender in (publisher, lockstep):
            sender.publish(msg)
        assert publisher.deadlines_missed == 0
        executor = make_executor("single", context)
        executor.add_node(node)
        Spinner(executor).until(lambda: time.monotonic() > end)
        for sender in (publisher, lockstep):
            sender.publish(msg)
        assert publisher.deadlines_missed >= 4
        assert lockstep.deadlines_missed == 0
        executor.shutdown()
        node.destroy_node()


def test_a_report_is_published_when_it_changes_else_once_a_second(domain_id):
    with ros([], domain_id) as context:
        executor = make_executor("events", context)
        node = Node("reporter", context=context, use_global_arguments=False)
        executor.add_node(node)
        told = []
        node.create_subscription(DiagnosticArray, "/diagnostics", lambda msg: told.extend(msg.status), 10)
        diagnostics = Diagnostics(node, "p")
        until = Spinner(executor).until
        until(lambda: node.count_publishers("/diagnostics") == 1)
        begin = time.monotonic()
        diagnostics.report(OK, "fine", {"k": 1})
        diagnostics.report(OK, "fine", {"k": 2})
        diagnostics.report(WARN, "late", {"k": 3})
        until(lambda: len(told) >= 2)
        until(lambda: not diagnostics.report(WARN, "late", {"k": 4}) and len(told) >= 3)
        seen = [(status.message, status.values[0].value) for status in told[:3]]
        assert seen == [("fine", "1"), ("late", "3"), ("late", "4")]
        assert time.monotonic() - begin >= 1.0
        executor.shutdown()
        diagnostics.destroy()
        node.destroy_node()
