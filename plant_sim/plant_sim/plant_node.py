# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The node that runs a plant: takes inputs, publishes outputs, in lockstep or in real time."""

import math
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from deepc_msgs.msg import PlantInfo, Sample
from rclpy.clock import Clock, ClockType
from rosgraph_msgs.msg import Clock as ClockMsg

from ros2_deepc.ros import topics
from ros2_deepc.ros.claim import Claimants, Owner
from ros2_deepc.ros.convert import period_ns, refusal, stamp
from ros2_deepc.ros.diagnostics import ERROR, OK, WARN, Diagnostics
from ros2_deepc.ros.health import Health
from ros2_deepc.ros.lifecycle import ManagedNode
from ros2_deepc.ros.parameters import ConfigError, Param
from ros2_deepc.ros.plants import find_plant
from ros2_deepc.ros.run import run_node
from ros2_deepc.ros.wire import Reading, pack

from .describe import describe
from .plant import Plant
from .plant_file import load

_BEHIND = 1.0  # [s] behind real time that are worth a warning
_AHEAD = 1000  # samples that inputs may be early: what waits for its tick must not grow without end

PARAMETERS = (
    Param("plant", "wscc9", "name of a registered plant (`ros2-deepc plants` lists them), or a plant's YAML file"),
    Param("options", [""], "options of the plant as KEY=VALUE strings, e.g. variant=full"),
    Param(
        "mode",
        "lockstep",
        "who drives: the inputs (lockstep) or the clock (realtime)",
        choices=("lockstep", "realtime"),
    ),
    Param("seed", 0, "seed of the plant's own randomness, e.g. its initial state", low=0),
    Param("steps", 0, "run length; 0 = endless", unit="samples", low=0),
    Param("speed", 1.0, "realtime only: how many times faster than the plant's own time", low=1e-6, high=1e9),
    Param("hold", 10, "realtime only: longest time without inputs for which the last ones are held", "samples", low=0),
    Param("safe", [0.0], "realtime only: input after that, one for all or shape (m,)", "input units"),
    Param("readers", 0, "lockstep only: subscribers of outputs to wait for before the first sample", low=0),
)


def make_plant(name: str, options: Mapping[str, str]) -> Plant:
    """Makes a registered plant, or one from a YAML file.

    Raises:
        ConfigError: for an unknown name or an option that the plant does not have.
    """
    if name.endswith((".yaml", ".yml")):
        return _from_file(Path(name), options)
    try:
        plant: Plant = find_plant(name, options)
    except ValueError as error:
        raise ConfigError(str(error)) from None
    return plant


def _from_file(path: Path, options: Mapping[str, str]) -> Plant:
    if options:
        raise ConfigError(f"plant {path}: a plant from a file has no options, got {', '.join(options)}")
    try:
        return load(path)
    except (ValueError, OSError) as error:
        raise ConfigError(f"plant {path}: {error}") from None


def parse_options(options: list[str]) -> dict[str, str]:
    """KEY=VALUE strings as a mapping; empty strings are skipped.

    Raises:
        ConfigError: for a string without '='.
    """
    pairs: dict[str, str] = {}
    for text in filter(None, options):
        key, equals, value = text.partition("=")
        if not equals:
            raise ConfigError(f"plant option {text!r} must have the form KEY=VALUE, e.g. variant=full")
        pairs[key] = value
    return pairs


def plant_info(plant: Plant, epoch: int, *, lockstep: bool, speed: float = 1.0) -> PlantInfo:
    """What a plant says of itself."""
    info = PlantInfo(name=plant.name, variant=plant.variant, epoch=epoch, lockstep=lockstep, speed=speed)
    info.header.frame_id = plant.name
    info.sample_time = float(plant.sample_time)
    info.input_names, info.input_units = list(plant.input_names), list(plant.input_units)
    info.output_names, info.output_units = list(plant.output_names), list(plant.output_units)
    info.input_min = np.asarray(plant.input_min, float).tolist()
    info.input_max = np.asarray(plant.input_max, float).tolist()
    info.n, info.q, info.r, info.s = (int(value) for value in plant.prior)
    info.d_known = plant.D is not None
    info.d = [] if plant.D is None else np.asarray(plant.D, float).ravel().tolist()
    return info


