# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""A bag file from front to end, whatever its state: for reading without an index, for checks and repairs."""

from collections.abc import Iterator
from pathlib import Path
from typing import TypeAlias

import numpy as np
from mcap.records import Channel, Metadata, Schema

from .messages import Messages
from .scan import Damage, scan
from .topic import TopicInfo

Walked: TypeAlias = Damage | Metadata | tuple[dict[int, TopicInfo], Messages]


def walk(file: Path) -> Iterator[Walked]:
    """Yields, in file order, messages with the topics known so far (by channel), named metadata, and every damage."""
    schemas: dict[int, Schema] = {}
    topics: dict[int, TopicInfo] = {}
    orphans = 0
    for record in scan(file):
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            topics.setdefault(record.id, TopicInfo.of(record, schemas.get(record.schema_id)))
        elif isinstance(record, Messages):
            known = np.isin(record.channel, list(topics))
            orphans += int((~known).sum())
            yield topics, record.rows(known)
        elif isinstance(record, Metadata | Damage):
            yield record
    if orphans:
        yield Damage(0, 0, f"{orphans} messages of topics whose description is lost")
