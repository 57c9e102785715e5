# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Work that comes after the loop: in order, behind the readers of what was published, and not without its node."""

import time

import pytest
from std_msgs.msg import Int64

from ros2_deepc.ros.deferred import AT_ONCE, Deferred
from ros2_deepc.ros.lifecycle import ManagedNode
from ros2_deepc.ros.run import EXECUTORS, Spinner, make_executor, ros

DEADLINE = 30.0  # [s]


class Worker(ManagedNode):
    """Publishes to itself and leaves work for later."""

    def configure(self):
        self.log = []
        self.after = Deferred(self, AT_ONCE)
        self.publisher = self.create_publisher(Int64, "x", 10)
        self.resources.callback(self.destroy_publisher, self.publisher)
        self.create_subscription(Int64, "x", lambda msg: self.log.append(msg.data), 10)


@pytest.fixture(params=EXECUTORS)
def worker(request, domain_id):
    with ros([], domain_id) as context:
        node = Worker("worker", context=context, use_global_arguments=False)
        executor = make_executor(request.param, context)
        executor.add_node(node)
        spinner = Spinner(executor)

        def until(condition):
            end = time.monotonic() + DEADLINE
            spinner.until(lambda: condition() or time.monotonic() > end)
            assert condition()

        node.start()
        until(lambda: node.publisher.get_subscription_count() == 1)
        yield node, until
        executor.shutdown()
        node.stop()
        node.destroy_node()


def test_work_is_done_in_order_behind_the_readers_of_what_was_published(worker):
    node, until = worker
    for i in range(20):
        node.publisher.publish(Int64(data=i))
        node.after(lambda i=i: node.log.append(f"{i} after"))
        node.after(lambda i=i: node.log.append(f"{i} last"))
        until(lambda i=i: len(node.log) == 3 * (i + 1))
    expected = [entry for i in range(20) for entry in (i, f"{i} after", f"{i} last")]
    assert [entry for entry in node.log if not isinstance(entry, int)] == [
        e for e in expected if not isinstance(e, int)
    ]
    if type(node.executor).__name__ == "EventsExecutor":  # the other one takes timers first
        assert node.log == expected


def test_work_that_fails_ends_the_node_and_what_is_left_is_not_done(worker):
    node, until = worker

    def fail():
        raise RuntimeError("no")

    node.after(fail)
    node.after(lambda: node.log.append("too late"))
    until(lambda: node.fault)
    assert node.fault == "RuntimeError: no"
    node.trigger_activate()
    node.after(lambda: node.log.append("again"))
    until(lambda: node.log)
    assert node.log == ["again"]


def test_an_inactive_node_does_nothing(worker):
    node, until = worker
    node.after(lambda: node.log.append("never"))
    node.quiesce()
    node.publisher.publish(Int64(data=1))
    until(lambda: not node.after._due and 1 in node.log)
    assert node.log == [1]


def test_nobody_spins_the_node_so_work_is_done_at_once(domain_id):
    with ros([], domain_id) as context:
        node = Worker("worker", context=context, use_global_arguments=False)
        node.start()
        node.after(lambda: node.log.append("now"))
        assert node.log == ["now"]
        node.stop()
        node.destroy_node()
