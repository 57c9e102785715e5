# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Whatever a seeded relay does to the messages between a plant and its controller: nothing false is learned."""

import os
import time

import numpy as np
import pytest
import yaml
from deepc_msgs.msg import ControllerState, Sample
from deepc_msgs.srv import SetMode
from rclpy.node import Node
from rclpy.parameter import Parameter

from plant_sim.plant_node import PlantNode
from ros2_deepc.behavior import Record
from ros2_deepc.control.loop import run_loop
from ros2_deepc.control.modes import Mode
from ros2_deepc.nodes.controller_node import ControllerNode, make_agent
from ros2_deepc.nodes.monitor_node import MonitorNode
from ros2_deepc.ros import topics
from ros2_deepc.ros.convert import sample
from ros2_deepc.ros.qos import profile
from ros2_deepc.ros.run import Spinner, make_executor, ros

from .relay import EXTRA, MOVED, SPOILED, Link, Relay, Schedule, remapped, verdict_of

DEADLINE = 60.0  # [s]
TS = 0.1  # [s], the plant's own
SPEED = 20.0 / max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1))  # faults are the schedule's, not a busy machine's
AFTER = 15  # samples in control, one after the other, that end a run
REFERENCE = 0.5
SETTINGS = {"N": 2, "L": 6, "Q": [1.0], "R": [0.1], "terminal": "none", "max_gap": 3, "max_hold": 50}
PLANTS = {  # order 2; outputs k depend on inputs up to k, or up to k+1
    "index1": {"A": [[0.9, 0.2], [-0.1, 0.8]], "B": [[0.0], [1.0]], "C": [[1.0, 0.0]], "initial": [1.0, -1.0]},
    "index2": {
        "E": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1], [0, 0, 0, 0]],
        "A": [[0.9, 0.2, 0, 0], [-0.1, 0.8, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]],
        "B": [[0.0], [1.0], [0.3], [0.2]],
        "C": [[1.0, 0.0, 1.0, 0.0]],
        "initial": [1.0, -1.0, 0.0, 0.0],
    },
}


class TruePlant(PlantNode):
    """The plant node, with a log of what it really did: inputs u[k] and outputs y[k], and how old the inputs were."""

    def activate(self):
        super().activate()
        self.u, self.y, self.ages = [], [], []
        stepper, push = self._stepper, self._stepper.push

        def logged(u):
            y = push(u)
            self.u.append(np.array(u))
            self.ages.append(self._held)
            if y is not None:
                self.y.append(np.array(y))
            return y

        stepper.push = logged


class Desk(Node):
    """Gives the reference, reads the controller's state, asks for modes."""

    def __init__(self, **kwargs):
        super().__init__("desk", **kwargs)
        self.states, self.on_state = [], lambda: None
        self.reference = self.create_publisher(Sample, "reference", profile(topics.REFERENCE))
        self.reference.publish(sample("plant", 1, 0, np.array([REFERENCE]), 1))
        self.create_subscription(ControllerState, "controller/state", self._on_state, profile(topics.STATE))
        self._modes = self.create_client(SetMode, "controller/set_mode")

    def _on_state(self, msg):
        self.states.append(msg)
        self.on_state()

    def ask(self, mode):
        return self._modes.call_async(SetMode.Request(mode=int(mode)))


