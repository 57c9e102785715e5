# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""What the nodes of a recorded run complained about, on /diagnostics and in their logs."""

from collections.abc import Iterator
from typing import Any

from .reader import BagReader

_DIAGNOSTICS, _LOG = "diagnostic_msgs/msg/DiagnosticArray", "rcl_interfaces/msg/Log"
_STATUS = {1: "warn", 2: "error", 3: "stale"}
_SEVERITY = {30: "warn", 40: "error", 50: "fatal"}


def spoken(reader: BagReader, most: int) -> list[tuple[float, str, str, str]]:
    """Warnings and errors as (time since the start of the bag [s], node, level, words), the first ``most`` of them.

    What a node repeats is listed once, at the time when it was said first in a row.
    """
    kinds = {_DIAGNOSTICS: _statuses, _LOG: _lines}
    topics = [t.name for t in reader.topics.values() if t.type in kinds and t.readable]
    said: dict[tuple[str, str], str] = {}
    found: list[tuple[float, str, str, str]] = []
    for raw, message in reader.decoded(topics):
        for node, level, words in kinds[raw.type](message):
            if level and said.get((raw.topic, node)) != words:
                found.append((1e-9 * (raw.log_time - reader.start), node, level, words))
            said[raw.topic, node] = words
            if len(found) == most:
                return found
    return found


def _statuses(message: Any) -> Iterator[tuple[str, str, str]]:
    """Node, level (empty when all is well) and words of each status."""
    for status in message.status:
        yield status.name, _STATUS.get(status.level, ""), status.message


def _lines(message: Any) -> Iterator[tuple[str, str, str]]:
    yield message.name, _SEVERITY.get(message.level, ""), message.msg
