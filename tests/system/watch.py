# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Prints what goes over the topics of a zone, one line of JSON a message, until it is terminated.

python tests/system/watch.py NAMESPACE
"""

import json
import sys

from deepc_msgs.msg import ControllerState

from ros2_deepc.nodes.observer import Observer
from ros2_deepc.ros.run import Spinner, make_executor, on_signal, ros
from ros2_deepc.ros.wire import Reading


def facts(msg):
    """What a test asks for."""
    if isinstance(msg, Reading):
        return {"topic": "outputs", "k": int(msg.k), "held": int(msg.held), "epoch": int(msg.epoch)}
    if isinstance(msg, ControllerState):
        size = {"rank": int(msg.rank), "rank_need": int(msg.rank_need)}
        return {"topic": "state", "k": int(msg.k), "mode": int(msg.mode), "reason": msg.reason, **size}
    return {"topic": "report", "k": int(msg.k), "verdict": int(msg.r_observability.verdict)}


def main():
    """Watches until SIGINT or SIGTERM."""
    with ros([]) as context:
        observer = Observer(context=context, namespace=sys.argv[1], use_global_arguments=False)
        executor = make_executor("events", context)
        executor.add_node(observer)
        spinner, last = Spinner(executor), {}

        def tell():
            for name in ("outputs", "state", "report"):
                msg = getattr(observer, name)
                if msg is not None and last.get(name) is not msg:
                    last[name] = msg
                    print(json.dumps(facts(msg)), flush=True)  # noqa: T201

        observer.on_change = tell
        with on_signal(spinner.wake) as signals:
            spinner.until(lambda: bool(signals))
        executor.shutdown()
        observer.destroy_node()


if __name__ == "__main__":
    main()
