# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Starting and stopping a whole zone again and again in one process: what is left? Exits non-zero if anything is.

python benchmarks/cycles.py [--cycles 200]

Each cycle makes its own ROS context, starts all nodes with a recorder, runs some samples and stops. Afterwards threads,
open files and shared memory must be those after the first cycles, and a node that looks at the graph must be alone.
"""

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from rclpy.node import Node
from soak import ROLES, resources
from threadpoolctl import threadpool_limits

from ros2_deepc.bags.reader import BagReader
from ros2_deepc.nodes.config import load, merged, shipped, text_of
from ros2_deepc.nodes.stack import running
from ros2_deepc.ros.run import Spinner, make_executor, ros

STEPS = 10  # samples a cycle
WARM_UP = 5  # cycles: caches, imports, pools of the middleware
LINGER = 20.0  # [s] at most until the last participant has said goodbye
GROWTH = 0.1  # MB a cycle


def shared_memory():
    """Shared memory of the middleware that belongs to this process."""
    maps = Path("/proc/self/maps").read_text().splitlines()
    return len({line.split()[-1] for line in maps if "/dev/shm/" in line})


def one_cycle(domain_id=None):
    """A zone from start to stop; its bag must be complete."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        parameters = merged(
            load(shipped("wscc9")),
            {
                "plant": {"steps": STEPS, "readers": 4},
                "controller": {"readers_inputs": 3, "readers_state": 2},
                "operator": {"readers": 2},
                "recorder": {"folder": str(folder / "bag"), "idle": 0.02},
            },
        )
        file = folder / "parameters.yaml"
        file.write_text(text_of(parameters), encoding="utf-8")
        with running(("recorder", *ROLES), file, namespace="/cycle", domain_id=domain_id) as stack:
            seen = stack.observer

            def over():
                return (seen.state is not None and seen.state.k == STEPS - 1) or bool(stack.failure())

            seen.on_change = lambda: stack.spinner.wake() if over() else None
            stack.spinner.until(over)
            if stack.failure():
                raise SystemExit(f"the zone broke down: {stack.failure()}")
            stack.finish()
        bag = BagReader(folder / "bag")
        if not bag.complete or not bag.topics["/cycle/outputs"].count:
            raise SystemExit("the bag of a cycle was not closed")


def cycles(count, *, domain_id=None, tell=lambda _row: None):
    """Runs ``count`` cycles.

    Returns:
        Array of shape (count, 6): cycle, MB, objects of Python, threads, files, shared memory, after each cycle.
    """
    rows = []
    for i in range(count):
        one_cycle(domain_id)
        rows.append((i + 1, *resources(), shared_memory()))
        tell(rows[-1])
    return np.array(rows)


def others_in_the_graph(domain_id=None):
    """Names of nodes that somebody who comes now still sees, after waiting for late goodbyes."""
    with ros([], domain_id) as context:
        looker = Node("looker", context=context, use_global_arguments=False)
        executor = make_executor("events", context)
        executor.add_node(looker)
        end = time.monotonic() + LINGER

        def others():
            return [name for name in looker.get_node_names() if name != "looker"]

        Spinner(executor).until(lambda: not others() or time.monotonic() > end)
        left = others()
        executor.shutdown()
        looker.destroy_node()
    return left


def left_over(rows):
    """What the cycles after warm-up have added: (threads, files, shared memory, MB a cycle)."""
    first, last = rows[min(WARM_UP, len(rows) // 2) - 1], rows[-1]
    return *(last[3:] - first[3:]).astype(int), float((last[1] - first[1]) / (last[0] - first[0]))


def main():
    """Prints a row every few cycles and judges the last."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cycles", type=int, default=200)
    count = parser.parse_args().cycles
    print(f"{'cycle':>6} {'MB':>8} {'objects':>8} {'threads':>8} {'files':>6} {'shared':>7}")

    def tell(row):
        if row[0] <= WARM_UP or row[0] % max(count // 20, 1) == 0:
            print("{:6d} {:8.2f} {:8d} {:8d} {:6d} {:7d}".format(*row), flush=True)

    threads, files, shared, growth = left_over(cycles(count, tell=tell))
    graph = others_in_the_graph()
    print(f"left over: {threads} threads, {files} files, {shared} shared memory; nodes in the graph: {graph or 'none'}")
    print(f"memory: {growth:+.3f} MB a cycle, goal below {GROWTH}")
    return int(max(threads, files, shared) > 0 or bool(graph) or growth > GROWTH)


if __name__ == "__main__":
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with threadpool_limits(limits=1):
        sys.exit(main())
