# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""A look at the topics of a tag map, for `ros2-deepc gateway --check`."""

import asyncio
import time

from rclpy.node import Node

from ..ros.run import Spinner, make_executor, ros
from .assemble import Quality, Scan
from .ros_link import RosLink
from .tags import TagMap

_DISCOVERY = 2.0  # [s] that publishers may need to be found


def listen(tags: TagMap, namespace: str) -> Scan:
    """The newest number of every tag; BAD for those that stayed silent for the time after which they are stale."""
    with ros([]) as context:
        node = Node("gateway_check", namespace=namespace, context=context, use_global_arguments=True)
        executor = make_executor("single", context)
        executor.add_node(node)
        link = RosLink(tags, node)
        end = time.monotonic() + _DISCOVERY + tags.supervision.stale_after

        def all_there() -> bool:
            return time.monotonic() > end or not (_read(link).quality == Quality.BAD).any()

        try:
            Spinner(executor).until(all_there)
            return _read(link)
        finally:
            executor.shutdown()
            link.destroy()
            node.destroy_node()


def _read(link: RosLink) -> Scan:
    return asyncio.run(link.read())