class Zone:
    """Plant, controller, relay and desk in one process."""

    def __init__(self, context, folder, plant, links, *, lockstep, steps=0, **controller):
        file = folder / f"{plant}.yaml"
        file.write_text(yaml.safe_dump(PLANTS[plant] | {"sample_time": TS}))
        mode = {"mode": "lockstep", "readers": 1} if lockstep else {"mode": "realtime", "speed": SPEED, "hold": 4}
        controller = SETTINGS | controller | ({"readers_inputs": 1} if lockstep else {})
        self.settings = controller
        self.plant = _node(TruePlant, context, {"plant": str(file), "steps": steps, **mode}, topics.OUTPUTS)
        self.controller = _node(ControllerNode, context, controller, topics.INPUTS)
        self.monitor = _node(MonitorNode, context, {"window": 60, "period": 1000, "indicator": False}, topics.REPORT)
        self.relay = Relay(
            links, lockstep=lockstep, sample_time=TS / SPEED, context=context, use_global_arguments=False
        )
        self.desk = Desk(context=context, use_global_arguments=False)
        self.executor = make_executor("events", context)
        self._spinner = Spinner(self.executor)
        self.nodes = (self.relay, self.desk, self.monitor, self.controller, self.plant)
        for node in self.nodes:
            self.executor.add_node(node)
        self.desk.on_state = self._spinner.wake
        for node in (self.monitor, self.controller, self.plant):
            node.start()

    def until(self, condition):
        end = time.monotonic() + DEADLINE
        self._spinner.until(lambda: condition() or self.fault or time.monotonic() > end)
        assert not self.fault, self.fault
        assert condition(), f"{self.mode}: {self.desk.states[-1].reason if self.desk.states else 'no state'}"

    @property
    def fault(self):
        return self.plant.fault or self.controller.fault or self.monitor.fault

    @property
    def mode(self):
        return Mode(self.desk.states[-1].mode) if self.desk.states else Mode.IDLE

    @property
    def agent(self):
        return self.controller._agent

    def recovered(self):
        """Whether the controller has been in control for a while; a latched fallback is acknowledged first."""
        if self.mode is Mode.FALLBACK and (self._asked is None or self._asked.done()):
            self._asked = self.desk.ask(Mode.CONTROLLING)
        newest = self.desk.states[-AFTER:]
        return len(newest) == AFTER and all(state.mode == Mode.CONTROLLING for state in newest)

    _asked = None

    def stop(self):
        for node in (self.monitor, self.controller, self.plant):
            node.quiesce()
        self.executor.shutdown()
        for node in self.nodes:
            if hasattr(node, "stop"):
                node.stop()
            node.destroy_node()


def _node(kind, context, parameters, topic):
    overrides = [Parameter(name, value=value) for name, value in parameters.items()]
    return kind(context=context, parameter_overrides=overrides, cli_args=remapped(topic), use_global_arguments=False)


@pytest.fixture
def zone(domain_id, tmp_path):
    with ros([], domain_id) as context:
        made = []

        def make(*args, **kwargs):
            made.append(Zone(context, tmp_path, *args, **kwargs))
            return made[-1]

        yield make
        for each in made:
            each.stop()


def assert_true(records, plant):
    """Every record must be a stretch of what the plant did, to the bit."""
    y, u = np.array(plant.y), np.array(plant.u)
    for record in records:
        n = len(record.y)
        places = [k for k in range(len(y) - n + 1) if np.array_equal(y[k : k + n], record.y)]
        assert places, "outputs in the window that the plant never gave"
        assert any(np.array_equal(u[k : k + len(record.u)], record.u) for k in places), "inputs that did not act"


def assert_window_is_true(zone):
    """The data, the past that predictions start from, the monitor's; and the rank: a false sample would raise it."""
    controller = zone.agent.controller
    data = controller._data
    assert_true(data._window.records(), zone.plant)
    assert_true(data.snapshot.records, zone.plant)
    assert_true(controller._recent.records(), zone.plant)
    assert_true([Record(u, y) for u, y in zone.monitor._live.records()], zone.plant)
    if controller.settings.data_policy == "fixed":
        assert controller.rank == controller.rank_need
        assert controller.gap > 1e6
    else:  # in the steady state a moving window may show less, never more
        assert controller.rank <= controller.rank_need


