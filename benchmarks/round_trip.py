# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""From outputs to inputs over DDS, in one process with the events executor: how long the plant waits for its command.

python benchmarks/round_trip.py [--plant wscc9] [--steps 1500] [--period 0.02] [--monitor]

The plant node in real time and the controller node share an executor, as in `ros2-deepc run`. The time runs from the
moment before outputs k are published to the moment the inputs computed from them reach the plant: two messages, the
optimisation and the executor between them. What the controller prepares for the next sample comes after. Samples
under control only.
"""

import argparse
import os
import time
from pathlib import Path

import numpy as np
from rclpy.parameter import Parameter
from threadpoolctl import threadpool_limits

from plant_sim.plant_node import PlantNode
from ros2_deepc.control.modes import Mode
from ros2_deepc.nodes.config import load, shipped
from ros2_deepc.nodes.controller_node import ControllerNode
from ros2_deepc.nodes.monitor_node import MonitorNode
from ros2_deepc.nodes.operator_node import OperatorNode
from ros2_deepc.ros.run import Spinner, make_executor, ros

MEDIAN, P99 = 0.5, 5.0  # [ms], goals


class Stopwatch:
    """A publisher that notes when it was asked to publish which sample."""

    def __init__(self, publisher):
        self._publisher, self.at = publisher, {}

    def __getattr__(self, name):
        return getattr(self._publisher, name)

    def publish(self, msg):
        self.at[int(msg.k)] = time.perf_counter()
        self._publisher.publish(msg)


class TimedPlant(PlantNode):
    """A plant node that knows how long each answer took."""

    def configure(self):
        super().configure()
        self._outputs = self.watch = Stopwatch(self._outputs)
        self.trips = {}

    def _on_inputs(self, msg):
        now, k = time.perf_counter(), int(msg.k) - max(int(self.plant.prior.s), 1)
        if k in self.watch.at:
            self.trips[k] = now - self.watch.at[k]
        super()._on_inputs(msg)


def measure(plant: str, steps: int, period: float, solver: str, monitor: bool, domain: int | None) -> dict[str, float]:
    """Round trips under control [ms]: median, 99 % quantile, largest; and the controller's own share."""
    given = load(Path(shipped(plant)))
    given["plant"] |= {"mode": "realtime", "steps": 0}
    given["plant"]["speed"] = TimedPlant.plant_of(given["plant"]).sample_time / period
    given["controller"] |= {"solver": solver, "readers_inputs": 0, "readers_state": 0}
    with threadpool_limits(limits=1), ros([], domain) as context:
        executor = make_executor("events", context)
        spinner = Spinner(executor)
        kinds = {"controller": ControllerNode, "operator": OperatorNode, "plant": TimedPlant}
        if monitor:
            kinds = {"monitor": MonitorNode} | kinds
        nodes = {}
        for role, kind in kinds.items():
            values = {name: value for name, value in given.get(role, {}).items() if name != "use_sim_time"}
            overrides = [
                Parameter(name, value=value) for name, value in values.items() if not name.startswith("readers")
            ]
            nodes[role] = kind(context=context, parameter_overrides=overrides, use_global_arguments=False)
            executor.add_node(nodes[role])
            nodes[role].start()
        agent, first = nodes["controller"], None
        trips = nodes["plant"].trips

        def done() -> bool:
            nonlocal first
            if first is None and agent._agent is not None and agent._agent.mode is Mode.CONTROLLING:
                first = max(trips, default=0) + 1
            return first is not None and len(trips) >= first + steps

        spinner.until(done)
        for node in nodes.values():
            node.quiesce()
        executor.shutdown()
        for node in nodes.values():
            node.stop()
            node.destroy_node()
    taken = 1e3 * np.array([seconds for k, seconds in trips.items() if k >= first])
    spread = {
        "median": np.median(taken),
        "p99": np.quantile(taken, 0.99),
        "largest": taken.max(),
        "samples": taken.size,
    }
    return spread | {"held": nodes["plant"].held_samples, "answer": agent._health.values()["answer"] * 1e3 * period}


def main() -> int:
    """Prints a line for each solver; 1 if a goal was missed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--plant", default="wscc9")
    parser.add_argument("--steps", type=int, default=1500, help="samples under control, each solver")
    parser.add_argument("--period", type=float, default=0.02, help="[s] of real time")
    parser.add_argument("--monitor", action="store_true", help="a monitor on the same executor")
    parser.add_argument("--domain", type=int, default=None, help="DDS domain")
    options = parser.parse_args()
    missed = False
    for solver in ("osqp", "daqp"):
        r = measure(options.plant, options.steps, options.period, solver, options.monitor, options.domain)
        good = r["median"] < MEDIAN and r["p99"] < P99
        missed |= not good
        verdict = "as wanted" if good else f"GOAL {MEDIAN}/{P99} ms MISSED"
        print(
            f"{options.plant} {solver}: round trip median {r['median']:.3f} ms, 99 % {r['p99']:.2f} ms, "
            f"largest {r['largest']:.1f} ms over {r['samples']} samples; controller alone, 95 % of the newest 100: "
            f"{r['answer']:.3f} ms; held {r['held']}; load {os.getloadavg()[0]:.1f}/{os.cpu_count()}: {verdict}"
        )
    return int(missed)


if __name__ == "__main__":
    raise SystemExit(main())