class PlantNode(ManagedNode):
    """Publishes plant_info, then outputs k as soon as the inputs up to k+s-1 are known; /clock in lockstep.

    lockstep: every inputs message of the index waited for makes one step; anything else is refused and counted. When
    the controller it follows is gone and another one claims the plant, a new epoch begins where the last one stopped.
    realtime: from the first inputs on, one step every Ts / speed; when no inputs came for a tick, the last are held
    and the outputs say for how long.
    """

    parameters = PARAMETERS

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("plant", **kwargs)
        self.refused = 0
        self.foreign = 0
        """Inputs refused because another controller commands the plant; they count as refused, too."""
        self.held_samples = 0
        self.skipped = 0
        """Ticks of real time that passed without a sample, because the process was held up."""
        self.behind = 0.0
        """How far this epoch lags behind the clock for that [s]: a simulated plant stands still meanwhile."""

    @staticmethod
    def plant_of(parameters: Mapping[str, Any]) -> Plant:
        """The plant that these parameters name.

        Raises:
            ConfigError: for an unknown plant or option.
        """
        given = {row.name: row.default for row in PARAMETERS} | dict(parameters)
        return make_plant(given["plant"], parse_options(given["options"]))

    @classmethod
    def describe(cls, parameters: Mapping[str, Any]) -> str:
        """That plant in words and numbers."""
        return describe(cls.plant_of(parameters))

    @classmethod
    def info(cls, parameters: Mapping[str, Any]) -> PlantInfo:
        """What that plant would say of itself, without running it."""
        return plant_info(cls.plant_of(parameters), 1, lockstep=parameters.get("mode", "lockstep") == "lockstep")

    def configure(self) -> None:
        """Makes the plant and its topics."""
        self.plant = self.plant_of(self.p)
        self._lockstep = self.p["mode"] == "lockstep"
        self._epoch = 0
        self._safe = self._safe_input()
        self._period = period_ns(self.plant.sample_time)
        lockstep, Ts = self._lockstep, self.plant.sample_time / self.p["speed"]
        self._info = self.advertise(topics.PLANT_INFO)
        readers = self.p["readers"] if lockstep else 0
        self._outputs = self.advertise(topics.OUTPUTS, lockstep=lockstep, sample_time=Ts, readers=readers)
        self._clock_topic = self.advertise(topics.CLOCK) if lockstep else None
        self.subscribe(topics.INPUTS, self._on_inputs, lockstep=lockstep)
        heed = self.guarded(lambda _: self._heed_claims())
        self._claimants = Claimants(self, lambda: heed(None))
        self.resources.callback(self._claimants.destroy)
        self._timer = None
        self._diagnostics = Diagnostics(self, self.plant.name)
        self.resources.callback(self._diagnostics.destroy)

    def activate(self) -> None:
        """Starts the run: a fresh plant, its description, then it waits for inputs 0."""
        # Somebody who starts again in real time must not be taken for the run before.
        epoch = self._epoch + 1 if self._lockstep else self.get_clock().now().nanoseconds // 10**9 % 2**32
        self._stepper = self.plant.start(self.p["seed"])
        self._status = ""
        self._last: np.ndarray | None = None
        self._wall = 0.0 if self._lockstep else self.plant.sample_time / self.p["speed"]
        self._ticked, self._took = math.nan, 0.0
        self._begin(epoch, self._period if self._lockstep else self.get_clock().now().nanoseconds)

    def _begin(self, epoch: int, start_ns: int) -> None:
        """A new epoch of the plant as it is now, for whoever commands it first."""
        self._epoch, self._start_ns = epoch, start_ns
        self._k = 0  # the next inputs to take
        self._held, self.behind = 0, 0.0
        self._pending: dict[int, np.ndarray] = {}
        self._owner, self._health = Owner(self._claimants, 2.0 * self._wall), Health(self._wall)
        speed = 1.0 if self._lockstep else self.p["speed"]
        info = plant_info(self.plant, epoch, lockstep=self._lockstep, speed=speed)
        info.header.stamp = stamp(start_ns)
        self._info.publish(info)
        self.get_logger().info(f"{self.plant.name}: waiting for inputs 0 of epoch {epoch} ({self.p['mode']})")

    def _heed_claims(self) -> None:
        """Lockstep waits for one controller, and another one cannot know at which inputs: it begins a new epoch."""
        if self.count_publishers(topics.PLANT_INFO.name) > 1:
            self.get_logger().warning(
                f"another plant is in {self.get_namespace()}, or was until it was killed: one namespace, one plant",
                throttle_duration_sec=10.0,
            )
        followed = self._owner.sender
        if not self._lockstep or followed is None or self._claimants.alive(followed):
            return
        successor = self._claimants.commander()
        if successor is not None and self._claimants.settled(successor.id):
            self.get_logger().warning(f"{self._claimants.who(followed)} is gone: {successor.who} gets a new epoch")
            self._begin(self._epoch + 1, self._time(self._k))

    def deactivate(self) -> None:
        """Stops the clock of a real-time run."""
        if self._timer is not None:
            self.destroy_timer(self._timer)
            self._timer = None

    def _safe_input(self) -> np.ndarray:
        m = len(self.plant.input_names)
        if len(self.p["safe"]) not in (1, m):
            raise ConfigError(f"plant: safe has {len(self.p['safe'])} entries, give one or {m}")
        return np.clip(np.broadcast_to(self.p["safe"], (m,)), self.plant.input_min, self.plant.input_max)

    @property
    def finished(self) -> bool:
        """Whether the run length was reached."""
        return bool(self.p["steps"] and self._k >= self.p["steps"])

    def _time(self, k: int) -> int:
        """Sampling instant of k [ns]. Lockstep starts at Ts: ROS reads 0 as 'no time'."""
        return int(self._start_ns + k * self._period)

    def _on_inputs(self, msg: Reading) -> None:
        reason = refusal(msg, len(self.plant.input_names))
        if not reason and msg.epoch != self._epoch:
            reason = f"epoch {msg.epoch} instead of {self._epoch}"
        if not reason and (reason := self._owner.refusal(int(msg.sender), final=self._lockstep)):
            self.foreign += 1
        if not reason and not (msg.k == self._k if self._lockstep else self._k <= msg.k < self._k + _AHEAD):
            reason = f"inputs {msg.k} when {self._k} are expected"
        if reason:
            self._refuse(reason)
            return
        self._owner.follow(int(msg.sender))
        u = np.array(msg.values)
        if self._lockstep:
            self._step(u)
            return
        if int(msg.k) in self._pending:
            self._refuse(f"inputs {msg.k} came again before their tick, the newest count")
        self._pending[int(msg.k)] = u
        if self._timer is None:
            self._start_ns = self.get_clock().now().nanoseconds
            self._tick()
            self._timer = self.create_timer(
                self._period / 1e9 / self.p["speed"], self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME)
            )

    def _refuse(self, reason: str) -> None:
        self.refused += 1
        self.get_logger().warning(f"inputs refused: {reason}", throttle_duration_sec=5.0)

    def _tick(self) -> None:
        now = time.monotonic()
        u = self._pending.pop(self._k, None)
        if u is None:
            self.held_samples += 1
            self._health.overdue()
            u = self._hold(self._last)
        else:
            self._held = 0
        gap, self._ticked = now - self._ticked, now
        self._note_skipped(gap)
        self._health.sample(gap, self._took, limited=False)
        self._step(u)
        self._took = time.monotonic() - now  # told with the next tick: the controller's answer comes first

    def _note_skipped(self, gap: float) -> None:
        """A timer leaves out the ticks that a stalled process has missed: the plant then lags behind its real time."""
        skipped = 0 if math.isnan(gap) else round(gap / self._wall) - 1
        if skipped > 0:
            self.skipped += skipped
            self.behind += skipped * self._wall
            self.get_logger().warning(
                f"held up for {gap:.3g} s: {skipped} ticks left out, {self.behind:.3g} s behind from now on",
                throttle_duration_sec=5.0,
            )

    def _tell(self) -> None:
        """How the plant is: what it says itself (a simulator's warnings, events), and whether it is commanded."""
        status = getattr(self._stepper, "status", "")
        if status != self._status and status:
            self.get_logger().warning(f"k = {self._k}: {status}", throttle_duration_sec=1.0)
        self._status = status
        alone = self._held == Sample.OWN_INPUT
        words = ["nobody commands it: safe input"] if alone else self._health.complaints()
        words = [status, *words] if status else words
        if self.behind > _BEHIND:
            words = [*words, "behind real time: activate it again to be on the clock"]
        level = ERROR if alone else WARN if words else OK
        text = "; ".join(words) or "running"
        if self._diagnostics.due(level, text):
            self._diagnostics.report(level, text, self._numbers())

    def _numbers(self) -> dict[str, Any]:
        """What goes with the level."""
        owner = self._owner.sender
        return {
            "k": self._k,
            "commanded_by": "nobody" if owner is None else self._claimants.who(owner),
            "refused": self.refused,
            "foreign": self.foreign,
            "held": self.held_samples,
            "skipped": self.skipped,
            "behind": self.behind,
            "outputs_late": self._outputs.deadlines_missed,
            **self._health.values(),
        }

    def _hold(self, last: np.ndarray | None) -> np.ndarray:
        """The input of a tick for which none came; None: no input has ever come."""
        if last is None or self._held == Sample.OWN_INPUT or self._held >= self.p["hold"]:
            if self._held != Sample.OWN_INPUT:
                self.get_logger().error(f"no inputs for {self._held + 1} samples: the plant goes to its safe input")
            self._held = Sample.OWN_INPUT
            return self._safe
        self._held += 1
        self.get_logger().warning(f"no inputs {self._k} in time, holding the last ones", throttle_duration_sec=5.0)
        return last

    def _step(self, u: np.ndarray) -> None:
        if self.finished:
            return
        if self._clock_topic is not None:
            self._clock_topic.publish(ClockMsg(clock=stamp(self._time(self._k))))
        self._last = u
        y = self._stepper.push(u)
        self._k += 1
        self._tell()
        k = self._k - max(int(self.plant.prior.s), 1)
        if y is not None and k >= 0:  # outputs that depend on inputs of two epochs belong to none
            sender = 0 if self._held == Sample.OWN_INPUT else self._owner.sender or 0
            self._outputs.publish(pack(self.plant.name, self._epoch, k, y, self._time(k), self._held, sender))
        if self.finished:
            self.get_logger().info(f"{self.plant.name}: {self._k} samples done")


def main() -> int:
    """Console script: runs the plant node."""
    return run_node(PlantNode)


if __name__ == "__main__":
    raise SystemExit(main())
