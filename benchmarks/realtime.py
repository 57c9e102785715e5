# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Ten minutes of control at 20 Hz: missed samples, jitter, round trip, as somebody outside sees them on the topics.

python benchmarks/realtime.py [--minutes 10] [--processes]

The zone runs as `ros2-deepc run` in a process of its own (or one a node); this process only listens and takes the time.
The figures are those of this machine with the load that it has: they are reported, not judged.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from deepc_msgs.msg import ControllerState, Sample
from rclpy.node import Node
from threadpoolctl import threadpool_limits

from plant_sim import wscc9
from ros2_deepc.control.modes import Mode
from ros2_deepc.nodes.config import load, merged, shipped, text_of
from ros2_deepc.ros import topics
from ros2_deepc.ros.qos import profile
from ros2_deepc.ros.run import Spinner, make_executor, ros

PERIOD = 0.05  # [s] of the wall clock
NAMESPACE = "/realtime"
SILENCE = 60.0  # [s] until the zone counts as stuck


class Tap(Node):
    """Takes the time of every message of the loop."""

    def __init__(self, **kwargs):
        super().__init__("tap", namespace=NAMESPACE, **kwargs)
        self.outputs, self.inputs, self.states = {}, {}, {}
        self.ages = {}
        for topic, keep in (
            (topics.OUTPUTS, self._on_outputs),
            (topics.INPUTS, self._on_inputs),
            (topics.STATE, self._on_state),
        ):
            self.create_subscription(topic.type, topic.name, keep, profile(topic))

    def _on_outputs(self, msg: Sample):
        self.outputs.setdefault(int(msg.k), time.perf_counter())
        self.ages[int(msg.k)] = int(msg.held)

    def _on_inputs(self, msg: Sample):
        self.inputs.setdefault(int(msg.k), time.perf_counter())

    def _on_state(self, msg: ControllerState):
        self.states[int(msg.k)] = (Mode(msg.mode), msg.solve_time + msg.prepare_time, msg.deadline_misses)


def zone(steps):
    """Parameters of the 9-bus grid at 20 Hz of the wall clock."""
    parameters = merged(load(shipped("wscc9")), {})
    parameters["plant"] |= {
        "mode": "realtime",
        "steps": steps,
        "speed": wall_speed(),
    }
    starts = list(range(0, steps, 400))
    values = [v for i in range(len(starts)) for v in (0.3 * (-1.0) ** i, 0.0)]
    parameters["operator"] |= {"reference_k": starts[:100], "reference_values": values[:200]}
    for role in parameters.values():
        role.pop("use_sim_time", None)
    return parameters


def wall_speed():
    """How much faster than its own time the grid has to run."""
    return wscc9().sample_time / PERIOD


def listen(steps, command):
    """Runs the zone to its end and returns the tap."""
    with ros([]) as context:
        tap = Tap(context=context, use_global_arguments=False)
        executor = make_executor("events", context)
        executor.add_node(tap)
        child = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        newest = time.monotonic(), 0

        def over():
            nonlocal newest
            if len(tap.outputs) > newest[1]:
                newest = time.monotonic(), len(tap.outputs)
            return child.poll() is not None or time.monotonic() - newest[0] > SILENCE

        Spinner(executor).until(over)
        child.terminate()
        code = child.wait()
        executor.shutdown()
        tap.destroy_node()
    if code:
        raise SystemExit(f"the zone ended with code {code} after {len(tap.outputs)} of {steps} samples")
    return tap


def milliseconds(name, values):
    """One row of the table."""
    shares = np.percentile(values, (50, 99, 99.9, 100)) * 1e3
    print(f"{name:34}" + "".join(f" {share:9.3f}" for share in shares))


def report(tap, steps):
    """Prints what was seen."""
    ks = sorted(tap.outputs)
    times = np.array([tap.outputs[k] for k in ks])
    late = sum(tap.ages[k] > 0 for k in ks)
    trips = [tap.inputs[k + 1] - tap.outputs[k] for k in ks if k + 1 in tap.inputs]
    modes = [mode for mode, _, _ in tap.states.values()]
    steps_between = np.diff(times) / np.diff(ks)
    skipped = int(np.sum(np.maximum(np.round(steps_between / PERIOD) - 1, 0)))
    print(f"samples: {len(ks)} of {steps} seen, {late} with inputs that came too late (held)")
    print("modes: " + ", ".join(f"{mode.name} {modes.count(mode)}" for mode in sorted(set(modes))))
    print(f"deadline misses told by the controller: {max(misses for _, _, misses in tap.states.values())}")
    print(f"ticks that the plant's clock skipped: {skipped}; mean period {np.mean(steps_between) * 1e3:.4f} ms")
    print(f"{'[ms]':34} {'median':>9} {'99 %':>9} {'99.9 %':>9} {'most':>9}")
    milliseconds("time between outputs, off 50 ms", np.abs(steps_between - PERIOD))
    milliseconds("outputs k to inputs k+1", np.maximum(trips, 0.0))
    milliseconds("controller's own work a sample", [work for _, work, _ in tap.states.values()])


def main():
    """Runs and reports."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--processes", action="store_true", help="one process a node")
    args = parser.parse_args()
    steps = round(args.minutes * 60 / PERIOD)
    print(
        f"9-bus grid at {1 / PERIOD:.0f} Hz for {args.minutes:g} min, load before {os.getloadavg()[0]:.1f}", flush=True
    )
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "zone.yaml"
        file.write_text(text_of(zone(steps)), encoding="utf-8")
        command = [str(Path(sys.executable).parent / "ros2-deepc"), "run", str(file), "--namespace", NAMESPACE]
        tap = listen(steps, command + ["--processes"] * args.processes)
    print(f"load after {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")
    report(tap, steps)


if __name__ == "__main__":
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with threadpool_limits(limits=1):
        main()
