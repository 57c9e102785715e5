# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The recorder: every topic of a zone, as it came over the wire, into one bag."""

import time
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from ..bags.background import BackgroundWriter
from ..bags.convert import from_cdr, offered_qos
from ..bags.layouts import layouts
from ..bags.provenance import facts
from ..bags.writer import BagWriter
from ..ros import topics
from ..ros.diagnostics import ERROR, WARN, Diagnostics
from ..ros.lifecycle import ManagedNode
from ..ros.parameters import ConfigError, Param
from ..ros.run import run_node

PARAMETERS = (
    Param("folder", "", "folder of the bag; must not exist yet"),
    Param("attach", [""], "files to keep in the bag, e.g. the parameters of the run"),
    Param("metadata", [""], "KEY=VALUE strings to store in the bag"),
    Param("figure", False, "draw the run when it ends and keep the picture in the bag"),
    Param("max_size", 0.0, "start a new file of the bag after this much; 0 = never", "MB", low=0.0),
    Param("max_duration", 0.0, "start a new file of the bag after this time; 0 = never", "s", low=0.0),
    Param("queue", 64.0, "messages that may wait for a slow disk", "MB", low=0.1, high=10_000.0),
    Param(
        "idle", 0.3, "how long the topics must be silent before the bag is closed at the end", "s", low=0.0, high=60.0
    ),
)

_LOOK = 0.5  # [s] between two looks at how the writing goes
_PATIENCE = 5.0  # [s] for the last messages, when others go on publishing
_WAIT = 60.0  # [s] that a loop in lockstep waits for the disk; one in real time does not wait
_MEDIA = {".yaml": "application/yaml", ".json": "application/json", ".xml": "application/xml", ".png": "image/png"}
FIGURE = "figure.png"  # name of the attached picture


def _subscription_qos(topic: topics.Topic) -> QoSProfile:
    """Takes whatever is offered; never lets a message overwrite another before it is written."""
    reliable = topic is not topics.CLOCK
    return QoSProfile(
        history=HistoryPolicy.KEEP_ALL if reliable else HistoryPolicy.KEEP_LAST,
        depth=0 if reliable else 10,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if topic.latched else DurabilityPolicy.VOLATILE,
    )


