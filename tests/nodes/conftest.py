# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Whole zones, in this process or in processes of their own, and the same loop without ROS."""

import numpy as np
import pytest
from rich.console import Console

from ros2_deepc.bags import load_run
from ros2_deepc.control.loop import run_loop
from ros2_deepc.demo import Options, run
from ros2_deepc.nodes.config import load, merged, node_class, shipped
from ros2_deepc.nodes.controller_node import make_agent


@pytest.fixture(scope="session")
def parameters_of():
    """The shipped parameters of a plant, with changes on top."""
    return lambda plant, changes=None: merged(load(shipped(plant)), changes or {})


@pytest.fixture(scope="session")
def pure_loop():
    """Runs parameters without ROS."""

    def go(parameters):
        plant_node = node_class("plant")
        agent = make_agent(parameters["controller"], plant_node.info(parameters["plant"]))
        operator = parameters["operator"]
        values = np.reshape(operator["reference_values"], (len(operator["reference_k"]), -1))
        for k, reference in zip(operator["reference_k"], values, strict=True):
            agent.references.set(k, reference)
        plant = plant_node.plant_of(parameters["plant"]).start(parameters["plant"]["seed"])
        return run_loop(agent, plant, parameters["plant"]["steps"])

    return go


@pytest.fixture
def demo(tmp_path, domain_id, parameters_of):
    """Runs a demo; returns its summary, its recorded run and its folder."""

    def go(plant, *, name="run", changes=None, **options):
        out = tmp_path / name
        where = Options(out=out, namespace=f"/{plant}", domain_id=domain_id, **options)
        summary = run(parameters_of(plant, changes), where, Console(quiet=True))
        return summary, load_run(out / "bag"), out

    return go
