# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Replay of a bag through today's nodes' own decisions: which parameters, which parts."""

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from .bags.cores import ControllerCore, MonitorCore
from .bags.errors import BagError
from .bags.reader import BagReader
from .bags.replay import CoreFactory, Replay, replay
from .bags.writer import RUN_METADATA
from .monitors import Prior
from .monitors.live import LiveMonitor
from .nodes.config import Parameters
from .nodes.controller_node import make_agent, state_message
from .nodes.monitor_node import PARAMETERS, report_message


def recorded_parameters(reader: BagReader) -> Parameters:
    """Parameters by role that a bag was recorded with: its metadata, else its attachment, else the file beside it.

    Raises:
        BagError: if there are none.
    """
    text = reader.metadata.get(RUN_METADATA, {}).get("parameters", "")
    if not text:
        text = next((a.data.decode() for a in reader.attachments() if a.name == "parameters.yaml"), "")
    beside = reader.path.parent / "parameters.yaml"
    if not text and beside.is_file():
        text = beside.read_text(encoding="utf-8")
    if not text:
        raise BagError(f"bag {reader.path} does not say with which parameters it was recorded: give a YAML file")
    tree = yaml.safe_load(text)
    return {str(name).rsplit("/", 1)[-1]: dict(body["ros__parameters"]) for name, body in tree.items()}


def recompute(
    bag: str | os.PathLike[str],
    what: str = "all",
    *,
    parameters: Parameters | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,  # noqa: ARG005
) -> Replay:
    """Feeds a bag through today's controller, monitors or both, with the parameters it was recorded with.

    Args:
        bag: folder or file.
        what: "controller", "monitor" or "all".
        parameters: by role; default: those recorded.
        progress: called now and then with messages done and in all.

    Raises:
        BagError: if the bag cannot be read or its parameters are not known.
        ConfigError: if the parameters cannot work.
    """
    reader = BagReader(Path(bag))
    known = recorded_parameters(reader) if parameters is None else parameters
    cores: dict[str, CoreFactory] = {
        "controller": partial(_controller, known.get("controller", {})),
        "monitor": partial(_monitor, known.get("monitor", {})),
    }
    if what != "all" and what not in cores:
        raise BagError(f"recompute {what!r}: choose one of controller, monitor, all")
    return replay(reader, cores if what == "all" else {what: cores[what]}, progress=progress)


def _controller(parameters: dict[str, Any], info: Any) -> ControllerCore:
    return ControllerCore(make_agent(parameters, info), state_message)


def _monitor(parameters: dict[str, Any], info: Any) -> MonitorCore:
    p = {row.name: row.default for row in PARAMETERS} | parameters
    D = np.reshape(info.d, (len(info.output_names), len(info.input_names))) if info.d_known else None
    prior = Prior(q=p["q"] or info.q, s=p["s"] or max(info.s, 1), n=info.n, D=D)
    live = LiveMonitor(prior, window=p["window"], period=p["period"], noise=p["noise"], L=p["L"] or None)
    return MonitorCore(live, report_message)
