# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The recorder: every topic of a zone, as it came over the wire, into one bag."""

import time
from pathlib import Path
from typing import Any

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from ..bags.convert import offered_qos
from ..bags.writer import BagWriter
from ..ros import topics
from ..ros.lifecycle import ManagedNode
from ..ros.parameters import ConfigError, Param
from ..ros.run import run_node

PARAMETERS = (
    Param("folder", "", "folder of the bag; must not exist yet"),
    Param("attach", [""], "files to keep in the bag, e.g. the parameters of the run"),
    Param("metadata", [""], "KEY=VALUE strings to store in the bag"),
    Param(
        "idle", 0.3, "how long the topics must be silent before the bag is closed at the end", "s", low=0.0, high=60.0
    ),
)

_PATIENCE = 5.0  # [s] for the last messages, when others go on publishing


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
    """Writes the CDR bytes of every message of the topic table to an MCAP bag in the layout of rosbag2."""

    parameters = PARAMETERS

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("recorder", **kwargs)
        self.messages = 0
        self._last_message = time.monotonic()
        self._stopping = 0.0
        self._writer: BagWriter | None = None
        self._known: set[str] = set()

    def configure(self) -> None:
        """Opens the bag and subscribes."""
        if not self.p["folder"]:
            raise ConfigError("recorder: give the parameter folder, for example folder:=runs/today/bag")
        metadata = dict(text.split("=", 1) for text in filter(None, self.p["metadata"]))
        self._writer = BagWriter(Path(self.p["folder"]), metadata=metadata)
        self.resources.callback(self._close)
        for path in map(Path, filter(None, self.p["attach"])):
            self._writer.attach(path.name, "application/yaml", path.read_bytes())
        for topic in topics.ALL:
            tap = self.create_subscription(
                topic.type, topic.name, self._writes(topic), _subscription_qos(topic), raw=True
            )
            self.resources.callback(self.destroy_subscription, tap)

    def drained(self) -> bool:
        """Whether nothing has arrived for a while, or others just go on, so that the bag may be closed."""
        now = time.monotonic()
        self._stopping = self._stopping or now
        return now - self._last_message > self.p["idle"] or now - self._stopping > _PATIENCE

    def _close(self) -> None:
        if self._writer is not None:
            self._writer.close()
            self._writer = None

    def _writes(self, topic: topics.Topic) -> Any:
        name = self.resolve_topic_name(topic.name)

        def write(data: bytes) -> None:  # asked for message info, too, EventsExecutor fails on raw bytes
            try:
                self._write(name, topic, data)
            except OSError as error:
                self.on_fault(error)

        return write

    def _write(self, name: str, topic: topics.Topic, data: bytes) -> None:
        if self._writer is None:
            return
        if name not in self._known:
            self._known.add(name)
            self._add(name, topic)
        now = self.get_clock().now().nanoseconds
        self._writer.write(name, data, now, now)
        self.messages += 1
        self._last_message = time.monotonic()

    def _add(self, name: str, topic: topics.Topic) -> None:
        assert self._writer is not None
        offered = self.get_publishers_info_by_topic(name)
        type_hash = str(offered[0].topic_type_hash) if offered else ""
        self._writer.add_topic(
            name, topic.type_name, qos=[offered_qos(info.qos_profile) for info in offered], type_hash=type_hash
        )


def main() -> int:
    """Console script: runs the recorder node."""
    return run_node(RecorderNode)


if __name__ == "__main__":
    raise SystemExit(main())
