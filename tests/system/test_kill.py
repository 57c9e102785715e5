# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""kill -9 of each node in turn while the plant is controlled, one process a node, restarted by hand."""

import importlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from deepc_msgs.msg import Sample

from ros2_deepc.bags import replay
from ros2_deepc.bags.reader import BagReader
from ros2_deepc.control.modes import Mode
from ros2_deepc.nodes.config import load, merged, shipped, text_of
from ros2_deepc.nodes.observer import Observer
from ros2_deepc.nodes.replaying import cores
from ros2_deepc.ros.convert import nanoseconds, period_ns
from ros2_deepc.ros.run import Spinner, make_executor, ros

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
BIN = Path(sys.executable).parent
NAMESPACE = "/kill"
DEADLINE = 60.0  # [s]
SAFE = 0.05  # the plant's own
STOPPED = 0.0625  # the controller's
HOLD = 5  # samples that the plant holds the last inputs for
STEADY = 15  # samples in control, one after the other
SETTLED = 1500  # samples in lockstep after which what DDS had to send again has come, on every topic
ROLES = ("recorder", "monitor", "controller", "operator", "plant")


class Zone:
    """One process a node, and an observer in this one."""

    def __init__(self, context, folder, domain_id, truth, mode):
        self.folder, self._env = folder, dict(os.environ, ROS_DOMAIN_ID=str(domain_id))
        parameters = merged(
            load(shipped("wscc9")),
            {
                "plant": {"mode": mode, "speed": 5.0, "steps": 0, "hold": HOLD, "safe": [SAFE]},
                "controller": {
                    "max_gap": 1000,
                    "max_hold": 100_000,
                    "u_safe": [STOPPED],
                },  # a busy machine must not end in the fallback
                "operator": {"reference_k": [0], "reference_values": [0.3, 0.0]},
            },
        )
        if mode == "realtime":
            for values in parameters.values():
                values.pop("use_sim_time", None)
        else:  # nobody may miss the first samples: controller, monitor, recorder and the observer hear all of them
            readers = {"readers_inputs": 3, "readers_state": 2}
            parameters = merged(parameters, {"plant": {"readers": 4}, "controller": readers, "monitor": {"readers": 2}})
        (folder / "zone.yaml").write_text(text_of(parameters))
        self.children, self._logs, self.bags = {}, [], 0
        self.observer = Observer(context=context, namespace=NAMESPACE, use_global_arguments=False)
        self.executor = make_executor("events", context)
        self.executor.add_node(self.observer)
        self._spinner = Spinner(self.executor)
        self.truth = truth(self.observer)
        self.outputs, self.states = [], []
        self.observer.on_change = self._look

    def _look(self):
        seen = self.observer
        if seen.outputs is not None and (not self.outputs or self.outputs[-1] is not seen.outputs):
            self.outputs.append(seen.outputs)
        if seen.state is not None and (not self.states or self.states[-1] is not seen.state):
            self.states.append(seen.state)
        self.truth.look()
        self._spinner.wake()

    def start(self, role):
        extra = ["-p", f"folder:={self.folder / f'bag{self.bags}'}"] if role == "recorder" else []
        self.bags += role == "recorder"
        command = [BIN / f"ros2-deepc-{role}", "--ros-args", "--params-file", self.folder / "zone.yaml"]
        log = (self.folder / f"{role}{len(self._logs)}.log").open("w+")
        self._logs.append(log)
        self.children[role] = subprocess.Popen(
            [*map(str, command), "-r", f"__ns:={NAMESPACE}", *extra], env=self._env, stdout=log, stderr=log
        )

    def kill(self, role):
        self.children[role].kill()
        assert self.children[role].wait(DEADLINE) == -signal.SIGKILL

    def until(self, condition):
        end = time.monotonic() + DEADLINE
        self._spinner.until(lambda: condition() or time.monotonic() > end)
        assert condition(), self.said()

    def said(self):
        """What the observer and the processes last said."""
        state = self.states[-1] if self.states else None
        words = [] if state is None else [f"{Mode(state.mode).name} at {state.k}: {state.reason}"]
        for log in self._logs:
            log.flush()
            words.append(f"{Path(log.name).name}: " + " | ".join(Path(log.name).read_text().splitlines()[-3:]))
        return "\n".join(words)

    def forget(self):
        self.outputs, self.states = [], []

    def controlled(self):
        """In control for a while with predictions that are exactly the plant's; nothing false can be in the window."""
        newest = self.states[-STEADY:]
        if len(newest) < STEADY or any(state.mode != Mode.CONTROLLING for state in newest):
            return False
        error = self.truth.error()
        if error is None:
            return False
        assert error < 1e-8
        assert newest[-1].rank == newest[-1].rank_need
        return True

    def went_on(self):
        """Whether the controller kept its data; it may have waited for outputs on a busy machine."""
        return {state.mode for state in self.states} <= {Mode.CONTROLLING, Mode.HOLDING}

    def end(self, role):
        self.children[role].terminate()
        assert self.children[role].wait(DEADLINE) == 0

    def stop(self):
        for child in self.children.values():
            child.terminate()
        return {role: child.wait(DEADLINE) for role, child in self.children.items()}

    def close(self):
        for child in self.children.values():
            child.kill()
            child.wait()
        for log in self._logs:
            log.close()
        self.executor.shutdown()
        self.observer.destroy_node()


