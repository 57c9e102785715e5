# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The folder layout of rosbag2: file names, metadata.yaml (version 9) and QoS entries in its words."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import yaml

METADATA = "metadata.yaml"
MARKER = "INCOMPLETE"  # in the folder from the first byte until a clean close
INFINITE = {"sec": 9223372036, "nsec": 854775807}


def qos_entry(
    *,
    history: str = "keep_last",
    depth: int = 10,
    reliability: str = "reliable",
    durability: str = "volatile",
    deadline_ns: int | None = None,
    lifespan_ns: int | None = None,
    liveliness: str = "automatic",
    lease_ns: int | None = None,
) -> dict[str, Any]:
    """One offered QoS profile as rosbag2 writes it; durations in ns, None = infinite."""
    return {
        "history": history,
        "depth": depth,
        "reliability": reliability,
        "durability": durability,
        "deadline": _duration(deadline_ns),
        "lifespan": _duration(lifespan_ns),
        "liveliness": liveliness,
        "liveliness_lease_duration": _duration(lease_ns),
        "avoid_ros_namespace_conventions": False,
    }


def _duration(nanoseconds: int | None) -> dict[str, int]:
    if nanoseconds is None:
        return dict(INFINITE)
    return {"sec": nanoseconds // 10**9, "nsec": nanoseconds % 10**9}


@dataclass(slots=True)
class TopicRecord:
    """What metadata.yaml says of one topic."""

    name: str
    type: str
    qos: list[dict[str, Any]]
    type_hash: str
    count: int = 0


@dataclass(slots=True)
class FileRecord:
    """What metadata.yaml says of one file; times in ns."""

    path: str
    start: int = 0
    end: int = 0
    count: int = 0
    topics: dict[str, int] = field(default_factory=dict)

    def add(self, topic: str, log_time: int) -> None:
        """Counts one message."""
        self.start = log_time if not self.count else min(self.start, log_time)
        self.end = log_time if not self.count else max(self.end, log_time)
        self.count += 1
        self.topics[topic] = self.topics.get(topic, 0) + 1


def bag_information(
    files: Sequence[FileRecord],
    topics: Sequence[TopicRecord],
    custom_data: Mapping[str, str],
    ros_distro: str,
    counts: Mapping[str, int] | None = None,
) -> dict[str, Any]:
    """The map under ``rosbag2_bagfile_information``; every key is one that rosbag2's reader requires."""
    filled = [f for f in files if f.count]
    start = min((f.start for f in filled), default=0)
    end = max((f.end for f in filled), default=0)
    return {
        "version": 9,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": end - start},
        "starting_time": {"nanoseconds_since_epoch": start},
        "message_count": sum(f.count for f in files),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": t.name,
                    "type": t.type,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": t.qos,
                    "type_description_hash": t.type_hash,
                },
                "message_count": t.count if counts is None else counts.get(t.name, 0),
            }
            for t in topics
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [f.path for f in files],
        "files": [
            {
                "path": f.path,
                "starting_time": {"nanoseconds_since_epoch": f.start},
                "duration": {"nanoseconds": f.end - f.start},
                "message_count": f.count,
            }
            for f in files
        ],
        "custom_data": dict(custom_data) or None,
        "ros_distro": ros_distro,
    }


_Base: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)  # the one in C where libyaml is there


class _Dumper(_Base):  # type: ignore[misc]
    """Writes repeated values out in full: rosbag2's reader is happier without YAML anchors."""

    def ignore_aliases(self, data: object) -> bool:  # noqa: ARG002 - signature of the base class
        return True


def to_yaml(data: object) -> str:
    """YAML text without anchors, keys in the given order."""
    return yaml.dump(data, Dumper=_Dumper, sort_keys=False, allow_unicode=True)