def assert_commands_are_within_limits(*links_and_logs):
    for values in links_and_logs:
        values = np.array(values)
        assert values.size
        assert np.isfinite(values).all()
        assert (np.abs(values) <= 1.0).all()


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("plant", PLANTS)
def test_lockstep_is_the_same_to_the_bit_whatever_comes_beside_the_samples(zone, plant, seed, tmp_path):
    links = {
        topic: Link(Schedule(10 * seed + i, 0.3, kinds=EXTRA, begin=0, end=60), beside=True)
        for i, topic in enumerate((topics.OUTPUTS, topics.INPUTS))
    }
    steps = 80
    run = zone(plant, links, lockstep=True, steps=steps)
    run.until(lambda: run.plant.finished and run.desk.states and run.desk.states[-1].k == len(run.plant.y) - 1)

    node = run.plant
    agent = make_agent(run.settings, node.info({"plant": str(tmp_path / f"{plant}.yaml")}))
    agent.references.set(0, [REFERENCE])
    pure = run_loop(agent, node.plant.start(0), len(node.y))
    np.testing.assert_array_equal(node.u, pure.u)
    np.testing.assert_array_equal(node.y, pure.y)

    outputs, inputs = links[topics.OUTPUTS], links[topics.INPUTS]
    run.until(lambda: node.refused == verdict_of(inputs.sent)[1])
    assert run.controller.refused == verdict_of(outputs.sent)[1]
    run.until(lambda: run.monitor.refused == run.controller.refused + inputs.spoiled)
    assert sum(outputs.faults.values()) > 10
    assert sum(inputs.faults.values()) > 10
    assert run.agent.lost == 0
    assert_window_is_true(run)


@pytest.mark.parametrize(
    ("wounded", "seed"),
    [("outputs", 0), ("outputs", 1), ("inputs", 0), ("inputs", 1), *(("both", n) for n in range(4))],
)
@pytest.mark.parametrize("plant", PLANTS)
def test_real_time_learns_nothing_false_and_comes_back(zone, plant, wounded, seed):
    rng = np.random.Generator(np.random.PCG64([seed, 12]))
    rate = float(rng.choice([0.03, 0.1, 0.3]))
    policy = [{"data_policy": "fixed"}, {"data_policy": "sliding", "dither": [0.2]}][seed % 2]
    links = {
        topic: Link(Schedule(10 * seed + i, rate if wounded in (topic.name, "both") else 0.0, SPOILED + MOVED))
        for i, topic in enumerate((topics.OUTPUTS, topics.INPUTS))
    }
    run = zone(plant, links, lockstep=False, **policy)
    outputs, inputs = links[topics.OUTPUTS], links[topics.INPUTS]
    checked = set()

    def sound():
        """At every sample the past that predictions start from is true."""
        newest = len(run.desk.states)
        if newest not in checked and run.agent is not None:
            checked.add(newest)
            assert_true(run.agent.controller._recent.records(), run.plant)
        return all(len(link.seen) > link.schedule.end for link in links.values()) and run.recovered()

    run.until(sound)
    assert_window_is_true(run)
    assert_commands_are_within_limits([msg.values for msg in inputs.seen], run.plant.u)
    if wounded != "inputs":
        assert sum(outputs.faults.values()) > 0
    if wounded != "outputs":
        assert sum(inputs.faults.values()) > 0
    outputs.closed = True  # what is on its way arrives
    run.until(lambda: run.controller.refused == verdict_of(outputs.sent)[1])
    run.until(lambda: accounted(run, inputs))
    assert run.agent.lost == lost(run, outputs)


def accounted(run, inputs):
    """Every message to the plant has been used, refused, or waits for its tick."""
    used = sum(age == 0 for age in run.plant.ages)
    return len(inputs.sent) == used + run.plant.refused + len(run.plant._pending)


def lost(run, outputs):
    """Samples that never came, and those of which nobody told the controller all inputs.

    Outputs k tell which input acted at k+s-1, unless it was the plant's own; outputs 0 on time tell the earlier ones.
    """
    s, ages = run.agent.settings.s, run.plant.ages
    accepted = verdict_of(outputs.sent)[0]
    told = set(range(s - 1)) | {k + s - 1 for k in accepted if ages[k + s - 1] != Sample.OWN_INPUT}
    unknown = sum(not told.issuperset(range(k, k + s)) for k in accepted)
    return accepted[-1] + 1 - len(accepted) + unknown


@pytest.mark.parametrize("plant", PLANTS)
def test_first_inputs_that_nobody_heard_are_sent_again(zone, plant):
    """A plant that listens a moment too late would wait for ever, and the controller for it."""
    inputs = Link(Schedule(0, 1.0, kinds=("drop",), begin=0, end=2))
    run = zone(plant, {topics.OUTPUTS: Link(Schedule(0, 0.0)), topics.INPUTS: inputs}, lockstep=False)
    run.until(run.recovered)
    assert inputs.faults["drop"] == 2
    assert_window_is_true(run)
