# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Several zones side by side in one DDS domain, each with its own plant, controller and monitor: none hears another."""

import time

import numpy as np
import pytest

from ros2_deepc.control.modes import Mode
from ros2_deepc.nodes.config import merged, node_class, text_of
from ros2_deepc.nodes.observer import Observer
from ros2_deepc.ros.run import Spinner, make_executor, ros

DEADLINE = 60.0  # [s]
ROLES = ("monitor", "controller", "operator", "plant")
STEPS = 115
READERS = {
    "plant": {"readers": 3},
    "controller": {"readers_inputs": 2, "readers_state": 1},
    "monitor": {"readers": 1},
    "operator": {"readers": 1},
}


class Zone:
    """The nodes of a zone, and what its observer saw."""

    def __init__(self, context, executor, folder, name, parameters):
        file = folder / f"{name}.yaml"
        file.write_text(text_of(merged(parameters, READERS)))
        arguments = ["--ros-args", "--params-file", str(file), "-r", f"__ns:=/{name}"]
        self.nodes = {
            role: node_class(role)(context=context, cli_args=arguments, use_global_arguments=False) for role in ROLES
        }
        self.observer = Observer(context=context, namespace=f"/{name}", use_global_arguments=False)
        self.y, self.reports = {}, []
        self.observer.on_change = self._look
        for node in (self.observer, *self.nodes.values()):
            executor.add_node(node)

    def _look(self):
        if self.observer.outputs is not None:
            self.y[int(self.observer.outputs.k)] = list(self.observer.outputs.values)
        if self.observer.report is not None:
            self.reports.append(self.observer.report)

    @property
    def finished(self):
        state, period = self.observer.state, self.nodes["monitor"].p["period"]
        reported = self.reports and self.reports[-1].k >= STEPS // period * period - 1
        return state is not None and state.k == STEPS - 1 and len(self.y) == STEPS and reported


@pytest.fixture
def zones(domain_id, tmp_path):
    """Runs zones with parameters by name in one process until all are finished; returns them by name."""
    with ros([], domain_id) as context:
        executor = make_executor("events", context)
        made = {}

        def go(parameters):
            made.update({name: Zone(context, executor, tmp_path, name, each) for name, each in parameters.items()})
            for role in ROLES:
                for zone in made.values():
                    zone.nodes[role].start()
            end = time.monotonic() + DEADLINE
            Spinner(executor).until(lambda: all(z.finished for z in made.values()) or time.monotonic() > end)
            assert all(zone.finished for zone in made.values())
            return made

        yield go
        for zone in made.values():
            for node in zone.nodes.values():
                node.quiesce()
        executor.shutdown()
        for zone in made.values():
            for node in zone.nodes.values():
                node.stop()
                node.destroy_node()
            zone.observer.destroy_node()


def test_zones_side_by_side_run_as_if_alone(zones, parameters_of, pure_loop):
    parameters = {
        "north": parameters_of("wscc9", {"plant": {"seed": 3, "steps": STEPS}, "controller": {"seed": 3}}),
        "south": parameters_of("net3", {"plant": {"seed": 0, "steps": STEPS}, "controller": {"seed": 0}}),
    }
    ran = zones(parameters)
    for name, zone in ran.items():
        alone = pure_loop(parameters[name])
        np.testing.assert_array_equal([zone.y[k] for k in range(STEPS)], alone.y)
        assert [int(zone.observer.state.mode), zone.observer.state.refused] == [alone.decisions[-1].mode, 0]
        assert zone.observer.state.mode == Mode.CONTROLLING
        assert {report.epoch for report in zone.reports} == {zone.observer.info.epoch}
        assert all(node.refused == 0 for node in zone.nodes.values() if hasattr(node, "refused"))
