# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The mirror behind OPC UA, namespace ``urn:ros2_deepc:mirror``. Arrays keep the order of the tag map.

| node | what |
|---|---|
| `state`, `reason` | of the gateway |
| `epoch`, `k` | of the newest sample |
| `outputs`, `inputs`, `reference` | newest values |
| `output_names`, `input_names` | of the tag map |
| `round_trip` | [s] |
| `refused` | commands refused since the start |
| `mode` | of the controller |
| `r_controllability`, `c_controllability`, `r_observability`, `c_observability` | verdicts |
"""

import os
from pathlib import Path

from .errors import GatewayError
from .opcua_server import Access, OpcuaServer
from .tags import TagMap

URI = "urn:ros2_deepc:mirror"


def window(tags: TagMap) -> OpcuaServer:
    """The server of a tag map's section ``serve``: encrypted and for one user, unless that says otherwise.

    Raises:
        GatewayError: if the password is missing.
    """
    serve = tags.serve
    assert serve is not None
    access = Access()
    if not serve.insecure:
        password = os.environ.get(serve.password_env, "")
        if not password:
            raise GatewayError(f"{tags.file}: the environment variable {serve.password_env} is not set")
        access = Access(users={serve.user: password}, pki=Path(tags.file).parent / serve.pki)
    return OpcuaServer(tags.plant.name, URI, serve.url, access)
