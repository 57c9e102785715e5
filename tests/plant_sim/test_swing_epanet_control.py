# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The nonlinear plants under the shipped controller settings, the watch over badly set loops, what the monitors say."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from plant_sim.epanet_plant import net3_epanet
from plant_sim.plant_node import parse_options, plant_info
from plant_sim.swing_plant import wscc9_swing
from ros2_deepc.control import DeepcController
from ros2_deepc.control.excitation import Excitation
from ros2_deepc.control.loop import run_loop
from ros2_deepc.control.modes import Mode
from ros2_deepc.monitors import Prior, Verdict, analyze
from ros2_deepc.nodes.config import load, merged
from ros2_deepc.nodes.controller_node import make_agent, settings_for
from ros2_deepc.ros.plants import as_number

CONFIG = Path(__file__).parents[2] / "launch_scripts" / "config"
MAKERS = {"wscc9_swing": wscc9_swing, "net3_epanet": net3_epanet}
STEADY = {"demand": "constant", "outputs": "level:3"}
ONE = {"Q": [1.0], "trip_min": [6.5], "trip_max": [10.3]}


def run(name, seed, options=None, **controller):
    """A shipped run with changes, without ROS."""
    parameters = merged(load(CONFIG / f"{name}.yaml"), {"controller": controller})
    given = {key: as_number(value) for key, value in parse_options(parameters["plant"]["options"]).items()}
    plant = MAKERS[name](**(given | (options or {})))
    agent = make_agent(parameters["controller"] | {"seed": seed}, plant_info(plant, 1, lockstep=True))
    for k, values in plant.references:
        agent.references.set(k, values)
    stepper = plant.start(seed)
    return run_loop(agent, stepper, parameters["plant"]["steps"]), stepper


def modes(loop):
    return {decision.mode for decision in loop.decisions}


def rmse(y):
    """Over the last 40 samples of both phases [m]."""
    return max(np.sqrt(np.mean((y[a:b, 0] - goal) ** 2)) for a, b, goal in ((235, 275, 9.4), (360, 400, 9.2)))


@pytest.mark.parametrize("seed", [0, 1])
def test_a_load_step_is_answered_within_seconds(seed):
    loop, stepper = run("wscc9_swing", seed)
    after = 1e3 * np.abs(loop.y[250:]).max(axis=1)  # mHz
    assert after.max() < 90  # 82 is reached before an input can answer
    assert after[15:].max() < 8
    assert after[100:].max() < 1
    assert np.abs(1e3 * loop.y[350:].mean(axis=0)).max() < 0.1
    assert modes(loop) == {Mode.COLLECTING, Mode.CONTROLLING}
    assert stepper.residual < 1e-10
    assert np.abs(loop.u[:200]).max() <= 0.05


def test_the_absolute_form_leaves_half_of_the_load_step():
    loop, _ = run("wscc9_swing", 0, form="absolute", trip_error=np.inf)
    assert 80 < 1e3 * np.abs(loop.y[350:]).max() < 125


def test_a_larger_step_and_a_turbine_lag():
    loop, _ = run("wscc9_swing", 0, {"events": "load 9 +0.6 @ 250", "limit": 1.0}, amplitude=0.05)
    assert 1e3 * np.abs(loop.y[265:]).max() < 8
    assert modes(loop) == {Mode.COLLECTING, Mode.CONTROLLING}
    loop, _ = run("wscc9_swing", 0, {"lag": 0.5}, amplitude=0.4)
    assert 1e3 * np.abs(loop.y[265:]).max() < 8
    assert modes(loop) == {Mode.COLLECTING, Mode.CONTROLLING}


def test_transfers_cannot_move_the_frequency():
    loop, _ = run("wscc9_swing", 0, {"inputs": "transfers"}, trip_error=np.inf)
    assert 1e3 * np.abs(loop.y[350:]).min() > 190


@pytest.mark.parametrize("seed", [0, 1])
def test_the_tank_follows_at_constant_demand(seed):
    loop, stepper = run("net3_epanet", seed, STEADY, **ONE)
    assert rmse(loop.y) < 0.01
    assert stepper.log == []


