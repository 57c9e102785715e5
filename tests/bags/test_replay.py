# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""A recorded run gives the same answers again, to the bit; what differs is named with its sample, field and size."""

import copy
import json
import subprocess
import sys
import textwrap
from types import SimpleNamespace

import numpy as np
import pytest
from deepc_msgs.msg import MonitorReport

from ros2_deepc.bags import BagError, BagReader, BagWriter, Recording, load_run, replay
from ros2_deepc.bags.compare import first_difference, same
from ros2_deepc.bags.convert import from_cdr, to_cdr
from ros2_deepc.bags.cores import ControllerCore, MonitorCore
from ros2_deepc.bags.figure import draw
from ros2_deepc.bags.replay import REFERENCES
from ros2_deepc.bags.whatif import what_if
from ros2_deepc.control import DeepcController, DeepcSettings
from ros2_deepc.monitors import Prior
from ros2_deepc.monitors.live import LiveMonitor
from ros2_deepc.nodes.controller_node import make_agent, settings_for, state_message
from ros2_deepc.nodes.monitor_node import make_live, report_message
from ros2_deepc.ros import topics

PARAMETERS = {
    "controller": {"N": 3, "L": 5, "Q": [4.0], "R": [0.5], "terminal": "equilibrium", "seed": 11},
    "monitor": {"period": 10, "window": 60},
}
K = 80


def closed_loop(make):
    """The messages of a run of a small plant under the real controller and monitors, in the order of their causes."""
    info = make.plant_info()
    agent = make_agent(PARAMETERS["controller"], info)
    monitor = PARAMETERS["monitor"]
    live = LiveMonitor(Prior(q=2, s=1, n=2), window=monitor["window"], period=monitor["period"])
    A, B = np.array([[0.9, 0.1], [0.0, 0.8]]), np.array([[0.3, 0.0], [0.1, 0.5]])
    messages = [
        ("plant_info", info),
        ("reference", make.sample(50, [0.3, 0.2])),
        ("reference", make.sample(0, [0.5, 0.4])),
    ]
    agent.references.set(0, [0.5, 0.4])
    agent.references.set(50, [0.3, 0.2])
    x, u = np.array([1.0, -1.0]), agent.start()[0]
    messages.append(("inputs", make.sample(0, u)))
    jobs = live.input(0, u)
    for k in range(K):
        messages.append(("outputs", make.sample(k, x)))
        jobs = jobs + live.output(k, x)
        decision = agent.step(k, x)
        state = state_message(agent, decision)
        agent.prepare()
        messages += [("inputs", make.sample(k + 1, decision.u)), ("controller/state", state)]
        messages += [("monitor/report", report_message(report)) for report in map(live.analyse, jobs)]
        x, u = A @ x + B @ u, decision.u
        jobs = live.input(k + 1, u)
    return messages


@pytest.fixture(scope="module")
def loop(make):
    return closed_loop(make)


def write(make, folder, messages):
    make.write_bag(folder, messages)
    return folder


def recompute(bag, part="all", parameters=PARAMETERS, **options):
    """A bag through the controller and monitors that the nodes would make."""
    makers = {
        "controller": lambda info: ControllerCore(make_agent(parameters["controller"], info), state_message),
        "monitor": lambda info: MonitorCore(make_live(parameters["monitor"], info), report_message),
    }
    return replay(bag, makers if part == "all" else {part: makers[part]}, **options)


