# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The node: the field as a plant of its zone. Publishes plant_info and outputs on its behalf, takes inputs."""

import math
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from deepc_msgs.msg import PlantInfo, Sample
from std_srvs.srv import SetBool, Trigger

from ..ros import topics
from ..ros.claim import Claimants, Owner
from ..ros.convert import sample, stamp
from ..ros.diagnostics import ERROR, OK, WARN, Diagnostics
from ..ros.lifecycle import ManagedNode
from ..ros.parameters import ConfigError, Param
from ..ros.run import run_node
from . import round_trip
from .core import Gateway, Outputs
from .engine import Engine
from .guard import Command, Refusal
from .link import Link, make_link
from .load import load
from .loop_thread import LoopThread
from .mirror import Mirror
from .supervisor import Answer, State
from .tags import TagMap
from .units import check_registered

_LEVELS = {State.RUN: OK, State.SHADOW: WARN, State.DEGRADED: WARN, State.FALLBACK: ERROR}
_REPORT_EVERY = 32  # samples between two reports of the round trip

PARAMETERS = (Param("tags", "", "YAML file with the tag map of the field"),)


class GatewayNode(ManagedNode):
    """Runs a gateway. Starts in SHADOW; the services gateway/auto, gateway/acknowledge and gateway/new_data steer it.

    The protocol runs in a thread of its own, and so does the core: the callbacks here only hand over.
    """

    parameters = PARAMETERS

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("gateway", **kwargs)
        self.gateway: Gateway | None = None

    def configure(self) -> None:
        """Reads the tag map, makes the topics and services."""
        self.tags = load(Path(self.p["tags"]))
        check_registered(self.tags)
        self._link = self._make_link()
        self._mirror = Mirror(self.tags) if self.tags.serve is not None else None
        self._info = self.advertise(topics.PLANT_INFO)
        self._outputs = self.advertise(topics.OUTPUTS, lockstep=False, sample_time=self.tags.period)
        self.subscribe(topics.INPUTS, self._on_inputs, lockstep=False)
        self._claimants = Claimants(self)
        self.resources.callback(self._claimants.destroy)
        if self._mirror is not None:
            self._watch(self._mirror)
        self._diagnostics = Diagnostics(self, self.tags.plant.name)
        self.resources.callback(self._diagnostics.destroy)
        for name, kind, answer in (
            ("gateway/auto", SetBool, self._on_auto),
            ("gateway/acknowledge", Trigger, self._on_acknowledge),
            ("gateway/new_data", Trigger, self._on_new_data),
        ):
            self.resources.callback(self.destroy_service, self.create_service(kind, name, answer))

    def activate(self) -> None:
        """Starts the protocol; in SHADOW."""
        reference = self._reference()
        self.gateway = Gateway(self.tags, time.monotonic(), reference)
        self._engine = Engine(self.gateway, self._link, on_outputs=self._publish, on_look=self._look)
        self._owner = Owner(self._claimants, 2.0 * self.tags.period)
        self._announced, self._told = 0, ("", "")
        self._samples = 0
        self._thread = LoopThread(self._failed)
        self._thread.start(self._engine.run())
        if self._mirror is not None:
            self._thread.start(self._mirror.run())

    def deactivate(self) -> None:
        """Leaves the fallback behind in the field and disconnects."""
        self._thread.finish(self._engine.leave(), self.tags.supervision.ramp + 5.0)
        self._thread.stop()

    def _make_link(self) -> Link:
        if self.tags.kind != "ros":
            return make_link(self.tags)
        from .ros_link import RosLink

        link = RosLink(self.tags, self)
        self.resources.callback(link.destroy)
        return link

    def _reference(self) -> float:
        name = self.tags.supervision.round_trip_file
        return round_trip.load(Path(self.tags.file).parent / name) if name else math.nan

    def _on_inputs(self, msg: Sample) -> None:
        command = Command(
            zone=msg.header.frame_id, source="controller", epoch=int(msg.epoch), k=int(msg.k), values=list(msg.values),
            quality=list(msg.quality),
        )  # fmt: skip
        self._thread.tell(self._command, command, int(msg.sender))

    def _command(self, command: Command, sender: int) -> None:
        assert self.gateway is not None
        guard = self.gateway.guard
        if foreign := self._owner.refusal(sender):
            refusal: Refusal | None = guard.refuse(Refusal.FOREIGN, foreign)
        else:
            refusal = self._engine.command(command)
        if refusal is None:
            self._owner.follow(sender)
        elif self.gateway.state is not State.SHADOW:
            self.get_logger().warning(f"inputs refused: {guard.reason}", throttle_duration_sec=5.0)

    def _publish(self, outputs: Outputs) -> None:
        vector = outputs.vector
        sender = (self._owner.sender or 0) if outputs.epoch else 0
        name = self.tags.plant.name
        msg = sample(name, outputs.epoch, outputs.k, vector.values, vector.stamp_ns, outputs.held, sender)
        if vector.quality.any():
            msg.quality = vector.quality.tolist()
        self._outputs.publish(msg)
        self._samples += 1
        if self._mirror is not None:
            self._mirror.sample(outputs)

    def _look(self) -> None:
        """Says what changed: a new epoch, the state, its reason."""
        gateway = self.gateway
        assert gateway is not None
        if self._announced != gateway.epoch:
            self._announced = gateway.epoch
            self._info.publish(plant_info(self.tags, gateway.epoch, self.get_clock().now().nanoseconds))
        told = (gateway.state, gateway.supervisor.reason)
        if told != self._told:
            self._told = told
            self.get_logger().info(f"{told[0]}: {told[1]}")
            self._report(gateway)
        elif self._samples >= _REPORT_EVERY:
            self._samples = 0
            self._report(gateway)
            self._keep(gateway)
        if self._mirror is not None:
            self._mirror.gateway(gateway)

    def _report(self, gateway: Gateway) -> None:
        trip, counts = gateway.round_trip, gateway.guard.counts
        measured = f" (round trip {1e3 * trip.median:.3g} ms)" if trip.measured else ""
        moved = trip.moved()
        level = max(_LEVELS[gateway.state], WARN if moved else OK)
        values = {
            "round trip [s]": trip.median,
            "round trip of the data [s]": trip.reference,
            "passed": counts.passed,
            "clamped": counts.clamped,
            **{f"refused: {reason.value}": count for reason, count in counts.refused.items()},
            "clock of the field ahead by [s]": gateway.assembler.clock_error,
        }
        self._diagnostics.report(level, f"{gateway.state}: {moved or gateway.supervisor.reason}{measured}", values)

    def _keep(self, gateway: Gateway) -> None:
        """Keeps the round trip of the data for later sessions, once it is known."""
        name, reference = self.tags.supervision.round_trip_file, gateway.round_trip.reference
        if name and not math.isnan(reference):
            path = Path(self.tags.file).parent / name
            if not path.exists():
                round_trip.save(path, reference)

    def _on_auto(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        ask = Gateway.auto if request.data else Gateway.shadow
        return self._answered(lambda gateway: ask(gateway, time.monotonic()), response)

    def _on_acknowledge(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._answered(lambda gateway: gateway.acknowledge(time.monotonic()), response)

    def _on_new_data(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """The data are to be collected anew: their round trip is no longer that of the old ones."""

        def forget(gateway: Gateway) -> Answer:
            gateway.round_trip.forget()
            name = self.tags.supervision.round_trip_file
            if name:
                (Path(self.tags.file).parent / name).unlink(missing_ok=True)
            return Answer(True, "the next data set its own round trip")

        return self._answered(forget, response)

    def _answered(self, request: Any, response: Any) -> Any:
        if not self._active or self.gateway is None:
            response.success, response.message = False, "the gateway is not active"
            return response
        gateway = self.gateway
        try:
            answer = self._thread.ask(lambda: request(gateway))
            response.success, response.message = answer.accepted, answer.message
            self._thread.tell(self._look)
        except TimeoutError:
            response.success, response.message = False, "no answer from the gateway's own thread"
        return response

    def _watch(self, mirror: Mirror) -> None:
        """What the read-only server shows beside outputs and state."""
        for topic, take in (
            (topics.REFERENCE, mirror.reference),
            (topics.STATE, mirror.controller),
            (topics.REPORT, mirror.report),
            (topics.INPUTS, mirror.inputs),
        ):
            self.subscribe(topic, partial(self._hand_over, take), lockstep=False)

    def _hand_over(self, take: Callable[[Any], None], msg: Any) -> None:
        self._thread.tell(take, msg)

    def _failed(self, error: BaseException) -> None:
        """The thread ended by an error: says so; the run ends with it."""
        self.fault = str(error) if isinstance(error, ConfigError) else f"{type(error).__name__}: {error}"
        self.get_logger().error(f"gateway stopped working: {self.fault}")


def plant_info(tags: TagMap, epoch: int, now_ns: int) -> PlantInfo:
    """What the gateway says of the plant."""
    plant = tags.plant
    info = PlantInfo(name=plant.name, variant=plant.variant, epoch=epoch, lockstep=False, speed=tags.speed)
    info.header.frame_id, info.header.stamp = plant.name, stamp(now_ns)
    info.sample_time = plant.sample_time
    info.input_names, info.input_units = [t.name for t in tags.inputs], [t.unit for t in tags.inputs]
    info.output_names, info.output_units = [t.name for t in tags.outputs], [t.unit for t in tags.outputs]
    info.input_min = np.array([t.low for t in tags.inputs])
    info.input_max = np.array([t.high for t in tags.inputs])
    info.n, info.q, info.r, info.s = (int(plant.prior.get(name, 0)) for name in ("n", "q", "r", "s"))
    return info


def main() -> int:
    """Console script: runs the gateway node."""
    return run_node(GatewayNode)


if __name__ == "__main__":
    raise SystemExit(main())
