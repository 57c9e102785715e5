# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""`ros2-deepc record`: the recorder alone, beside a zone that runs elsewhere."""

import tempfile
from pathlib import Path
from typing import Annotated

import typer

from ..nodes.config import text_of
from ..nodes.recorder_node import RecorderNode
from ..ros.run import run_node

MaxSize = Annotated[float, typer.Option(help="Start a new file of the bag after this many MB; 0 = never.", min=0)]
MaxDuration = Annotated[float, typer.Option(help="Start a new file of the bag after this many s; 0 = never.", min=0)]


def record(
    out: Annotated[Path, typer.Argument(help="Folder of the bag; must not exist yet.")],
    namespace: Annotated[str, typer.Option(help="Namespace of the zone.")] = "/",
    max_size: MaxSize = 0.0,
    max_duration: MaxDuration = 0.0,
    attach: Annotated[
        list[Path] | None,
        typer.Option(help="File to keep in the bag; settings.yaml is what replay looks for; repeatable."),
    ] = None,
) -> None:
    """Record every topic of a zone until Ctrl-C or SIGTERM.

    Examples:
      ros2-deepc record today --namespace /grid --attach settings.yaml
      ros2-deepc record long --max-duration 3600
    """
    parameters = {
        "folder": str(out),
        "max_size": max_size,
        "max_duration": max_duration,
        "attach": [str(path) for path in attach or []] or [""],
    }
    with tempfile.NamedTemporaryFile("w", suffix=".yaml") as file:
        file.write(text_of({"recorder": parameters}))
        file.flush()
        code = run_node(RecorderNode, ["--ros-args", "--params-file", file.name, "-r", f"__ns:={namespace}"])
    if code:
        raise typer.Exit(code)
