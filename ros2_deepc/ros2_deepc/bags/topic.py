# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""A topic of a bag, and one of its messages."""

from dataclasses import dataclass
from typing import NamedTuple, Self

from mcap.records import Channel, Schema

from .decode import Decoder, decoder
from .errors import BagError
from .outline import Outliner, outliner


class RawMessage(NamedTuple):
    """One message as it was on the wire; times in ns."""

    topic: str
    type: str
    log_time: int
    publish_time: int
    data: bytes


@dataclass(slots=True)
class TopicInfo:
    """A topic of a bag: its type, definition text, number of messages, offered QoS (YAML text) and type hash."""

    name: str
    type: str
    definition: str
    count: int = 0
    qos: str = ""
    type_hash: str = ""
    encoding: str = "cdr"
    schema_encoding: str = "ros2msg"

    @classmethod
    def of(cls, channel: Channel, schema: Schema | None) -> Self:
        """From the records of a file."""
        return cls(
            channel.topic,
            schema.name if schema else "",
            schema.data.decode("utf-8", "replace") if schema else "",
            qos=channel.metadata.get("offered_qos_profiles", ""),
            type_hash=channel.metadata.get("topic_type_hash", ""),
            encoding=channel.message_encoding,
            schema_encoding=schema.encoding if schema else "",
        )

    @property
    def readable(self) -> bool:
        """Whether its messages are CDR with a ros2msg definition."""
        return self.encoding == "cdr" and self.schema_encoding == "ros2msg"

    def decoder(self) -> Decoder:
        """Function from this topic's bytes to a namespace with the message's fields.

        Raises:
            BagError: if messages or definition are in another encoding than CDR and ros2msg.
        """
        self._must_be_readable()
        return decoder(self.type, self.definition)

    def outliner(self) -> Outliner:
        """For many of this topic's messages at once, see ``Block``.

        Raises:
            BagError: as ``decoder``.
        """
        self._must_be_readable()
        return outliner(self.type, self.definition)

    def _must_be_readable(self) -> None:
        if not self.readable:
            have = f"{self.encoding} with a {self.schema_encoding or 'missing'} definition"
            raise BagError(f"topic {self.name} is {have}: only cdr with ros2msg can be decoded")
