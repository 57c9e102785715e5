# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The agent on plants of index 1, 2 and 3: it learns true data and controls, with samples lost on the way."""

import numpy as np
import pytest

from plant_sim import net3, random_system, wscc9
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


@pytest.mark.parametrize("s", [1, 2, 3])
@pytest.mark.parametrize("seed", range(4))
def test_a_late_command_acts_later_and_leaves_the_data_true(s, seed):
    plant, agent = plant_and_agent(s, seed, max_gap=4)
    rng = np.random.Generator(np.random.PCG64(seed))
    commands = dict(enumerate(agent.start()))
    due = dict.fromkeys(commands, 0)  # instants at which they reach the plant, which takes the newest that has come
    newest, k = 0, 0
    for j in range(260):
        newest = max(i for i in commands if i <= j and due[i] <= j)
        y = plant.push(commands[newest])
        if y is None:
            continue
        if rng.random() > 0.02:  # else these outputs are lost, and with them how old the input was
            decision = agent.step(k, y, j - newest)
            if decision.u is not None:
                commands[k + s] = decision.u
                due[k + s] = k + s + int(rng.choice(4, p=[0.4, 0.2, 0.2, 0.2]))
        k += 1
    controller = agent.controller
    assert controller.missing() == "" or "unbroken" in controller.missing()
    clean_plant, clean = plant_and_agent(s, seed)
    run_loop(clean, clean_plant, 120)
    assert controller.rank == clean.controller.rank  # a false sample would raise it
    assert controller.gap > 1e6


def test_inputs_without_effect_go_to_zero_and_redundant_ones_approach_the_least():
    plant = net3()
    agent = agent_for(plant)
    loop = run_loop(agent, plant.start(0), 150)
    assert np.abs(loop.u[-1, [0, 2]]).max() < 1e-6  # both reservoirs
    planted = random_system(m=3, p=1, q=3, radius=(0.3, 0.8), seed=5)
    settings = DeepcSettings(N=4, L=10, q=3, Q=1.0, R=0.1, u_min=-5.0, u_max=5.0)
    agent = Agent(3, 1, settings, 0)
    agent.references.set(0, np.ones(1))
    loop = run_loop(agent, LinearStepper(planted.system.weierstrass(), np.ones(3)), 400)
    sizes = np.linalg.norm(loop.u[100::50], axis=1)
    assert (np.diff(sizes) < -0.01).all()
    assert np.abs(loop.y[100:] - 1).max() < 1e-5


def agent_for(plant, **changes):
    limits = {"q": plant.prior.q, "u_min": plant.input_min, "u_max": plant.input_max}
    agent = Agent(
        len(plant.input_names), len(plant.output_names), DeepcSettings(**{**plant.settings, **limits, **changes}), 0
    )
    for start, values in plant.references:
        agent.references.set(start, values)
    return agent


@pytest.mark.parametrize(
    ("plant", "blamed", "mask"),
    [
        (wscc9(), (1.0,), [1, 0]),  # the conserved quantity; x1 moves
        (wscc9(), (0.5 + 0.1j,), [1, 1]),  # decays by itself
        (wscc9(variant="full"), (1.0,), [1, 1]),  # inputs make up for a constant
        (net3(hour=5), (1.0, 1.0), [0, 1]),  # the reservoir; the tank shares its mode, yet the pumps move it
    ],
    ids=["conserved", "decays", "compensated", "reservoir"],
)
def test_an_output_that_cannot_be_held_is_not_chased(plant, blamed, mask):
    agent = agent_for(plant, solver="daqp", terminal="equilibrium")
    T = agent.controller._sized.T
    agent.blame(10, blamed)  # a report while collecting is kept
    loop = run_loop(agent, plant.start(0), T + 10)
    assert agent.mode is Mode.CONTROLLING
    assert agent.controller.mask.tolist() == mask
    off = np.abs(loop.decisions[-1].result.goal[-1] - loop.decisions[-1].result.y_steady)
    assert loop.decisions[-1].result.distance == pytest.approx(off[np.array(mask, dtype=bool)].max())
    assert agent.settings.mask == 1.0  # what the operator set stays


def test_reported_modes_count_from_their_sample_until_there_are_others():
    plant, agent = wscc9(), agent_for(wscc9(), solver="daqp")
    stepper, (u,), masks = plant.start(0), agent.start(), []
    for k in range(116):
        if k == 108:
            agent.blame(110, [1.0])
            agent.blame(113, [])
        u = agent.step(k, stepper.push(u)).u
        agent.prepare()
        masks.append(agent.controller.mask.tolist())
    assert masks[109:] == [[1, 1]] + 3 * [[1, 0]] + 3 * [[1, 1]]
    agent.blame(116, [1.0])
    agent.tune(mask=[0.5, 0.5])
    agent.step(116, stepper.push(u))
    assert agent.controller.mask.tolist() == [0.5, 0]


