# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""A run read from a bag is what was recorded, whatever came twice, late or not at all."""

import hashlib

import numpy as np
import pytest
from deepc_msgs.msg import ControllerState
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ros2_deepc.bags import BagError, load_run, summarize
from ros2_deepc.bags.run import MODES, NO_MODE, VERDICTS


def test_arrays_are_what_was_recorded(record):
    bag = record(K=200, collect=100)
    run = load_run(bag.folder)
    np.testing.assert_array_equal(run.u, bag.u[:200])
    np.testing.assert_array_equal(run.u_ahead, bag.u[200:])
    np.testing.assert_array_equal(run.y, bag.y)
    np.testing.assert_array_equal(run.ref, bag.ref)
    np.testing.assert_array_equal(run.k, np.arange(200))
    np.testing.assert_allclose(run.t, 0.1 * np.arange(200), atol=1e-12)
    assert (run.mode[:100] == MODES.index("COLLECTING")).all()
    assert (run.mode[100:] == MODES.index("CONTROLLING")).all()
    assert np.isnan(run.solve_time[:100]).all()
    np.testing.assert_array_equal(run.solve_time[100:], 1e-3 * (1 + np.arange(100, 200) % 7))
    assert (run.plant, run.variant, run.sample_time) == ("bench", "two", 0.1)
    assert run.input_names == ("valve0", "valve1")
    np.testing.assert_array_equal(run.input_max, [1, 1])
    np.testing.assert_array_equal(run.reports.k, np.arange(9, 200, 10))
    assert VERDICTS[run.reports.verdict[-1, 0]] == "NOT_PROVED"
    assert run.reports.lambda_star[-1, 0] == 1.0 + 0.5j
    assert run.reports.reason[0] == "one mode is out of reach"
    np.testing.assert_allclose(run.reports.t, 0.1 * run.reports.k, atol=1e-12)


def test_loop_hash_is_sha256_of_u_and_y_in_turn(record):
    bag = record(K=50, collect=30)
    digest = hashlib.sha256()
    for k in range(50):
        digest.update(bag.u[k].astype("<f8").tobytes())
        digest.update(bag.y[k].astype("<f8").tobytes())
    assert load_run(bag.folder).loop_hash == digest.hexdigest()


def test_loop_hash_sees_the_last_bit(make, tmp_path):
    u, y, ref = make.simulate(20, 1, 10)
    hashes = set()
    for name, change in (("a", 0.0), ("b", 1.0)):
        v = u.copy()
        v[7, 1] = np.nextafter(v[7, 1], np.inf) if change else v[7, 1]
        make.write_bag(tmp_path / name, make.run_messages(v, y, ref, 10))
        hashes.add(load_run(tmp_path / name).loop_hash)
    assert len(hashes) == 2


def test_held_input_is_the_one_in_force(make, tmp_path):
    messages = [
        ("plant_info", make.plant_info()),
        ("inputs", make.sample(0, [0, 0])),
        ("inputs", make.sample(1, [1, 1])),
    ]
    messages += [("outputs", make.sample(0, [5, 5])), ("outputs", make.sample(1, [6, 6]))]
    messages += [("outputs", make.sample(2, [7, 7], held=1)), ("outputs", make.sample(3, [8, 8], held=2))]
    make.write_bag(tmp_path / "bag", messages)
    np.testing.assert_array_equal(load_run(tmp_path / "bag").u, [[0, 0], [1, 1], [1, 1], [1, 1]])


def test_with_index_two_the_outputs_before_tell_what_was_held(make, tmp_path):
    info = make.plant_info()
    info.s = 2
    messages = [("plant_info", info), *(("inputs", make.sample(k, [k, k])) for k in range(7))]
    messages += [("outputs", make.sample(k, [5, 5], held=int(k == 2))) for k in (0, 1, 2, 3, 5)]  # outputs 4 are lost
    make.write_bag(tmp_path / "bag", messages)
    np.testing.assert_array_equal(load_run(tmp_path / "bag").u[:, 0], [0, 1, 2, 2, np.nan])


def test_missing_input_is_nan_and_not_in_the_hash(make, tmp_path):
    u, y, ref = make.simulate(20, 1, 10)
    messages = [m for m in make.run_messages(u, y, ref, 10) if not (m[0] == "inputs" and m[1].k == 5)]
    make.write_bag(tmp_path / "bag", messages)
    run = load_run(tmp_path / "bag")
    assert np.isnan(run.u[5]).all()
    assert not np.isnan(np.delete(run.u, 5, axis=0)).any()
    assert len(run.loop_hash) == 64


def test_duplicates_count_once_and_are_counted(make, tmp_path):
    u, y, ref = make.simulate(20, 1, 10)
    messages = make.run_messages(u, y, ref, 10)
    at = next(i for i, m in enumerate(messages) if m[0] == "outputs" and m[1].k == 7)
    messages.insert(at + 1, ("outputs", make.sample(7, [99.0, 99.0])))
    make.write_bag(tmp_path / "bag", messages)
    run = load_run(tmp_path / "bag")
    np.testing.assert_array_equal(run.y, y)
    assert run.duplicates == 1