@pytest.fixture
def zone(request, domain_id, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    with ros([], domain_id) as context:
        made = Zone(context, tmp_path, domain_id, importlib.import_module("soak").Truth, request.param)
        yield made
        made.close()


@pytest.mark.timeout(400)
@pytest.mark.parametrize("zone", ["realtime"], indirect=True)
def test_each_node_may_be_killed_and_started_again(zone):
    for role in ROLES:
        zone.start(role)
    zone.until(zone.controlled)

    _controller(zone)
    _frozen(zone)
    _monitor(zone)
    _recorder(zone)
    _plant(zone)
    assert zone.stop() == dict.fromkeys(ROLES, 0)
    assert BagReader(zone.folder / "bag1").complete


def _controller(zone):
    """The plant holds, then goes to its safe input; the new controller learns the plant anew."""
    zone.forget()
    zone.kill("controller")
    zone.until(lambda: zone.outputs and zone.outputs[-1].held == Sample.OWN_INPUT)
    ages = [msg.held for msg in zone.outputs]
    assert ages[-HOLD - 1 :] == [*range(1, HOLD + 1), Sample.OWN_INPUT]
    zone.start("controller")
    zone.until(lambda: zone.states and zone.states[-1].mode == Mode.COLLECTING)
    zone.until(zone.controlled)


def _frozen(zone):
    """A process that is stopped for a while and goes on: no new run, nothing false."""
    zone.forget()
    zone.children["controller"].send_signal(signal.SIGSTOP)
    zone.until(lambda: zone.outputs and zone.outputs[-1].held == Sample.OWN_INPUT)
    zone.children["controller"].send_signal(signal.SIGCONT)
    zone.until(lambda: zone.outputs[-1].held == 0)
    zone.until(zone.controlled)
    zone.children["plant"].send_signal(signal.SIGSTOP)
    zone.until(lambda: zone.states[-1].mode == Mode.HOLDING)
    zone.children["plant"].send_signal(signal.SIGCONT)
    zone.until(zone.controlled)
    assert zone.went_on()
    assert len({msg.epoch for msg in zone.outputs}) == 1


def _monitor(zone):
    """Nobody else notices; the new one reports."""
    zone.forget()
    zone.kill("monitor")
    zone.observer.report = None
    zone.until(lambda: len(zone.states) > STEADY)
    zone.start("monitor")
    zone.until(lambda: zone.observer.report is not None and zone.observer.report.k > zone.states[STEADY].k)
    assert zone.observer.report.epoch == zone.observer.info.epoch
    assert zone.went_on()
    zone.until(zone.controlled)


def _recorder(zone):
    """Nobody else notices; the bag is readable up to the last flush, and the new one writes another bag."""
    zone.forget()
    first = zone.outputs[-1].k if zone.outputs else 0
    zone.until(lambda: len(zone.states) > 2 * STEADY)
    zone.kill("recorder")
    bag = BagReader(zone.folder / "bag0")
    assert not bag.complete
    found = [int(msg.k) for _, msg in bag.decoded([f"{NAMESPACE}/outputs"])]
    assert found == list(range(found[0], found[-1] + 1))
    assert found[-1] >= first
    zone.start("recorder")
    zone.until(lambda: (zone.folder / "bag1").exists())
    zone.until(lambda: len(zone.states) > 4 * STEADY)
    assert zone.went_on()
    zone.until(zone.controlled)


def _plant(zone):
    """A new plant is a new run for all."""
    epoch = zone.observer.info.epoch
    zone.kill("plant")
    zone.until(lambda: zone.states[-1].mode != Mode.CONTROLLING)
    zone.forget()
    zone.start("plant")
    zone.until(lambda: zone.observer.info.epoch != epoch and zone.outputs and zone.states)
    zone.until(lambda: any(state.mode == Mode.COLLECTING for state in zone.states))
    zone.until(zone.controlled)


@pytest.mark.parametrize("zone", ["realtime"], indirect=True)
def test_a_controller_that_is_told_to_stop_while_it_holds_leaves_the_safe_input(zone):
    for role in ("recorder", "controller", "operator", "plant"):
        zone.start(role)
    zone.until(zone.controlled)
    zone.children["plant"].send_signal(signal.SIGSTOP)
    zone.until(lambda: zone.states[-1].mode == Mode.HOLDING)
    zone.end("controller")
    zone.children["plant"].send_signal(signal.SIGCONT)
    zone.end("recorder")
    bag = BagReader(zone.folder / "bag0")
    assert bag.complete
    *_, (_, last) = bag.decoded([f"{NAMESPACE}/inputs"])
    assert list(last.values) == [STOPPED] * 3


@pytest.mark.timeout(400)
@pytest.mark.parametrize("zone", ["lockstep"], indirect=True)
def test_in_lockstep_the_run_goes_on_with_a_new_controller_or_a_new_plant(zone):
    for role in ROLES:
        zone.start(role)
    zone.until(zone.controlled)
    zone.until(lambda: zone.states[-1].k > SETTLED)

    zone.kill("controller")  # the plant waits
    zone.forget()
    zone.start("controller")  # as soon as the claim of the first one has run out, the plant begins a new epoch
    zone.until(lambda: zone.observer.info.epoch == 2 and zone.outputs and zone.outputs[-1].epoch == 2)
    start = nanoseconds(zone.observer.info.header.stamp)
    assert start > nanoseconds(zone.outputs[0].header.stamp) - period_ns(zone.observer.info.sample_time)
    zone.until(zone.controlled)

    zone.until(lambda: zone.observer.report is not None and zone.observer.report.epoch == 2)
    zone.end("recorder")
    _holds_two_epochs(zone.folder)

    zone.kill("plant")
    zone.observer.info = None
    zone.forget()
    zone.start("recorder")
    zone.start("plant")  # a new run, whose time begins again, too
    zone.until(lambda: zone.observer.info is not None and zone.outputs and zone.states)
    assert zone.observer.info.epoch == 1
    zone.until(lambda: any(state.mode == Mode.COLLECTING for state in zone.states))
    zone.until(zone.controlled)
    assert zone.stop() == dict.fromkeys(ROLES, 0)
    assert BagReader(zone.folder / "bag1").complete


def _holds_two_epochs(folder):
    """Both whole from their first sample on, and what the controllers did comes out of them again."""
    bag = BagReader(folder / "bag0")
    assert bag.complete
    samples = [(int(msg.epoch), int(msg.k)) for _, msg in bag.decoded([f"{NAMESPACE}/outputs"])]
    begin = samples.index((2, 0))
    assert samples == [*((1, k) for k in range(begin)), *((2, k) for k in range(len(samples) - begin))]
    again = replay(folder / "bag0", {"controller": cores(load(folder / "zone.yaml"))["controller"]})
    assert again.same, (again.differences, again.unmatched)