class RecorderNode(ManagedNode):
    """Writes the CDR bytes of every message of the topic table to an MCAP bag in the layout of rosbag2.

    A disk that is full, gone or too slow is an ERROR or WARN on /diagnostics and the node's fault at its end, but never
    the end of the loop: the node lives on without writing.
    """

    parameters = PARAMETERS

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("recorder", **kwargs)
        self.messages = 0
        self._last_message = time.monotonic()
        self._stopping = 0.0
        self._bag: BackgroundWriter | None = None
        self._known: set[str] = set()
        self._lockstep, self._met = False, False
        self._told: tuple[bytes, str] | None = None  # trouble that was reported

    def configure(self) -> None:
        """Opens the bag and subscribes."""
        if not self.p["folder"]:
            raise ConfigError("recorder: give the parameter folder, for example folder:=runs/today/bag")
        given = dict(text.split("=", 1) for text in filter(None, self.p["metadata"]))
        size, duration = round(1e6 * self.p["max_size"]), self.p["max_duration"]
        files = {path.name: path.read_bytes() for path in map(Path, filter(None, self.p["attach"]))}
        writer = BagWriter(Path(self.p["folder"]), metadata=facts() | given, max_bytes=size, max_duration=duration)
        for name, data in files.items():
            _attach(writer, name, data)
        self._diagnostics = Diagnostics(self, "")
        self.resources.callback(self._diagnostics.destroy)
        self._bag = BackgroundWriter(writer, round(1e6 * self.p["queue"]))
        self.resources.callback(self._close)
        for topic in topics.RECORDED:
            tap = self.create_subscription(
                topic.type, topic.name, self._writes(topic), _subscription_qos(topic), raw=True
            )
            self.resources.callback(self.destroy_subscription, tap)
        look = self.create_timer(_LOOK, self._tell, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.resources.callback(self.destroy_timer, look)

    def drained(self) -> bool:
        """Whether nothing has arrived for a while, or others just go on, so that the bag may be closed."""
        now = time.monotonic()
        self._stopping = self._stopping or now
        return now - self._last_message > self.p["idle"] or now - self._stopping > _PATIENCE

    def _close(self) -> None:
        bag, self._bag = self._bag, None
        if bag is None:
            return
        writer = bag.stop()
        try:
            if not bag.failure:
                writer.add_metadata("recorder", {"messages": str(writer.message_count), "lost": str(bag.lost)})
                self._draw(writer)
            writer.close()
        except OSError as error:
            self.fault = str(error)
        if trouble := _trouble(bag):
            self.fault = trouble[1]

    def _draw(self, writer: BagWriter) -> None:
        if not self.p["figure"]:
            return
        from ..bags.figure import draw  # matplotlib, only where it is asked for
        from ..bags.recording import Recording

        writer.flush()
        with TemporaryDirectory() as folder:
            try:
                with Recording(writer.folder) as recording:
                    draw(recording, Path(folder) / FIGURE)
            except OSError as error:
                self.get_logger().warning(f"no figure: {error}")
                return
            _attach(writer, FIGURE, (Path(folder) / FIGURE).read_bytes())

    def _writes(self, topic: topics.Topic) -> Any:
        name = self.resolve_topic_name(topic.name)

        def write(data: bytes) -> None:  # asked for message info, too, EventsExecutor fails on raw bytes
            try:
                self._write(name, topic, data)
            except Exception as error:
                self.on_fault(error)

        return write

    def _write(self, name: str, topic: topics.Topic, data: bytes) -> None:
        if self._bag is None or self._bag.failure:
            return
        if name not in self._known:
            self._known.add(name)
            self._add(name, topic)
        if topic is topics.PLANT_INFO:
            self._meet(from_cdr(data, topic.type_name))
        now = self.get_clock().now().nanoseconds
        self._bag.write(name, data, now, patience=_WAIT if self._lockstep else 0.0)
        self.messages += 1
        self._last_message = time.monotonic()

    def _tell(self) -> None:
        """Says what is wrong with the recording, once."""
        trouble = self._bag and _trouble(self._bag)
        if trouble and trouble != self._told:
            self._told = trouble
            self.get_logger().error(trouble[1])
            self._diagnostics.report(*trouble)

    def _add(self, name: str, topic: topics.Topic) -> None:
        assert self._bag is not None
        offered = self.get_publishers_info_by_topic(name)
        qos = [offered_qos(info.qos_profile) for info in offered]
        type_hash = str(offered[0].topic_type_hash) if offered else ""
        self._bag.call(lambda writer: writer.add_topic(name, topic.type_name, qos=qos, type_hash=type_hash))

    def _meet(self, info: Any) -> None:
        """A plant: whether it waits for the disk, and layouts for its channels."""
        assert self._bag is not None
        self._lockstep = bool(info.lockstep)
        if not self._met:
            self._met = True
            zone = self.get_namespace().rstrip("/")
            for name, text in layouts(zone, info.output_names, info.input_names).items():
                self._bag.call(partial(_attach, name=name, data=text.encode()))


def _attach(writer: BagWriter, name: str, data: bytes) -> None:
    writer.attach(name, _MEDIA.get(Path(name).suffix, "application/octet-stream"), data)


def _trouble(bag: BackgroundWriter) -> tuple[bytes, str] | None:
    """Level and words of what is wrong with the recording, if anything is."""
    if bag.failure:
        return ERROR, bag.failure
    return (WARN, "the disk is too slow: messages are lost") if bag.lost else None


def main() -> int:
    """Console script: runs the recorder node."""
    return run_node(RecorderNode)


if __name__ == "__main__":
    raise SystemExit(main())
