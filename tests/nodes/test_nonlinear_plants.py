# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The nonlinear plants on ROS: the bits of the loop without ROS, and of every replay, EPANET included."""

import numpy as np
import pytest

from ros2_deepc.bags import replay
from ros2_deepc.bags.cores import ControllerCore, MonitorCore
from ros2_deepc.bags.run import loop_hash
from ros2_deepc.control.modes import Mode
from ros2_deepc.nodes.controller_node import make_agent, state_message
from ros2_deepc.nodes.monitor_node import make_live, report_message

STEPS = {"wscc9_swing": 260, "net3_epanet": 170}  # a second after the load step, five hours under control


@pytest.mark.parametrize("plant", ["wscc9_swing", "net3_epanet"])
def test_a_run_has_the_bits_of_the_pure_loop_and_replays_to_the_bit(demo, pure_loop, parameters_of, plant):
    changes = {"plant": {"seed": 3, "steps": STEPS[plant]}, "controller": {"seed": 3}, "monitor": {"period": 50}}
    parameters = parameters_of(plant, changes)
    pure = pure_loop(parameters)
    summary, recorded, out = demo(plant, changes=changes)
    assert summary["loop_hash"] == loop_hash(pure.u, pure.y)
    np.testing.assert_array_equal(recorded.y, pure.y)
    assert pure.decisions[-1].mode is Mode.CONTROLLING
    cores = {
        "controller": lambda info: ControllerCore(make_agent(parameters["controller"], info), state_message),
        "monitor": lambda info: MonitorCore(make_live(parameters["monitor"], info), report_message),
    }
    again = replay(out / "bag", cores)
    assert again.same, again.differences
    assert again.loop_hash == summary["loop_hash"]