def test_epochs_follow_one_another(make, tmp_path):
    messages = [("plant_info", make.plant_info())]
    for epoch in (4, 2):  # numbers of epochs need not grow
        for k in range(5):
            messages += [("inputs", make.sample(k, [epoch, k], epoch)), ("outputs", make.sample(k, [k, epoch], epoch))]
    make.write_bag(tmp_path / "bag", messages)
    run = load_run(tmp_path / "bag")
    np.testing.assert_array_equal(run.epoch, [4] * 5 + [2] * 5)
    np.testing.assert_array_equal(run.u[:, 0], run.epoch)
    np.testing.assert_array_equal(run.k, [0, 1, 2, 3, 4] * 2)
    assert (np.diff(run.t) > 0).all()  # stamps go back, so time is counted


def test_monitor_alone_is_a_run(make, tmp_path):
    messages = [("outputs", make.sample(k, [k, 0])) for k in range(30)] + [("monitor/report", make.report(29))]
    messages.insert(3, ("reference", make.sample(10, [4, 4])))
    make.write_bag(tmp_path / "bag", messages)
    run = load_run(tmp_path / "bag")
    assert run.u.shape == (30, 0)
    assert (run.mode == NO_MODE).all()
    assert run.output_names == ("y1", "y2")
    assert np.isnan(run.ref[:10]).all()
    np.testing.assert_array_equal(run.ref[10:], np.full((20, 2), 4.0))
    summary = summarize(run)
    assert summary["controller"] == {"failures": None, "solve_time_ms": {"median": None, "p99": None}}


def test_two_plants_must_be_named(make, tmp_path):
    from ros2_deepc.bags import BagWriter
    from ros2_deepc.bags.convert import to_cdr

    with BagWriter(tmp_path / "bag") as bag:
        for name in ("/a", "/b/c"):
            bag.add_topic(f"{name}/outputs", "deepc_msgs/msg/Sample")
            bag.write(f"{name}/outputs", to_cdr(make.sample(0, [1.0 if name == "/a" else 2.0])), 1)
    with pytest.raises(BagError, match="2 plants: name one of /a, /b/c"):
        load_run(tmp_path / "bag")
    assert load_run(tmp_path / "bag", "b/c").y == 2.0
    with pytest.raises(BagError, match="no plant 'd'"):
        load_run(tmp_path / "bag", "d")


def test_sample_of_another_size_is_an_error(make, tmp_path):
    make.write_bag(tmp_path / "bag", [("outputs", make.sample(0, [1, 2])), ("outputs", make.sample(1, [1, 2, 3]))])
    with pytest.raises(BagError, match="k = 1 has 3 values"):
        load_run(tmp_path / "bag")


@settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 10**6), shuffle=st.integers(0, 10**6), drop=st.sets(st.integers(0, 60), max_size=10))
def test_any_order_of_arrival_gives_the_same_run(make, tmp_path_factory, seed, shuffle, drop):
    rng = np.random.Generator(np.random.PCG64(shuffle))
    u, y, ref = make.simulate(20, seed, 10)
    messages = make.run_messages(u, y, ref, 10)[1:]
    kept = [m for i, m in enumerate(messages) if i not in drop or m[0] == "outputs"]
    order = rng.permutation(len(kept))
    folder = tmp_path_factory.mktemp("bag")
    make.write_bag(folder / "a", kept)
    make.write_bag(folder / "b", [kept[i] for i in order])
    a, b = load_run(folder / "a"), load_run(folder / "b")
    np.testing.assert_array_equal(a.u, b.u)
    np.testing.assert_array_equal(a.y, y)
    np.testing.assert_array_equal(a.y, b.y)
    assert a.loop_hash == b.loop_hash


def test_summary(record):
    bag = record(K=200, collect=100, seed=5, metadata={"seed": "5"})
    summary = summarize(load_run(bag.folder))
    assert summary["plant"] == "bench"
    assert summary["seed"] == 5
    assert summary["steps"] == 200
    assert set(summary) == {"plant", "seed", "steps", "outputs", "verdicts", "controller", "loop_hash"}
    for i in range(2):
        head = summary["outputs"][f"head{i}"]
        error = bag.y[:, i] - bag.ref[:, i]
        expected = [np.sqrt(np.mean(error[130:150] ** 2)), np.sqrt(np.mean(error[180:200] ** 2))]
        np.testing.assert_allclose(head["rmse"], expected, rtol=1e-12)
        assert head["peak_to_peak"] == pytest.approx(np.ptp(bag.y[100:, i]), rel=1e-12)
    assert summary["verdicts"]["r_observability"] == "PROVED"
    assert summary["controller"]["failures"] == 0
    times = 1e3 * 1e-3 * (1 + np.arange(100, 200) % 7)
    assert summary["controller"]["solve_time_ms"]["median"] == pytest.approx(np.median(times))
    assert summarize(load_run(bag.folder), seed=9)["seed"] == 9


def test_state_counts_failures(make, tmp_path):
    messages = [("outputs", make.sample(k, [1, 1])) for k in range(4)]
    messages += [
        ("controller/state", make.state(k, ControllerState.CONTROLLING, [1, 1], [0, 0], failures=k)) for k in range(4)
    ]
    make.write_bag(tmp_path / "bag", messages)
    assert summarize(load_run(tmp_path / "bag"))["controller"]["failures"] == 3
