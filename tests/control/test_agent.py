# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The agent on plants of index 1, 2 and 3: it learns true data and controls, with samples lost on the way."""

import numpy as np
import pytest

from plant_sim import random_system
from plant_sim.stepper import LinearStepper
from ros2_deepc.control import DeepcSettings
from ros2_deepc.control.agent import Agent
from ros2_deepc.control.loop import run_loop
from ros2_deepc.control.modes import REQUESTS, Mode, Safety, refusal


def plant_and_agent(s, seed, **safety):
    planted = random_system(m=2, p=2, q=3, blocks=(s,), seed=seed)
    form = planted.system.weierstrass()
    settings = DeepcSettings(N=5, L=6, q=3, s=s, Q=1.0, R=0.1, u_min=-1.0, u_max=1.0, terminal="none")
    agent = Agent(2, 2, settings, seed, Safety(**safety))
    agent.references.set(0, np.zeros(2))
    return LinearStepper(form, np.ones(form.q)), agent


@pytest.mark.parametrize("s", [1, 2, 3])
@pytest.mark.parametrize("seed", range(4))
def test_the_loop_controls_plants_of_any_index(s, seed):
    plant, agent = plant_and_agent(s, seed)
    loop = run_loop(agent, plant, 120)
    assert [d.mode for d in loop.decisions[-20:]] == [Mode.CONTROLLING] * 20
    assert agent.failures == agent.lost == 0
    controller = agent.controller
    assert controller.gap > 1e6
    assert loop.u.shape == (120 + s - 1, 2)


@pytest.mark.parametrize("s", [1, 2, 3])
@pytest.mark.parametrize("seed", range(3))
def test_lost_samples_and_held_inputs_leave_the_data_true(s, seed):
    plant, agent = plant_and_agent(s, seed, max_gap=4)
    rng = np.random.Generator(np.random.PCG64(seed))
    commands = dict(enumerate(agent.start()))
    last, held, k = None, 0, 0
    for j in range(260):
        u = commands.get(j)
        u, held = (u, 0) if u is not None else (last, held + 1)
        last = u
        y = plant.push(u)
        if y is None:
            continue
        lost = rng.random() < 0.05
        if not lost:
            decision = agent.step(k, y, held)
            late = rng.random() < 0.05
            if decision.u is not None and not late:
                commands[k + s] = decision.u
        k += 1
    controller = agent.controller
    assert agent.lost > 0
    assert controller.missing() == "" or "unbroken" in controller.missing()
    clean_plant, clean = plant_and_agent(s, seed)
    run_loop(clean, clean_plant, 120)
    assert controller.rank == clean.controller.rank  # a false sample would raise it
    assert controller.gap > 1e6


def test_reset_gives_the_run_a_fresh_start():
    plant, agent = plant_and_agent(1, 0)
    run_loop(agent, plant, 100)
    assert agent.mode is Mode.CONTROLLING
    assert agent.request(Mode.COLLECTING) == ""
    assert agent.controller.window_length == 0


@pytest.mark.parametrize("now", list(Mode))
@pytest.mark.parametrize("wanted", [*range(6), 6, 255])
def test_every_request_is_taken_or_explained(now, wanted):
    why = refusal(now, wanted)
    allowed = wanted < 6 and now in REQUESTS.get(Mode(wanted), frozenset())
    assert (why == "") == allowed
    assert "\n" not in why


@pytest.mark.parametrize(("name", "value"), [("max_gap", -1), ("max_hold", 0), ("ramp", 0), ("fallback", "panic")])
def test_safety_settings_that_cannot_work(name, value):
    with pytest.raises(ValueError, match=name):
        Safety(**{name: value})
