# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The controller: collects, then controls; publishes inputs and its state."""

import json
import math
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from deepc_msgs.msg import Change, MonitorReport, PlantInfo, Sample, Verdict
from deepc_msgs.srv import SetMode
from rclpy.clock import Clock, ClockType
from std_srvs.srv import Trigger

from ..control.agent import Agent, Decision
from ..control.joined import Joined
from ..control.modes import Mode
from ..ros import topics
from ..ros.claim import LEASE, Claimants, Holder
from ..ros.convert import nanoseconds, period_ns, refusal
from ..ros.deferred import AT_ONCE, Deferred
from ..ros.diagnostics import OK, Diagnostics
from ..ros.health import Health
from ..ros.lifecycle import ManagedNode
from ..ros.live import LiveParameters
from ..ros.parameters import ConfigError
from ..ros.publisher import PatientPublisher
from ..ros.run import run_node
from ..ros.wire import Reading, pack
from . import changes
from .controller_settings import PARAMETERS, make_agent, settings_for
from .controller_state import facts, judgement, state_message

__all__ = ["PARAMETERS", "ControllerNode", "make_agent", "settings_for", "state_message"]

_FASTEST = 1e-3  # [s]; no clock watches a loop that is faster
_TWINS = 3  # outputs that came again with other values
_AGAIN = 1.0  # [s] without outputs after which the first inputs are sent once more


