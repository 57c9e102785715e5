# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The two networks of the paper, closed loop, against their reference results."""

import numpy as np
import pytest

from plant_sim import net3, wscc9
from ros2_deepc.control import DeepcController, DeepcSettings, Status


def run(plant, seed, **changes):
    """Outputs and results of the paper's run: white inputs in U while k < T, then DeePC."""
    settings = DeepcSettings(
        **{**plant.settings, "q": plant.prior.q, "u_min": plant.input_min, "u_max": plant.input_max, **changes}
    )
    rng = np.random.Generator(np.random.PCG64([seed, 1]))
    controller = DeepcController(len(plant.input_names), len(plant.output_names), settings)
    stepper, outputs, results = plant.start(seed), [], []
    u = rng.uniform(plant.input_min, plant.input_max)
    for k in range(plant.steps):
        y = stepper.push(u)
        outputs.append(y)
        controller.observe(u, y)
        reference = [values for start, values in plant.references if start <= k + 1][-1]
        if controller.ready:
            results.append(controller.step(reference))
            u = results[-1].u
        else:
            u = rng.uniform(plant.input_min, plant.input_max)
    assert len(results) == plant.steps - controller.settings.T + 1  # ready as soon as T inputs are in, for good
    return np.array(outputs), results, controller


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.parametrize("solver", ["osqp", "daqp"])
@pytest.mark.parametrize("seed", range(10))
def test_grid_follows_what_transfers_can_move(seed, solver):
    y, results, controller = run(wscc9(), seed, solver=solver)
    assert rms(y[131:151, 0] - 3) < 0.035
    assert rms(y[180:200, 0] - 1) < 0.035
    assert np.ptp(y[:, 1]) < 1e-10
    assert {r.status for r in results} == {Status.SOLVED}
    assert controller.rank == controller.rank_need == 66


@pytest.mark.parametrize("solver", ["osqp", "daqp"])
@pytest.mark.parametrize("seed", range(3))
def test_water_tank_reaches_both_levels_and_the_reservoir_stays(seed, solver):
    y, results, controller = run(net3(hour=5), seed, solver=solver)
    assert np.abs(y[150:160, 1] - 3).max() < 0.01
    assert np.abs(y[190:200, 1] - 5).max() < 0.01
    assert np.abs(y[:, 0] - 4).max() < 1e-9
    assert {r.status for r in results} == {Status.SOLVED}
    assert all(r.feasible for r in results[-10:])
    assert results[-1].distance == pytest.approx(1.0, abs=1e-6)
    # one run excites one ray of the two reservoirs: rank m (N+L) + 4 for ever; Corollary 1 does not need q
    assert (controller.rank, controller.rank_need) == (55, 56)
    assert controller.excitation_order == controller.excitation_need == 22


@pytest.mark.parametrize("solver", ["osqp", "daqp"])
def test_the_printed_terminal_condition_is_infeasible_on_the_water_network(solver):
    _, results, _ = run(net3(hour=5), 0, terminal="hard", solver=solver)
    assert not any(r.feasible for r in results)
    assert [r.violation[0] for r in results] == pytest.approx([1.0] * len(results), abs=1e-6)
    assert all(r.violation[1] > 0.02 for r in results)  # nor can the tank be held without inflow
    assert all("(6.1c) cannot hold" in r.reason for r in results)


@pytest.mark.parametrize("solver", ["osqp", "daqp"])
def test_the_printed_terminal_condition_is_infeasible_on_the_grid(solver):
    _, results, _ = run(wscc9(), 0, terminal="hard", solver=solver)
    assert not any(r.feasible for r in results)
    assert all(r.violation.max() > 0.2 for r in results)


def test_same_run_same_bits():
    first, second = (run(wscc9(), 5)[0] for _ in range(2))
    assert first.tobytes() == second.tobytes()


def test_preparing_early_changes_nothing():
    plant, outputs = wscc9(), []
    for early in (False, True):
        controller = DeepcController(3, 2, DeepcSettings(**plant.settings, q=6, u_min=-1.0, u_max=1.0))
        rng, stepper = np.random.Generator(np.random.PCG64(3)), plant.start(3)
        u, y = rng.uniform(-1, 1, 3), []
        for _ in range(130):
            y.append(stepper.push(u))
            controller.observe(u, y[-1])
            u = controller.step([3.0, 3.0]).u if controller.ready else rng.uniform(-1, 1, 3)
            if early:
                controller.prepare()
        outputs.append(np.array(y))
    assert outputs[0].tobytes() == outputs[1].tobytes()
