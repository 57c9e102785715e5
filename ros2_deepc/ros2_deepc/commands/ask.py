# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""`ros2-deepc ask`: the services of a zone by short names, for machines without ROS's own command line."""

import time
from typing import Annotated, Any

import typer
from deepc_msgs.msg import ControllerState
from deepc_msgs.srv import SetMode
from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

from ..ros.parameters import ConfigError
from ..ros.run import Spinner, make_executor, ros

_PATIENCE = 10.0  # [s] for the service to be found, and again for its answer

REQUESTS: dict[str, tuple[str, Any, dict[str, Any], str]] = {
    "auto": ("gateway/auto", SetBool, {"data": True}, "the gateway passes commands on"),
    "no-auto": ("gateway/auto", SetBool, {"data": False}, "the gateway writes nothing any more (SHADOW)"),
    "acknowledge": ("gateway/acknowledge", Trigger, {}, "the gateway leaves its FALLBACK"),
    "new-data": ("gateway/new_data", Trigger, {}, "the gateway forgets the round trip of the old data"),
    "reset": ("controller/reset", Trigger, {}, "the controller collects data anew"),
    **{
        mode.lower(): ("controller/set_mode", SetMode, {"mode": getattr(ControllerState, mode)}, f"controller: {mode}")
        for mode in ("COLLECTING", "CONTROLLING", "FALLBACK", "SHADOW")
    },
}


def ask(
    request: Annotated[str, typer.Argument(help=", ".join(REQUESTS) + ".")],
    namespace: Annotated[str, typer.Option(help="Namespace of the zone.")] = "/",
) -> None:
    """Ask the gateway or the controller of a zone for something; exit code 1 if it refuses.

    Examples:
      ros2-deepc ask auto                          (ros2 service call /gateway/auto std_srvs/srv/SetBool "{data: true}")
      ros2-deepc ask acknowledge --namespace /grid
    """
    if request not in REQUESTS:
        known = "; ".join(f"{name}: {words}" for name, (*_, words) in REQUESTS.items())
        raise ValueError(f"nothing is called {request!r}. {known}")
    service, kind, fields, _ = REQUESTS[request]
    accepted, message = call(service, kind, kind.Request(**fields), namespace)
    typer.echo(message)
    raise typer.Exit(0 if accepted else 1)


def call(service: str, kind: Any, request: Any, namespace: str) -> tuple[bool, str]:
    """Calls a service that answers with success and message.

    Raises:
        ConfigError: if it is not there, or does not answer.
    """
    with ros([]) as context:
        node = Node("deepc_ask", context=context, namespace=namespace, use_global_arguments=False)
        executor = make_executor("single", context)
        executor.add_node(node)
        client = node.create_client(kind, service)
        spinner = Spinner(executor)

        def waited(done: Any, what: str) -> None:
            end = time.monotonic() + _PATIENCE
            spinner.until(lambda: bool(done()) or time.monotonic() > end)
            if not done():
                raise ConfigError(f"{what} {client.service_name}: is the node running, in this namespace and domain?")

        try:
            waited(client.service_is_ready, "there is no service")
            future = client.call_async(request)
            waited(future.done, "no answer from")
            answer = future.result()
            return bool(answer.success), str(answer.message)
        finally:
            executor.shutdown()
            node.destroy_node()