class ControllerNode(ManagedNode):
    """Answers outputs k with inputs k+s, then publishes its state.

    It learns sizes, limits, prior and sample time from plant_info; every plant_info starts a new run. It claims the
    plant while it is active, and refuses to work beside another controller. Services: ``controller/set_mode`` asks for
    a mode, ``controller/reset`` starts over with an empty window.
    """

    parameters = PARAMETERS

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("controller", **kwargs)
        self.refused = 0
        self.deadline_misses = 0
        self.jumps = 0
        """Outputs whose stamps do not fit their numbers; no column of the data spans them."""

    @classmethod
    def check(cls, parameters: Mapping[str, Any], info: PlantInfo) -> None:
        """Whether the settings can work for the plant."""
        make_agent(parameters, info)

    def configure(self) -> None:
        """Makes the topics and services that do not depend on the plant."""
        self._agent: Agent | None = None
        self._unfinished: tuple[Reading, Decision, float] | None = None  # with the time that the answer took
        self._waits = False  # for another controller to go
        self._inputs: PatientPublisher | None = None
        self._state: PatientPublisher | None = None
        self._early: dict[int, Sample] = {}
        self._after = Deferred(self, AT_ONCE)
        self._diagnostics = Diagnostics(self, "")
        self.resources.callback(self._diagnostics.destroy)
        for kind, name, answer in (
            (SetMode, "controller/set_mode", self._on_set_mode),
            (Trigger, "controller/reset", self._on_reset),
        ):
            self.resources.callback(self.destroy_service, self.create_service(kind, name, answer))
        self._changed = LiveParameters(self, self._check_changes)
        self._record = self.advertise(topics.CHANGES)
        heed = self.guarded(lambda _: self._heed_claims())
        self._claimants = Claimants(self, lambda: heed(None))
        self.resources.callback(self._claimants.destroy)
        self._holder = Holder(self, self._commands, beside=lambda: heed(None))
        self.resources.callback(self._holder.destroy)
        self.subscribe(topics.PLANT_INFO, self._on_plant)
        self.subscribe(topics.REFERENCE, self._on_reference)
        if self.p["heed_monitor"]:
            self.subscribe(topics.REPORT, self._on_report)

    def activate(self) -> None:
        """Claims the plant."""
        self._agent, self._follows, self._waits = None, 0, False
        self._since = time.monotonic()
        self._holder.take()

    def deactivate(self) -> None:
        """Leaves a last input behind in real time, and gives the plant up."""
        self._finish()
        if self._agent is not None and not self._info.lockstep and not self._waits and not self._other():
            last = self._agent.leave(self.p["stop"])
            if last is not None:
                self._enter(changes.LEAVE, self.p["stop"])
                self._send(*last)
                if self._inputs is not None and not self._inputs.delivered():
                    self.get_logger().warning("nobody may have taken the last input")
        self._holder.release()

    # The plant and who commands it

    def _on_plant(self, info: PlantInfo) -> None:
        """A plant or a new epoch of it: a fresh run. Its first inputs go out once a reference is known."""
        self._finish()
        agent = make_agent(self.p, info)
        self._agent, self._info, self._started = agent, info, False
        self._lurks = bool(self.p["standby"] and self.p["shadow"])  # learns beside the one it waits for
        self._k = self._decided = -1  # newest outputs accepted, and answered
        self._newest, self._twins = (), 0
        self._joined: Joined[Reading] = Joined(agent.disturbances, agent.settings.disturbances > 0)
        self._t0, self._period = nanoseconds(info.header.stamp), period_ns(info.sample_time)
        self._wall = 0.0 if info.lockstep else info.sample_time / (info.speed or 1.0)
        self._health = Health(self._wall)
        self._arrived, self._quiet, self._overdue, self._stamp = math.nan, 0, 0, 0
        if self._inputs is None:
            self._connect(info)
        self._early = {k: msg for k, msg in self._early.items() if self._set_reference(k, msg)}
        self._heed_claims()
        self._begin()

    def _connect(self, info: PlantInfo) -> None:
        lockstep = bool(info.lockstep)
        readers = (self.p["readers_inputs"], self.p["readers_state"]) if lockstep else (0, 0)
        self._inputs = self.advertise(topics.INPUTS, lockstep=lockstep, sample_time=self._wall, readers=readers[0])
        self._state = self.advertise(topics.STATE, lockstep=lockstep, readers=readers[1])
        self.subscribe(topics.OUTPUTS, self._on_outputs, lockstep=lockstep)
        if info.disturbance_names:
            self.subscribe(topics.DISTURBANCES, self._on_disturbances, lockstep=lockstep)
        if self.p["shadow"]:
            self.subscribe(topics.INPUTS, self._on_inputs, lockstep=lockstep)
        # A requested deadline would shut out every plant that does not offer one, so a timer looks instead.
        if not lockstep and self._wall >= _FASTEST:
            look = self.guarded(lambda _: self._look())
            steady = Clock(clock_type=ClockType.STEADY_TIME)
            self.resources.callback(self.destroy_timer, self.create_timer(self._wall, lambda: look(None), clock=steady))

    def _commands(self) -> bool:
        """Whether this controller commands the plant, or will as soon as it can."""
        if self._waits:
            return False
        agent = self._agent
        if agent is None:
            return not (self.p["standby"] or self.p["shadow"])
        released = agent.mode is Mode.FALLBACK and agent.safety.fallback == "release"
        return not (agent.mode is Mode.SHADOW or released)

    def _other(self) -> str:
        """Who else commands the plant, for people; empty if nobody does.

        The plant decides whom it follows; where it does not say so, the claim that is older stands.
        """
        if self._follows in self._holder.ids:
            return ""
        if self._follows and self._claimants.alive(self._follows):
            return self._claimants.who(self._follows)
        other = self._claimants.commander(other_than=self._holder.ids)
        return "" if other is None or (self._commands() and self._holder.precedes(other)) else other.who

    def _heed_claims(self) -> None:
        """Refuses to work beside another controller, or waits for it to go.

        Raises:
            ConfigError: in one line.
        """
        if self._agent is None:
            return
        other = self._other()
        if other and self.p["standby"] and not self.p["shadow"]:
            self._waits = True
            self._diagnostics.report(OK, f"standing by: {other} commands {self._info.name}")
        elif other and self._commands():
            raise ConfigError(
                f"{other} commands {self._info.name} already: stop it first, or start this one with standby or shadow"
            )
        elif self._waits and not other:
            self._waits = False
            self.get_logger().info(f"nobody else commands {self._info.name} any more: taking over")
            self._on_plant(self._info)
        elif self._lurks and not other and self._alone():
            self._leave_shadow()
        if self._commands() != self._holder.claim.commands:
            self._holder.beat()

    def _alone(self) -> bool:
        """Whether whoever commanded before is gone, or has had the time to say that it is there."""
        return bool(self._follows) or time.monotonic() - self._since > LEASE

    def _leave_shadow(self) -> None:
        """A standby that has learned in SHADOW takes over: at once if its data suffice, else it collects."""
        assert self._agent is not None
        self._lurks = False
        wanted = next(mode for mode in (Mode.CONTROLLING, Mode.COLLECTING) if not self._agent.request(mode))
        self._enter(changes.MODE, int(wanted))
        self.get_logger().info(f"nobody else commands {self._info.name}: {wanted.name} with what was learned beside it")
        if self._k < 0:
            self._begin()

    # References, disturbances, reports

    def _on_reference(self, msg: Sample) -> None:
        k = int(msg.k)
        if self._agent is not None and not self._set_reference(k, msg):
            return
        self._early.pop(k, None)
        self._early[k] = msg
        if len(self._early) > topics.REFERENCE.depth:  # as many as a controller that starts now would hear of
            del self._early[next(iter(self._early))]
        if self._agent is not None:
            self._begin()

    def _set_reference(self, k: int, msg: Sample) -> bool:
        assert self._agent is not None
        reason = refusal(msg, len(self._info.output_names))
        if reason:
            self._refuse(f"reference from {k} on: {reason}")
            return False
        self._enter(changes.REFERENCE, [k, list(msg.values)])
        self._agent.references.set(k, msg.values)
        return True

    def _begin(self) -> None:
        """The inputs that outputs 0 depend on."""
        assert self._agent is not None
        waits = self._waits or self._agent.mode is Mode.SHADOW
        if self._started or waits or self._agent.references.at(0) is None:
            return
        self._started = True
        self._first = list(enumerate(self._agent.start()))
        self._send_first()

    def _send_first(self) -> None:
        self._begun = time.monotonic()
        for k, u in self._first:
            self._send(k, u)

    def _begin_again(self) -> None:
        """A plant that began to listen after the first inputs had gone out would wait for them for ever."""
        assert self._agent is not None
        patience = max(_AGAIN, 2 * self._agent.settings.s * self._wall)
        if self._started and time.monotonic() - self._begun > patience:
            self.get_logger().warning("no outputs yet: the first inputs once more")
            self._send_first()

    def _on_inputs(self, msg: Reading) -> None:
        """SHADOW only: what whoever is in control commands."""
        assert self._agent is not None
        if self._agent.mode is Mode.SHADOW and not refusal(msg, len(self._info.input_names)):
            self._agent.overhear(int(msg.k), msg.values)

    def _on_disturbances(self, msg: Reading) -> None:
        """Measured at sample k, and forecast for the samples after it as far as there are values."""
        assert self._agent is not None
        size = len(self._info.disturbance_names)
        reason = refusal(msg, size * max(len(msg.values) // size, 1))
        if not reason and msg.epoch != self._info.epoch:
            reason = f"epoch {msg.epoch} instead of {self._info.epoch}"
        if reason:
            self._refuse(f"disturbances {msg.k}: {reason}")
            return
        self._agent.disturbances.set(int(msg.k), np.reshape(msg.values, (-1, size)))
        for _, outputs in self._joined.told():
            self._answer(outputs)

    def _on_report(self, msg: MonitorReport) -> None:
        """Modes that the inputs do not reach, as far as the monitor can tell."""
        finding = msg.r_controllability
        decided = finding.verdict in (Verdict.PROVED, Verdict.NOT_PROVED)
        if self._agent is None or msg.epoch != self._info.epoch or not decided:
            return
        parts = zip(msg.modes_re, msg.modes_im, msg.modes_strength, strict=True)
        modes = [complex(re, im) for re, im, strength in parts if strength <= finding.noise_bound]
        self._enter(changes.MODES, changes.pairs(modes))
        self._agent.blame(self._decided + 1, modes)

    # Samples

    def _on_outputs(self, msg: Reading) -> None:
        assert self._agent is not None
        reason = refusal(msg, len(self._info.output_names))
        if not reason and msg.epoch != self._info.epoch:
            reason = f"epoch {msg.epoch} instead of {self._info.epoch}"
        if not reason and msg.k <= self._k:
            reason = f"outputs {msg.k} again or too late, {self._k} were the last"
            self._look_for_twins(msg)
        if reason:
            self._refuse(f"outputs {msg.k}: {reason}")
            return
        if msg.sender != self._follows:
            self._follows = int(msg.sender)
            self._heed_claims()
        if self._waits:
            self._k = self._decided = int(msg.k)
            return
        now = time.monotonic()
        self._gap = (now - self._arrived) / (int(msg.k) - self._k)
        self._arrived, self._quiet, self._overdue, self._k = now, 0, 0, int(msg.k)
        self._newest = tuple(msg.values)
        for _, outputs in self._joined.outputs(self._k, msg):
            self._answer(outputs)

    def _look_for_twins(self, msg: Reading) -> None:
        """The same outputs with other values, several times: another plant answers beside the one that is controlled.

        Raises:
            ConfigError: then, for what comes first would be taken from either.
        """
        self._twins += msg.k == self._k and tuple(msg.values) != self._newest
        if self._twins >= _TWINS:
            raise ConfigError(f"two plants publish outputs in {self.get_namespace()}: stop one of them")

    def _answer(self, msg: Reading) -> None:
        """Decides from outputs k, and publishes the decision."""
        assert self._agent is not None
        self._finish()
        self._apply_changes()
        if self._clock_jumped(msg):
            self._enter(changes.CUT, None)
            self._agent.cut()
        k = self._decided = int(msg.k)
        decision = self._agent.step(k, msg.values, int(msg.held))
        if decision.u is not None:
            self._send(k + self._agent.settings.s, decision.u)
        self._unfinished = (msg, decision, time.monotonic() - self._arrived)
        if self._info.lockstep:
            self._finish()
        else:  # a plant in the same process takes its inputs first
            self._after(self._finish)

    def _finish(self) -> None:
        """What follows a command: the state, and the preparation of the next step. Comes before anything else does."""
        if self._unfinished is None or self._agent is None:
            return
        (outputs, decision, took), self._unfinished = self._unfinished, None
        limited = decision.result is not None and decision.result.limited
        self.deadline_misses += self._health.sample(self._gap, took, limited)
        self._publish_state(outputs, decision)
        self._agent.prepare()

    def _clock_jumped(self, msg: Reading) -> bool:
        """Whether the sampling instants do not fit their numbers: then nobody knows how much time passed between."""
        now, before = msg.time_ns, self._stamp
        self._stamp = now
        if self._info.lockstep or not (now and before):
            return False
        late = now - before - (int(msg.k) - self._decided) * self._period
        jumped = now < before or late > (self.p["max_gap"] + 1) * self._period
        if jumped:
            self.jumps += 1
            self.get_logger().warning(f"outputs {msg.k} are stamped {(now - before) / 1e9:.6g} s after {self._decided}")
        return jumped

    def _look(self) -> None:
        """Once a period of real time: outputs that have stopped coming do not stop the controller.

        Counts its own calls, so that a process that was asleep itself does not blame the plant.
        """
        if self._agent is None or self._waits:
            return
        if self._k < 0:
            self._begin_again()
            return
        self._quiet += 1
        if not self.p["patience"] or self._quiet < self.p["patience"] or self._overdue - self._k >= self.p["max_hold"]:
            return
        k = self._k + int((time.monotonic() - self._arrived) / self._wall)
        if k <= max(self._k, self._overdue):
            return
        self._finish()
        self._overdue = k
        self.deadline_misses += 1
        self._health.overdue()
        self._enter(changes.OVERDUE, k)
        decision = self._agent.overdue(k)
        if decision.u is not None:
            self._send(k + self._agent.settings.s, decision.u)
        blank = Reading(self._t0 + k * self._period, self._info.name, self._info.epoch, k, (), (), 0, 0)
        self._publish_state(blank, decision, overdue=True)

    def _send(self, k: int, u: np.ndarray) -> None:
        assert self._inputs is not None
        time_ns = self._t0 + k * self._period
        self._inputs.publish(pack(self._info.name, self._info.epoch, k, u, time_ns, sender=self._holder.id))

    def _refuse(self, reason: str) -> None:
        self.refused += 1
        self.get_logger().warning(f"refused {reason}", throttle_duration_sec=5.0)

    def _publish_state(self, outputs: Reading, decision: Decision, *, overdue: bool = False) -> None:
        assert self._agent is not None
        assert self._state is not None
        msg = state_message(self._agent, decision)
        msg.header = outputs.header
        msg.epoch, msg.refused, msg.overdue = outputs.epoch, self.refused, overdue
        msg.deadline_misses = self.deadline_misses
        self._state.publish(msg)
        level, text = judgement(msg, decision, self._health.complaints())
        if self._diagnostics.due(level, text):
            assert self._inputs is not None
            age = (self.get_clock().now().nanoseconds - outputs.time_ns) / 1e9
            counters = {"clock_jumps": self.jumps, "inputs_late": self._inputs.deadlines_missed, "data_age": age}
            counters |= {"lost": self._agent.lost, **self._health.values()}
            self._diagnostics.report(level, text, facts(msg, decision) | counters)
        if self._commands() != self._holder.claim.commands:
            self._holder.beat()

    # Requests

    def _enter(self, name: str, value: Any) -> None:
        """Writes down what enters the agent besides samples, so that a recorded run can be computed again."""
        msg = Change(epoch=self._info.epoch, k=self._decided + 1, name=name, value=json.dumps(value))
        msg.header.frame_id = self._info.name
        msg.header.stamp = self.get_clock().now().to_msg()
        self._record.publish(msg)

    def _request(self, wanted: int) -> str:
        """Asks the agent for a mode; returns why not, or nothing."""
        if self._agent is None:
            return "there is no plant yet"
        self._finish()
        other = self._other()
        if other and wanted != Mode.SHADOW:
            return f"{other} commands {self._info.name}: stop it first"
        why = self._agent.request(wanted)
        if not why:
            self._lurks = False
            self._enter(changes.MODE, wanted)
            self._heed_claims()
            if self._k < 0:
                self._begin()
        return why

    def _on_set_mode(self, request: Any, response: Any) -> Any:
        why = self._request(int(request.mode))
        response.success = not why
        response.message = why or f"now {Mode(self._agent.mode).name}"
        self.get_logger().info(f"set_mode {request.mode}: {response.message}")
        return response

    def _on_reset(self, _request: Any, response: Any) -> Any:
        why = self._request(Mode.COLLECTING)
        response.success = not why
        response.message = why or "the window is empty, collecting again"
        self.get_logger().info(f"reset: {response.message}")
        return response

    def _check_changes(self, parameters: dict[str, Any]) -> None:
        if self._agent is not None:
            make_agent(parameters, self._info)

    def _apply_changes(self) -> None:
        assert self._agent is not None
        if wanted := self._changed.take():
            self._enter(changes.PARAMETERS, wanted)
            changes.change_parameters(self._agent, self.p, self._info, wanted)


def main() -> int:
    """Console script: runs the controller node."""
    return run_node(ControllerNode)


if __name__ == "__main__":
    raise SystemExit(main())