@pytest.mark.parametrize("seed", [0, 1])
def test_the_tank_follows_at_diurnal_demand_that_is_measured(seed):
    loop, _ = run("net3_epanet", seed)
    assert np.ptp(loop.y[:, 1]) > 0.1
    assert rmse(loop.y) < 0.06
    assert modes(loop) == {Mode.COLLECTING, Mode.CONTROLLING}


def test_the_tank_follows_with_a_demand_forecast():
    plant = net3_epanet(demand="diurnal")
    parameters = load(CONFIG / "net3_epanet.yaml")["controller"] | {"Q": [1.0], "T": 200}
    base = settings_for(parameters, plant_info(plant, 1, lockstep=True))
    settings = type(base)(**{name: getattr(base, name) for name in base.__slots__} | {"disturbances": 1})
    controller, stepper = DeepcController(2, 1, settings), plant.start(0)
    signal = Excitation("uniform", plant.input_min, plant.input_max, np.random.Generator(np.random.PCG64([0, 1])))
    u, outputs = signal.next(), []
    for k in range(400):
        y = stepper.push(u)
        controller.observe(u, y, stepper.forecast(k, 1)[0])
        outputs.append(y)
        ahead = stepper.forecast(k + 1, settings.L)
        u = controller.step(plant.reference(k + 1), ahead).u if controller.ready else signal.next()
    assert rmse(np.array(outputs)) < 0.06


def test_a_grid_loop_that_has_overfitted_its_noise_ends_in_the_fallback_within_its_limits():
    bad = {"N": 20, "q": 20, "T": 190, "cut": "none", "R": [1e-6]}
    loop, _ = run("wscc9_swing", 0, **bad)
    assert loop.decisions[-1].mode is Mode.FALLBACK
    assert np.abs(loop.y).max() < 0.3
    assert np.abs(loop.u[-1]).max() == 0.0  # the ramp has reached the safe input


def test_a_water_loop_that_has_overfitted_its_noise_ends_in_the_fallback_within_its_limits():
    bad = {"N": 6, "q": 6, "T": 73, "cut": "none", "R": [1e-8]}
    loop, stepper = run("net3_epanet", 0, STEADY | {"noise": 0.01}, **ONE, **bad)
    assert loop.decisions[-1].mode is Mode.FALLBACK
    assert stepper.log == []
    np.testing.assert_allclose(loop.u[-1], [0.6, 1.0])


@pytest.fixture(scope="module")
def probed():
    """Inputs, outputs and noise of a grid that is probed after a passing load step."""

    @cache
    def record(inputs, noise):
        pulse = "load 9 +0.3 @ 2; load 9 -0.3 @ 25"
        plant = wscc9_swing(inputs=inputs, outputs="f_1 f_2 f_3 theta_1", events=pulse, noise=noise)
        u = 0.05 * np.random.Generator(np.random.PCG64([0, 1])).uniform(-1, 1, (630, 3))
        stepper = plant.start(0)
        y = np.array([stepper.push(row) for row in u])
        std = np.where(np.array(plant.output_units) == "Hz", noise / (2 * np.pi), noise)
        return u[30:], y[30:], std

    return record


@pytest.mark.parametrize("inputs", ["machines", "transfers"])
def test_sines_are_not_taken_for_a_linear_plant(probed, inputs):
    u, y, _ = probed(inputs, 1e-4)
    for noise in (0.0, None):
        report = analyze(u, y, prior=Prior(q=6, s=1), noise=noise)
        assert report.r_controllability.verdict is Verdict.PRIOR_VIOLATED


@pytest.mark.parametrize("noise", [1e-4, 1e-3])
def test_the_monitors_name_the_mode_that_transfers_cannot_move(probed, noise):
    u, y, std = probed("transfers", noise)
    report = analyze(u, y, prior=Prior(q=6, s=1), noise=std)
    finding = report.r_controllability
    assert finding.verdict is Verdict.NOT_PROVED
    assert abs(finding.lambda_star - 1) < 1e-3
    assert finding.margin < -15
    assert report.r_observability.verdict is Verdict.PROVED


def test_an_input_at_each_machine_is_proved_where_the_noise_allows(probed):
    u, y, std = probed("machines", 3e-5)
    assert analyze(u, y, prior=Prior(q=6, s=1), noise=std).r_controllability.verdict is Verdict.PROVED
