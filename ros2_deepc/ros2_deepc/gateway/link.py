# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""What every protocol offers to the engine, and how one is chosen."""

from typing import Protocol

from .assemble import Scan
from .errors import GatewayError
from .extras import with_extra
from .tags import Array, TagMap

_LINKS = {"modbus": ("modbus_link", "ModbusLink"), "opcua": ("opcua_link", "OpcuaLink")}


class Link(Protocol):
    """A connection to one field device. All methods run in the engine's event loop and raise LinkError when they fail.

    Attributes:
        atomic: whether one ``read`` is one request, so that its values belong together.
    """

    atomic: bool

    async def connect(self) -> None:
        """Connects; tags that do not exist are an error here."""

    async def read(self) -> Scan:
        """Reads every tag once."""

    async def write(self, raw: Array) -> None:
        """Writes raw numbers in the order of ``TagMap.writes``; NaN = leave alone."""

    async def close(self) -> None:
        """Disconnects; never fails, may be called twice."""


def make_link(tags: TagMap) -> Link:
    """The link that a tag map asks for; ROS topics need the node and are made there.

    Raises:
        MissingExtraError: if the protocol's package is not installed.
        GatewayError: if the protocol cannot be used from here.
    """
    if tags.kind not in _LINKS:
        raise GatewayError(f"{tags.file}: a link of kind {tags.kind} works inside the gateway's node only")
    module, name = _LINKS[tags.kind]
    link: Link = getattr(with_extra(tags.kind, module), name)(tags)
    return link