def test_the_same_again(make, loop, tmp_path):
    bag = write(make, tmp_path / "bag", loop)
    result = recompute(bag)
    assert result.same, result.differences
    assert result.compared == {"inputs": K + 1, "controller/state": K, "monitor/report": K // 10}
    assert result.loop_hash == load_run(bag).loop_hash
    assert (load_run(bag).mode == 2).sum() > 30  # the controller was in control for a good part of it


OTHER = """
    import json, sys
    from ros2_deepc.bags import replay
    from ros2_deepc.bags.cores import ControllerCore, MonitorCore
    from ros2_deepc.nodes.controller_node import make_agent, state_message
    from ros2_deepc.nodes.monitor_node import make_live, report_message
    given = json.loads(sys.argv[2])
    result = replay(sys.argv[1], {
        "controller": lambda info: ControllerCore(make_agent(given["controller"], info), state_message),
        "monitor": lambda info: MonitorCore(make_live(given["monitor"], info), report_message),
    })
    print(result.same, result.loop_hash)
"""


def test_the_same_in_another_process(make, loop, tmp_path):
    bag = write(make, tmp_path / "bag", loop)
    command = [sys.executable, "-c", textwrap.dedent(OTHER), str(bag), json.dumps(PARAMETERS)]
    out = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
    assert out == ["True", load_run(bag).loop_hash]


@pytest.mark.parametrize("seed", range(12))
def test_one_flipped_bit_in_an_input_is_caught_at_that_sample(make, loop, tmp_path, seed):
    rng = np.random.Generator(np.random.PCG64(seed))
    k, channel, bit = int(rng.integers(K)), int(rng.integers(2)), int(rng.integers(64))
    write(make, tmp_path / "good", loop)
    with BagWriter(tmp_path / "bad") as bad:
        for raw in BagReader(tmp_path / "good").messages():
            bad.add_topic(raw.topic, raw.type)
            data = raw.data
            if raw.topic == "/grid/inputs" and (message := from_cdr(data, raw.type)).k == k:
                values = np.array(message.values)
                values.view(np.uint64)[channel] ^= np.uint64(1 << bit)
                message.values = values.tolist()
                data = to_cdr(message)
            bad.write(raw.topic, data, raw.log_time, raw.publish_time)
    result = recompute(tmp_path / "bad", "controller")
    assert not result.same
    assert len(result.differences) == 1
    found = result.differences[0]
    assert (found.topic, found.k, found.field) == ("inputs", k, f"values[{channel}]")
    assert str(found).startswith(f"inputs of epoch 0 k = {k}: values[{channel}] was")


@pytest.mark.parametrize(("role", "name", "value", "topics"), [
    ("controller", "R", [0.5000001], {"inputs", "controller/state"}),
    ("controller", "seed", 12, {"inputs", "controller/state"}),
    ("monitor", "window", 55, {"monitor/report"}),
])  # fmt: skip
def test_other_settings_differ(make, loop, tmp_path, role, name, value, topics):
    bag = write(make, tmp_path / "bag", loop)
    changed = {r: dict(v) for r, v in PARAMETERS.items()}
    changed[role][name] = value
    result = recompute(bag, parameters=changed)
    assert {d.topic for d in result.differences} == topics
    if (
        role == "controller"
    ):  # excitation is the same with another weight: the first difference is the first optimised input
        first = next(d for d in result.differences if d.topic == "inputs")
        modes = load_run(bag).mode
        assert first.k == (0 if name == "seed" else int(np.flatnonzero(modes == 2)[0]) + 1)
        assert 0 < first.by < 2


def test_a_missing_answer_is_not_the_same(make, loop, tmp_path):
    messages = [m for m in loop if not (m[0] == "controller/state" and m[1].k == 20)]
    result = recompute(write(make, tmp_path / "bag", messages))
    assert result.unmatched == {"inputs": 0, "controller/state": 1, "monitor/report": 0}
    assert not result.same


def test_an_invented_answer_is_not_the_same(make, loop, tmp_path):
    result = recompute(write(make, tmp_path / "bag", [*loop, ("monitor/report", MonitorReport(k=7))]))
    assert result.unmatched["monitor/report"] == 1
    assert not result.same


def test_a_cut_recording_is_the_same_as_far_as_it_goes(make, loop, tmp_path):
    result = recompute(write(make, tmp_path / "bag", loop[: len(loop) // 2]))
    assert result.same, (result.unmatched, result.differences)


def test_the_order_of_the_first_messages_does_not_matter(make, loop, tmp_path):
    """A recorder may see the references after the first samples."""
    info, *references = loop[:3]
    assert [name for name, _ in references] == ["reference", "reference"]
    result = recompute(write(make, tmp_path / "bag", [info, *loop[3:5], *references, *loop[5:]]))
    assert result.same, (result.unmatched, result.differences)


def test_index_2_with_a_held_input(make, tmp_path):
    """Outputs k depend on inputs k+1 and say how old those are; what acted is what is hashed and recomputed."""
    info = make.plant_info(1, 2)
    info.q, info.s, info.n = 1, 2, 2
    parameters = {"controller": {"N": 4, "L": 6, "Q": [4.0], "R": [0.5], "terminal": "none", "seed": 3}}
    agent = make_agent(parameters["controller"], info)
    agent.references.set(0, [0.2, 0.3])
    messages = [("plant_info", info), ("reference", make.sample(0, [0.2, 0.3]))]
    commands = agent.start()
    messages += [("inputs", make.sample(k, u)) for k, u in enumerate(commands)]
    acted, x = [commands[0]], 0.5
    for k in range(100):
        held = int(k == 60)  # inputs 61 came too late: those of 60 act once more
        acted.append(commands[k + 1 - held])
        y = np.array([x, 0.5 * acted[k + 1][0] + acted[k][0]])
        x = 0.8 * x + acted[k][0]
        messages.append(("outputs", make.sample(k, y, held=held)))
        decision = agent.step(k, y, held)
        state = state_message(agent, decision)
        agent.prepare()
        commands.append(decision.u)
        messages += [("inputs", make.sample(k + 2, decision.u)), ("controller/state", state)]
    bag = write(make, tmp_path / "bag", messages)
    run = load_run(bag)
    np.testing.assert_array_equal(run.u, acted[:100])
    assert run.u[61] == commands[60] != commands[61]
    result = recompute(bag, "controller", parameters)
    assert result.same, (result.differences, result.unmatched)
    assert result.loop_hash == run.loop_hash


def test_a_controller_in_shadow_gives_the_same_states_beside_the_inputs_of_another(make, tmp_path):
    info = make.plant_info()
    parameters = {"controller": PARAMETERS["controller"] | {"shadow": True}}
    agent = make_agent(parameters["controller"], info)
    agent.references.set(0, [0.5, 0.4])
    A, B = np.array([[0.9, 0.1], [0.0, 0.8]]), np.array([[0.3, 0.0], [0.1, 0.5]])
    rng, x = np.random.Generator(np.random.PCG64(1)), np.array([1.0, -1.0])
    messages = [("plant_info", info), ("reference", make.sample(0, [0.5, 0.4]))]
    for k in range(K):
        u = rng.uniform(-1, 1, 2)
        agent.overhear(k, u)
        decision = agent.step(k, x)
        messages += [("inputs", make.sample(k, u)), ("outputs", make.sample(k, x))]
        messages.append(("controller/state", state_message(agent, decision)))
        agent.prepare()
        x = A @ x + B @ u
    assert decision.result is not None  # it would have known what to do
    bag = write(make, tmp_path / "bag", messages)
    result = recompute(bag, "controller", parameters)
    assert result.same, (result.differences, result.unmatched)
    assert result.compared == {"controller/state": K}


def test_outputs_that_the_recorder_lost_are_noticed_there(make, loop, tmp_path):
    messages = [m for m in loop if not (m[0] == "outputs" and m[1].k == 60)]
    result = recompute(write(make, tmp_path / "bag", messages), "controller")
    assert not result.same
    assert result.unmatched == {"inputs": 1, "controller/state": 1}
    assert {(d.topic, d.k) for d in result.differences} == {("inputs", 62), ("controller/state", 61)}


def test_two_epochs_are_two_runs(make, loop, tmp_path):
    second = []
    for name, message in closed_loop(make):
        message.epoch = 1
        second.append((name, message))
    bag = write(make, tmp_path / "bag", [*loop, *second])
    result = recompute(bag)
    assert result.same, (result.unmatched, result.differences)
    assert result.compared["inputs"] == 2 * (K + 1)
    assert result.loop_hash == load_run(bag).loop_hash


def test_a_bag_without_plant_info_cannot_be_replayed(make, loop, tmp_path):
    with pytest.raises(BagError, match="nothing says what the plant is"):
        recompute(write(make, tmp_path / "bag", loop[1:]))


def test_progress_ends_at_the_total(make, loop, tmp_path):
    seen = []
    recompute(write(make, tmp_path / "bag", loop), progress=lambda done, total: seen.append((done, total)))
    assert seen[0] == (0, len(loop))
    assert seen[-1] == (len(loop), len(loop))


def test_comparison_is_to_the_bit():
    assert same(float("nan"), float("nan"))
    assert not same(0.0, -0.0)
    assert not same(1.0, np.nextafter(1.0, 2))
    was = SimpleNamespace(a=1, b=SimpleNamespace(c=[SimpleNamespace(d="x")]), e=np.array([1.0, 2.0]))
    now = SimpleNamespace(a=1, b=SimpleNamespace(c=[SimpleNamespace(d="y")]), e=np.array([1.0, 3.0]))
    assert first_difference(was, now) == ("b.c[0].d", "x", "y")
    assert first_difference(was, now, {"b"}) == ("e[1]", 2.0, 3.0)
    assert first_difference(was, was) is None
    assert first_difference(was, SimpleNamespace(a=1)) is not None
    assert first_difference(np.zeros(2), np.zeros(3)) == ("[]", "2 values", "3 values")


SETTINGS = {"N": 3, "L": 5, "Q": 4.0, "R": 0.5, "terminal": "equilibrium", "q": 2, "u_min": -1.0, "u_max": 1.0}


def test_what_if_with_the_same_settings_is_what_was(make, loop, tmp_path):
    run = load_run(write(make, tmp_path / "bag", loop))
    settings = settings_for(PARAMETERS["controller"], make.plant_info())  # as the node has them
    answer = what_if(run, DeepcController(2, 2, settings))
    first = int(np.flatnonzero(run.mode == 2)[0]) + 1
    assert answer.first == first
    assert (answer.failed, answer.missing) == (0, "")
    np.testing.assert_array_equal(answer.u[first:], run.u[first:])
    assert np.isnan(answer.u[:first]).all()
    np.testing.assert_array_equal(answer.furthest, [0, 0])
    assert answer.solved == K - first


@pytest.mark.parametrize("samples", [1, 2, 7, 1000])
def test_what_if_in_stretches_is_what_if_at_once(make, loop, tmp_path, monkeypatch, samples):
    """With a gap, an input that is missing, and a second epoch."""
    messages = [m for m in loop if not (m[0] == "outputs" and m[1].k == 60)]
    messages = [m for m in messages if not (m[0] == "inputs" and m[1].k == 45)]
    again = [(name, copy.deepcopy(message)) for name, message in loop]
    for _, message in again:
        message.epoch = 1
    bag = write(make, tmp_path / "bag", [*messages, *again])
    settings = DeepcSettings(**SETTINGS | {"u_max": 0.2})
    expected = what_if(load_run(bag), DeepcController(2, 2, settings))
    monkeypatch.setattr(Recording.stretches, "__defaults__", (samples,))
    with Recording(bag) as recording:
        found = what_if(recording, DeepcController(2, 2, settings))
    for name in ("u", "furthest"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    for name in ("solved", "failed", "first", "first_k", "missing"):
        assert getattr(found, name) == getattr(expected, name)
    assert found.solved > 20
    assert len(np.unique(load_run(bag).epoch)) == 2


def test_what_if_with_other_settings_is_something_else(make, loop, tmp_path):
    run = load_run(write(make, tmp_path / "bag", loop))
    answer = what_if(run, DeepcController(2, 2, DeepcSettings(**SETTINGS | {"u_max": 0.2})))
    assert np.nanmax(answer.u) <= 0.2
    assert answer.furthest.max() > 0.01
    draw(run, tmp_path / "figure.png", what_if=answer.u)
    assert (tmp_path / "figure.png").stat().st_size > 10_000


def test_what_if_says_what_is_missing(make, loop, tmp_path):
    run = load_run(write(make, tmp_path / "bag", loop))
    answer = what_if(run, DeepcController(2, 2, DeepcSettings(**SETTINGS | {"N": 30, "terminal": "none"})))
    assert answer.first == -1
    assert answer.missing
    make.write_bag(tmp_path / "y", [("outputs", make.sample(0, [1.0]))])
    blind = load_run(tmp_path / "y")
    with pytest.raises(BagError, match="no inputs"):
        what_if(blind, DeepcController(2, 2, DeepcSettings(**SETTINGS)))


def test_what_if_starts_a_new_record_after_a_gap(make, loop, tmp_path):
    gone = range(60, 63)
    messages = [m for m in loop if not (m[0] == "outputs" and m[1].k in gone)]
    run = load_run(write(make, tmp_path / "bag", messages))
    seen = []
    what_if(
        run, DeepcController(2, 2, DeepcSettings(**SETTINGS)), progress=lambda done, total: seen.append((done, total))
    )
    assert seen[-1] == (K - 3, K - 3)


def test_what_if_knows_inputs_that_were_decided_ahead(make, tmp_path):
    """A plant of index 2: outputs k come after inputs k+1, and the first free input is k+2."""
    rng = np.random.Generator(np.random.PCG64(4))
    u = rng.uniform(-1, 1, (121, 1))
    x, y = np.zeros((121, 1)), np.zeros((120, 2))
    for k in range(120):
        y[k] = x[k, 0], 0.5 * u[k + 1, 0] + u[k, 0]
        x[k + 1] = 0.8 * x[k] + u[k]
    info = make.plant_info(1, 2)
    messages = [("plant_info", info), ("reference", make.sample(0, [0.0, 0.0])), ("inputs", make.sample(0, u[0]))]
    for k in range(120):
        messages += [("inputs", make.sample(k + 1, u[k + 1])), ("outputs", make.sample(k, y[k]))]
    make.write_bag(tmp_path / "bag", messages)
    run = load_run(tmp_path / "bag")
    settings = DeepcSettings(N=4, L=6, s=2, q=1, u_min=-1.0, u_max=1.0, terminal="none")
    answer = what_if(run, DeepcController(1, 2, settings))
    assert answer.failed == 0
    assert answer.solved > 50
    assert np.isfinite(answer.u[-50:]).all()
    assert np.isnan(answer.u[: answer.first]).all()


def test_as_many_references_hold_on_in_a_new_epoch_as_a_node_hears_of():
    assert topics.REFERENCE.depth == REFERENCES
