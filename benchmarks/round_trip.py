# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""From outputs to inputs over DDS, in one process with the events executor: how long the plant waits for its command.

python benchmarks/round_trip.py [--plant wscc9] [--steps 1500] [--period 0.02] [--monitor]

The plant node in real time and the controller node share an executor, as in `ros2-deepc run`. The time runs from the
moment before outputs k are published to the moment the inputs computed from them reach the plant, and is taken apart:

- out: from there to the controller's callback (first message);
- before: from the callback to the optimisation;
- solver: the step of the controller's agent, the optimisation with its checks and the limiter;
- after: from there to the moment before the inputs are published;
- back: from there to the plant's callback (second message);
- beside the solver: the whole trip but for that step, for which the goal is.

What the controller prepares for the next sample comes after. Samples under control only. The floor is what remains when
nobody computes anything: two bare nodes on the same executor play one message of the same type and size back and forth
with the same period. A processor that slept for a period needs longer for the same work: compare the periods.
"""

import argparse
import os
import time
from pathlib import Path

import numpy as np
from deepc_msgs.msg import Sample
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter
from threadpoolctl import threadpool_limits

from plant_sim.plant_node import PlantNode
from ros2_deepc.control.modes import Mode
from ros2_deepc.nodes.config import load, shipped
from ros2_deepc.nodes.controller_node import ControllerNode
from ros2_deepc.nodes.monitor_node import MonitorNode
from ros2_deepc.nodes.operator_node import OperatorNode
from ros2_deepc.ros import topics
from ros2_deepc.ros.convert import sample
from ros2_deepc.ros.qos import profile
from ros2_deepc.ros.run import Spinner, make_executor, ros

MEDIAN, P99 = 0.5, 5.0  # [ms], goals
PARTS = ("out", "before", "solver", "after", "back")
POINTS = ("sent", "heard", "asked", "solved", "answered", "back")


class Marks:
    """When which sample passed which point [s]."""

    def __init__(self):
        self.at = {point: {} for point in POINTS}

    def note(self, point, k):
        """Sample k passes now."""
        self.at[point].setdefault(int(k), time.perf_counter())

    def parts(self, first):
        """Times between the points [ms], shape (samples, 5), of the samples from ``first`` on that passed them all."""
        ks = sorted(set.intersection(*(set(times) for times in self.at.values())))
        table = np.array([[self.at[point][k] for point in POINTS] for k in ks if k >= first])
        return 1e3 * np.diff(table, axis=1)


class Noting:
    """A publisher that first calls ``note``."""

    def __init__(self, publisher, note):
        self._publisher, self._note = publisher, note

    def __getattr__(self, name):
        return getattr(self._publisher, name)

    def publish(self, msg):
        self._note()
        self._publisher.publish(msg)


class TimedPlant(PlantNode):
    """A plant node that notes what leaves it and what reaches it."""

    marks: Marks

    def configure(self):
        super().configure()
        self._outputs = Noting(self._outputs, lambda: self.marks.note("sent", self._k - self.shift))
        self.shift = max(int(self.plant.prior.s), 1)

    def _on_inputs(self, msg):
        self.marks.note("back", msg.k - self.shift)
        super()._on_inputs(msg)


class TimedController(ControllerNode):
    """A controller node that notes what it hears, decides and says."""

    marks: Marks

    def _on_outputs(self, msg):
        self.marks.note("heard", msg.k)
        super()._on_outputs(msg)

    def _on_plant(self, info):
        super()._on_plant(info)
        step, marks = self._agent.step, self.marks

        def timed(k, y, held=0):
            marks.note("asked", k)
            decision = step(k, y, held)
            marks.note("solved", k)
            return decision

        self._agent.step = timed

    def _send(self, k, u):
        self.marks.note("answered", k - self._agent.settings.s)
        super()._send(k, u)


def measure(plant, steps, period, solver, monitor, domain):
    """The parts of every round trip under control [ms], shape (samples, 5), and the samples that were held."""
    given = load(Path(shipped(plant)))
    given["plant"] |= {"mode": "realtime", "steps": 0}
    given["plant"]["speed"] = TimedPlant.plant_of(given["plant"]).sample_time / period
    given["controller"] |= {"solver": solver}
    marks = TimedPlant.marks = TimedController.marks = Marks()
    kinds = {"monitor": MonitorNode} if monitor else {}
    kinds |= {"controller": TimedController, "operator": OperatorNode, "plant": TimedPlant}
    nodes = {}
    with threadpool_limits(limits=1), ros([], domain) as context:
        executor = make_executor("events", context)
        for role, kind in kinds.items():
            values = {name: value for name, value in given.get(role, {}).items() if not name.startswith("readers")}
            values.pop("use_sim_time", None)
            overrides = [Parameter(name, value=value) for name, value in values.items()]
            nodes[role] = kind(context=context, parameter_overrides=overrides, use_global_arguments=False)
            executor.add_node(nodes[role])
            nodes[role].start()
        controller, first = nodes["controller"], None

        def done():
            nonlocal first
            back = marks.at["back"]
            if first is None and controller._agent is not None and controller._agent.mode is Mode.CONTROLLING:
                first = max(back, default=0) + 1
            return first is not None and len(back) >= first + steps

        Spinner(executor).until(done)
        for node in nodes.values():
            node.quiesce()
        executor.shutdown()
        for node in nodes.values():
            node.stop()
            node.destroy_node()
    return marks.parts(first), nodes["plant"].held_samples


def floor(steps, period, p, m, domain):
    """What two bare nodes need [ms]: there and back, shape (steps,), and how late their timer is, shape (steps,)."""
    there, back, due = [], [], []
    with ros([], domain) as context:
        one, other = (Node(name, context=context, use_global_arguments=False) for name in ("one", "other"))
        qos = profile(topics.OUTPUTS, lockstep=False, sample_time=period)
        ask, answer = one.create_publisher(Sample, "there", qos), other.create_publisher(Sample, "back", qos)
        plain = profile(topics.OUTPUTS, lockstep=False)
        other.create_subscription(
            Sample, "there", lambda msg: answer.publish(sample("p", 1, int(msg.k), np.zeros(m), 1)), plain
        )
        one.create_subscription(Sample, "back", lambda _msg: back.append(time.perf_counter()), plain)
        executor = make_executor("events", context)
        executor.add_node(one)
        executor.add_node(other)
        spinner = Spinner(executor)
        spinner.until(lambda: ask.get_subscription_count() and answer.get_subscription_count())

        def tick():
            due.append(time.perf_counter())
            msg = sample("p", 1, len(there), np.zeros(p), 1)
            there.append(time.perf_counter())
            ask.publish(msg)

        one.create_timer(period, tick, clock=Clock(clock_type=ClockType.STEADY_TIME))
        spinner.until(lambda: len(back) > steps)
        executor.shutdown()
        one.destroy_node()
        other.destroy_node()
    late = np.diff(due) - period
    return 1e3 * (np.array(back[:steps]) - np.array(there[:steps])), 1e3 * np.abs(late)


def row(name, values):
    """One line of the table."""
    median, most = np.quantile(values, (0.5, 0.99))
    print(f"  {name:32} {median:8.3f} {most:8.3f} {np.max(values):8.2f}")
    return median, most


def good(figures):
    """Whether median and 99 % quantile [ms] keep to the goals."""
    return figures[0] < MEDIAN and figures[1] < P99


def main() -> int:
    """Prints a table for each solver; 1 if the goal was missed beside the solver."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--plant", default="wscc9")
    parser.add_argument("--steps", type=int, default=1500, help="samples under control, each solver")
    parser.add_argument("--period", type=float, default=0.02, help="[s] of real time")
    parser.add_argument("--monitor", action="store_true", help="a monitor on the same executor")
    parser.add_argument("--domain", type=int, default=None, help="DDS domain")
    options = parser.parse_args()
    plant = TimedPlant.plant_of(load(Path(shipped(options.plant)))["plant"])
    sizes = len(plant.output_names), len(plant.input_names)
    missed = False
    busy = f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors"
    print(f"{options.plant}, a sample every {1e3 * options.period:g} ms, {busy}")
    print(f"  {'[ms]':32} {'median':>8} {'99 %':>8} {'largest':>8}")
    trip, late = floor(min(options.steps, 500), options.period, *sizes, options.domain)
    row("floor: two bare nodes", trip)
    row("floor: timer off its period", late)
    for solver in ("osqp", "daqp"):
        parts, held = measure(options.plant, options.steps, options.period, solver, options.monitor, options.domain)
        for name, values in zip(PARTS, parts.T, strict=True):
            row(f"{solver}: {name}", values)
        whole = parts.sum(axis=1)
        beside = row(f"{solver}: beside the solver", whole - parts[:, PARTS.index("solver")])
        judged = good(beside), good(row(f"{solver}: round trip", whole))
        missed |= not judged[0]
        verdicts = ["below" if kept else "ABOVE" for kept in judged]
        print(
            f"  {len(whole)} samples, held {held}; goal {MEDIAN}/{P99} ms: {verdicts[0]} beside the solver, "
            f"{verdicts[1]} with it"
        )
    return int(missed)


if __name__ == "__main__":
    raise SystemExit(main())
