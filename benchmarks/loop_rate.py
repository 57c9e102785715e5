# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Samples a second of the closed loop over DDS in lockstep, in one process, beside the same loop without ROS.

python benchmarks/loop_rate.py [--steps 1000]

Wall time of a whole run from the first to the last sample; the plain loop shows what the numerics alone cost.
"""

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from ros2_deepc.control.loop import run_loop
from ros2_deepc.nodes.config import load, merged, node_class, shipped, text_of
from ros2_deepc.nodes.controller_node import make_agent
from ros2_deepc.nodes.stack import running

ZONE = ("monitor", "controller", "operator", "plant")
ROUNDS = 3  # whatever else runs on the machine only ever takes time
GOAL = 300.0  # samples a second, events executor, recorder on


def over_dds(parameters: dict, folder: Path, executor: str, record: bool) -> float:
    """Samples a second of one run."""
    readers = 3 + record  # of outputs: controller, monitor, observer, recorder
    changes = {
        "plant": {"readers": readers},
        "controller": {"readers_inputs": 2 + record, "readers_state": 1 + record},
        "monitor": {"readers": 1 + record},
        "operator": {"readers": 1 + record},
    }
    parameters = merged(parameters, changes)
    if record:
        parameters = merged(parameters, {"recorder": {"folder": str(folder / "bag")}})
    (folder / "parameters.yaml").write_text(text_of(parameters), encoding="utf-8")
    steps = parameters["plant"]["steps"]
    roles = (("recorder",) if record else ()) + ZONE
    with running(roles, folder / "parameters.yaml", namespace="/bench", executor=executor) as stack:
        seen = stack.observer
        seen.on_change = stack.spinner.wake
        stack.spinner.until(lambda: seen.state is not None)
        begin, first = time.perf_counter(), int(seen.state.k)
        seen.on_change = lambda: stack.spinner.wake() if seen.state.k >= steps - 1 else None
        stack.spinner.until(lambda: seen.state.k >= steps - 1)
        seconds = time.perf_counter() - begin
    return (steps - 1 - first) / seconds


def without_ros(parameters: dict) -> float:
    """Samples a second of the plain loop."""
    plant_node = node_class("plant")
    agent = make_agent(parameters["controller"], plant_node.info(parameters["plant"]))
    values = np.reshape(parameters["operator"]["reference_values"], (-1, 2))
    for k, reference in zip(parameters["operator"]["reference_k"], values, strict=True):
        agent.references.set(k, reference)
    plant = plant_node.plant_of(parameters["plant"]).start(0)
    begin = time.perf_counter()
    run_loop(agent, plant, parameters["plant"]["steps"])
    return parameters["plant"]["steps"] / (time.perf_counter() - begin)


def round_of(parameters: dict) -> list[float]:
    """Samples a second: without ROS, then with the events and the classic executor, without and with the recorder."""
    rates = [without_ros(parameters)]
    for executor in ("events", "single"):
        for record in (False, True):
            with tempfile.TemporaryDirectory() as folder:
                rates.append(over_dds(parameters, Path(folder), executor, record))
    return rates


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=1000)
    steps = parser.parse_args().steps
    print(f"closed loop in lockstep, one process, {steps} samples: samples a second, best of {ROUNDS} rounds")
    print(f"{'plant':8} {'no ROS':>8} {'events':>8} {'+ bag':>8} {'single':>8} {'+ bag':>8}")
    for plant in ("wscc9", "net3"):
        parameters = merged(load(shipped(plant)), {"plant": {"steps": steps}})
        rates = np.max([round_of(parameters) for _ in range(ROUNDS)], axis=0)
        print(f"{plant:8}" + "".join(f" {rate:8.0f}" for rate in rates))
        print(f"         goal {GOAL:.0f} with events and bag: {'reached' if rates[2] >= GOAL else 'MISSED'}")


if __name__ == "__main__":
    with threadpool_limits(limits=1):
        main()