@pytest.mark.parametrize("mode", [1.02, np.exp(0.3j)])
def test_a_lasting_mode_beside_one_leaves_its_outputs_without_steady_state(mode):
    """A pair of outputs, one of which sees an uncontrollable mode that grows or swings for ever."""
    B, C = np.ones((2, 1)), np.array([[1.0, 1.0], [1.0, -1.0]])
    rotation = [[mode]] if np.isreal(mode) else [[mode.real, -mode.imag], [mode.imag, mode.real]]
    r = len(rotation)
    A = np.block([[np.diag([0.5, 0.7]), np.zeros((2, r))], [np.zeros((r, 2)), np.array(rotation)]])
    B, C = np.vstack([B, np.zeros((r, 1))]), np.hstack([C, np.array([[1.0], [0.0]]) * np.eye(1, r)])
    settings = DeepcSettings(N=6, L=9, q=2 + r, u_min=-1.0, u_max=1.0, terminal="none")
    agent, x = Agent(1, 2, settings, 0), np.ones(2 + r)
    agent.references.set(0, [0.0, 0.0])
    agent.blame(0, [mode])
    (u,) = agent.start()
    for k in range(60):
        y, x = C @ x, A @ x + B @ u
        u = agent.step(k, y).u
    assert agent.mode is Mode.CONTROLLING
    assert agent.controller.mask.tolist() == [0, 1]


def test_noise_does_not_make_a_still_output_look_moved():
    plant, rng = wscc9(), np.random.Generator(np.random.PCG64(4))
    agent = agent_for(plant, noise=1e-2, T=300)
    agent.blame(0, [1.0])
    stepper, (u,) = plant.start(0), agent.start()
    for k in range(310):
        u = agent.step(k, stepper.push(u) + 1e-2 * rng.standard_normal(2)).u
    assert agent.controller.mask.tolist() == [1, 0]


def disturbed(s, d, told, steps=200, **how):
    """The loop on a plant whose third input is a disturbance; ``told(agent, k)`` says what is known of it."""
    form = random_system(m=3, p=2, q=4, blocks=(s, 1) if s > 1 else (), seed=6).system.weierstrass()
    settings = DeepcSettings(
        N=6, L=10, q=4, s=s, T=160, u_min=-1.0, u_max=1.0, disturbances=1, terminal="none", solver="daqp"
    )
    agent, plant = Agent(2, 2, settings, 1, **how), LinearStepper(form, np.ones(4))
    agent.references.set(0, [0.5, 0.0])
    inputs, errors, k = agent.start(), [], 0
    for j in range(steps):
        y = plant.push(np.append(inputs[j], d[j]))
        if y is None:
            continue
        told(agent, k)
        decision = agent.step(k, y)
        inputs.append(decision.u)
        if decision.result is not None:
            copy = LinearStepper(form, plant.z1)
            ahead = np.vstack([*inputs[k + 1 : k + s], decision.result.u_plan])
            moved = [copy.push(np.append(v, d[k + 1 + i])) for i, v in enumerate(ahead)]
            exact = np.array([out for out in moved if out is not None])
            errors.append(np.abs(decision.result.y_plan - exact).max())
        k += 1
    return agent, np.array(errors)


@pytest.mark.parametrize("s", [1, 2])
def test_measured_disturbances_and_their_forecast_make_predictions_exact(s):
    d = np.sin(np.arange(300) / 7) + 0.3 * np.cos(np.arange(300) / 3)
    agent, errors = disturbed(s, d, lambda agent, k: agent.disturbances.set(k, d[k : k + 20, None]))
    assert len(errors) > 30
    assert errors.max() < 1e-7
    assert agent.lost == 0
    _, blind = disturbed(s, d, lambda agent, k: agent.disturbances.set(k, d[k : k + 1]))
    assert blind.max() > 1e-2  # without a forecast the last value is taken to stay


def test_a_sample_without_its_measured_disturbance_counts_as_lost():
    d = np.random.Generator(np.random.PCG64(2)).uniform(-1, 1, 300)

    def told(agent, k):
        if k != 195:
            agent.disturbances.set(k, d[k : k + 1])

    agent, _ = disturbed(1, d, told)
    assert agent.lost == 1
    assert agent.mode is Mode.HOLDING
    for values, text in (([1.0, 2.0], "give"), ([np.nan], "not finite")):
        with pytest.raises(ValueError, match=text):
            agent.disturbances.set(300, values)


def test_with_a_preview_the_plan_follows_references_that_are_known_to_come():
    plans = []
    for preview in (False, True):
        form = random_system(m=2, p=2, q=3, seed=1).system.weierstrass()
        settings = DeepcSettings(N=5, L=6, q=3, R=0.1, u_min=-1.0, u_max=1.0, terminal="none", solver="daqp")
        agent = Agent(2, 2, settings, 1, preview=preview)
        agent.references.set(0, [0.0, 0.0])
        agent.references.set(64, [0.5, 0.0])
        plans.append(run_loop(agent, LinearStepper(form, np.ones(3)), 61).decisions[-1].result)
    assert np.unique(plans[0].goal, axis=0).tolist() == [[0.0, 0.0]]
    assert plans[1].goal[:, 0].tolist() == [0, 0, 0, 0.5, 0.5, 0.5]
    assert np.abs(plans[1].u_plan).max() > np.abs(plans[0].u_plan).max()


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


def test_references_that_move_for_ever_take_no_room():
    _, agent = plant_and_agent(1, 0)
    agent.start()
    for k in range(500):
        agent.references.set(k, [0.001 * k, 0.0])
        agent.references.set(k + 1, [0.001 * (k + 1), 0.0])
        decision = agent.step(k, np.zeros(2))
        np.testing.assert_array_equal(decision.reference, [0.001 * k, 0.0])
        assert len(agent.references) == 2
    agent.references.set(3, [9.0, 9.0])  # late: what holds now began after it
    np.testing.assert_array_equal(agent.references.at(499), [0.499, 0.0])
