# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""A run read in stretches is the run read at once: samples, summary, page, table; whatever lies across an edge."""

import errno
import json
import tempfile
import tracemalloc
from dataclasses import fields

import numpy as np
import pytest

from ros2_deepc.bags import BagError, BagReader, Recording, columns, load_run, recording, spill, stretches, summarize
from ros2_deepc.bags.export import export
from ros2_deepc.bags.panels import page_data
from ros2_deepc.bags.quantiles import Quantiles
from ros2_deepc.bags.report import write_report
from ros2_deepc.bags.stretches import Strip, Thin, thin
from ros2_deepc.bags.trends import Trends

SIZES = (1, 7, 50, 10_000)


def difficult(make, seed: int = 1):
    """Three epochs with everything that can lie across an edge."""
    rng = np.random.Generator(np.random.PCG64(seed))
    info = make.plant_info()
    info.s = 1 + (seed == 3)  # outputs before tell what was held
    out = [("plant_info", info)]
    for epoch, K in ((5, 90), (2, 3), (9, 70)):  # numbers of epochs need not grow
        u, y, ref = make.simulate(K, seed + epoch, K // 2)
        messages = [(n, with_epoch(m, epoch)) for n, m in make.run_messages(u, y, ref, K // 2)[1:]]
        held = {int(k) for k in rng.integers(5, K, 6)} if K > 5 else set()
        for name, message in messages:
            if name == "outputs" and message.k in held:
                message.held = min(int(rng.integers(1, 40)), message.k)
            if name == "controller/state" and message.k > 0.9 * K:
                message.mode, message.failures = 4, message.k
            if name == "controller/state" and message.k % 11 == 3:
                message.reference = []  # where the controller is silent, the topic speaks
        lost = {(n, int(k)) for n in ("outputs", "inputs", "controller/state") for k in rng.integers(0, K, 3 * (K > 5))}
        messages = [m for m in messages if (m[0], m[1].k) not in lost]
        for at in rng.integers(1, len(messages), 5):  # again, with other values, and late
            again = with_epoch(make.sample(messages[at][1].k, [99.0, 98.0]), epoch)
            messages.insert(int(rng.integers(at, len(messages))), (rng.choice(["outputs", "inputs"]), again))
        for at in rng.integers(0, len(messages), 12):  # anything may come much later
            messages.append(messages.pop(int(at)))
        out += messages
    return [*out, ("inputs", with_epoch(make.sample(3, [7.0, 7.0]), 77))]  # of an epoch without outputs


def with_epoch(message, epoch):
    message.epoch = epoch
    return message


@pytest.fixture(params=[1, 2, 3])
def bag(make, tmp_path, request, monkeypatch):
    monkeypatch.setattr(columns, "_PIECE", 1000)  # many pieces, so that what is wanted is spread over them
    options = {"max_bytes": 10_000, "chunk_size": 2000} if request.param == 2 else {}  # several files
    make.write_bag(tmp_path / "bag", difficult(make, request.param), metadata={"seed": "3"}, **options)
    assert (len(BagReader(tmp_path / "bag").files) > 3) == bool(options)
    return tmp_path / "bag"


def joined(parts, name):
    """A field of all stretches one behind the other; fields of the run as a whole from the first one."""
    values = [getattr(part, name) for part in parts]
    if isinstance(values[0], dict):
        return {key: np.concatenate([value[key] for value in values]) for key in values[0]}
    return np.concatenate(values)


ROWS = ("epoch", "k", "t", "y", "u", "ref", "mode", "solve_time", "state")
REPORT_ROWS = ("epoch", "k", "t", "row", "verdict", "lambda_star", "margin", "series")


@pytest.mark.parametrize("size", SIZES)
def test_stretches_hold_the_same_samples(bag, size):
    whole = load_run(bag)
    with Recording(bag) as recorded:
        parts = list(recorded.stretches(size))
        assert len(recorded) == len(whole)
    assert [len(part) for part in parts[:-1]] == [size] * (len(parts) - 1)
    assert [part.first for part in parts] == list(range(0, len(whole), size))
    for name in ROWS:
        np.testing.assert_equal(joined(parts, name), getattr(whole, name), err_msg=name)
    for name in REPORT_ROWS:
        found = joined([part.reports for part in parts], name)
        np.testing.assert_equal(found, getattr(whole.reports, name), err_msg=name)
    for name in {f.name for f in fields(whole)} - {*ROWS, "first", "reports"}:
        for part in parts:
            np.testing.assert_equal(getattr(part, name), getattr(whole, name), err_msg=name)


@pytest.mark.parametrize("size", SIZES)
def test_stretches_give_the_same_summary_page_and_table(bag, size, tmp_path, monkeypatch):
    whole = load_run(bag)
    monkeypatch.setattr(Recording.stretches, "__defaults__", (size,))
    with Recording(bag) as recorded:
        assert summarize(recorded) == summarize(whole)
        assert summarize(recorded)["loop_hash"] == whole.loop_hash
        assert json.dumps(page_data(Trends.of(recorded))) == json.dumps(page_data(Trends.of(whole)))
        assert Trends.of(recorded).events.first == Trends.of(whole).events.first
        export(recorded, tmp_path / "stretches.csv")
        export(whole, tmp_path / "whole.csv")
    assert (tmp_path / "stretches.csv").read_bytes() == (tmp_path / "whole.csv").read_bytes()


@pytest.mark.parametrize("ending", ["png", "parquet"])
def test_stretches_give_the_same_picture_and_parquet(make, tmp_path, monkeypatch, ending):
    if ending == "parquet":
        pytest.importorskip("pyarrow.parquet")
    make.write_bag(tmp_path / "bag", difficult(make, 3))
    whole = load_run(tmp_path / "bag")
    monkeypatch.setattr(Recording.stretches, "__defaults__", (50,))
    with Recording(tmp_path / "bag") as recorded:
        export(recorded, tmp_path / f"stretches.{ending}")
    export(whole, tmp_path / f"whole.{ending}")
    if ending == "png":
        assert (tmp_path / "stretches.png").read_bytes() == (tmp_path / "whole.png").read_bytes()
    else:
        read = pytest.importorskip("pyarrow.parquet").read_table
        found, expected = read(tmp_path / "stretches.parquet"), read(tmp_path / "whole.parquet")
        assert found.schema.equals(expected.schema, check_metadata=True)
        for name in expected.column_names:
            np.testing.assert_array_equal(found[name].to_numpy(), expected[name].to_numpy(), err_msg=name)


@pytest.mark.parametrize("seed", [3, 4])
def test_the_first_of_what_came_twice_counts_and_late_inputs_are_found(make, tmp_path, monkeypatch, seed):
    """Against the plain rule, message by message, instead of against ourselves."""
    monkeypatch.setattr(columns, "_PIECE", 1000)
    messages = difficult(make, seed)
    s = messages[0][1].s
    make.write_bag(tmp_path / "bag", messages)
    first: dict[tuple[str, int, int], list[float]] = {}
    held = {}
    for name, message in messages:
        if name in ("outputs", "inputs"):
            first.setdefault((name, message.epoch, message.k), list(message.values))
        if name == "outputs":
            held.setdefault((message.epoch, message.k), message.held)
    with Recording(tmp_path / "bag") as recorded:
        for part in recorded.stretches(13):
            for epoch, k, y, u in zip(part.epoch, part.k, part.y, part.u, strict=True):
                assert first["outputs", epoch, k] == y.tolist()
                told = held.get((epoch, k - s + 1)) if k >= s - 1 else 0
                known = told is not None and first.get(("inputs", epoch, k - told))
                np.testing.assert_array_equal(u, known or [np.nan, np.nan])


def test_thinned_lines_are_the_same_however_the_samples_come():
    """More samples than points: extremes and ends stay, and no spike is lost."""
    rng = np.random.Generator(np.random.PCG64(8))
    x, y = np.arange(10_011.0), rng.standard_normal(10_011)
    y[rng.integers(0, y.size, 40)] = np.nan
    y[4_345], y[777] = 50.0, -60.0
    once = thin(x, y, 400)
    assert len(once[0]) <= 700
    assert (np.nanmax(once[1]), np.nanmin(once[1])) == (50.0, -60.0)
    for size in (13, 149, 5000):
        line = Thin(y.size, 400)
        for at in range(0, y.size, size):
            line.add(x[at : at + size], y[at : at + size])
        np.testing.assert_array_equal(line.points(), once)


def test_a_bin_of_a_line_keeps_its_extremes_beside_a_gap():
    """A gap in the same bin must not hide the larger of two spikes."""
    y = np.zeros(100_000)
    y[1000], y[1003], y[1005] = -5.0, np.nan, 9.0
    _, kept = thin(np.arange(y.size, dtype=float), y)
    assert (np.nanmin(kept), np.nanmax(kept), np.isnan(kept).sum()) == (-5.0, 9.0, 1)


@pytest.mark.parametrize("size", [1, 7, 1000])
def test_a_strip_of_many_changes_shows_the_worst(size):
    x, values = np.arange(1000.0), np.tile([3, 5], 500)
    values[500] = 9
    strip = Strip(1000, [5, 3, 9], most=20)
    for at in range(0, 1000, size):
        strip.add(x[at : at + size], values[at : at + size])
    assert [run[:3] for run in strip.runs(1000.0)] == [(0, 500, 3), (500, 600, 9), (600, 1000, 3)]


@pytest.mark.parametrize("n", [1, 2, 3, 10, 1001, 70_000])
def test_quantiles_are_those_of_numpy(n, monkeypatch):
    monkeypatch.setattr(spill, "IN_MEMORY", 1000)
    rng = np.random.Generator(np.random.PCG64(n))
    for values in (rng.standard_normal(n), 1e-3 * rng.exponential(size=n), rng.integers(-3, 3, n).astype(float)):
        quantiles = Quantiles()
        for part in np.array_split(values, 7):
            quantiles.add(np.r_[part, np.nan])
        assert len(quantiles) == n
        assert [quantiles(q) for q in (0, 0.25, 0.5, 0.99, 1)] == np.quantile(values, [0, 0.25, 0.5, 0.99, 1]).tolist()
    assert np.isnan(Quantiles()(0.5))


def test_a_reference_that_never_rests_has_a_short_summary(make, tmp_path):
    messages = [("plant_info", make.plant_info())]
    for k in range(1500):
        messages += [("reference", make.sample(k, [k, 0])), ("outputs", make.sample(k, [k + 1, 0]))]
    make.write_bag(tmp_path / "bag", messages)
    summary = write_report(tmp_path / "bag", tmp_path / "r.html")
    assert summary["outputs"]["head0"]["rmse"] == [1.0] * 1000
    assert "1, 1, 1 and 988 more" in (tmp_path / "r.html").read_text()


def test_a_wild_index_costs_nothing(make, tmp_path):
    """One sample with a corrupt k must not make a loop over all that lie between."""
    messages = [("outputs", make.sample(k, [k, 0])) for k in (0, 1, 2**39, 3)]
    make.write_bag(tmp_path / "bag", messages)
    np.testing.assert_array_equal(load_run(tmp_path / "bag").k, [0, 1, 3, 2**39])


def test_memory_does_not_grow_with_the_run(make, tmp_path, monkeypatch):
    """Every allocation counted; benchmarks/bags.py shows the same of whole processes, at a million samples."""
    monkeypatch.setattr(spill, "IN_MEMORY", 10_000)
    monkeypatch.setattr(columns, "_PIECE", 20_000)
    monkeypatch.setattr(recording, "SAMPLES", 100)
    monkeypatch.setattr(stretches, "_PARTS", 5)
    for kind in (Thin, Strip):  # what is drawn has an end, too, which these lengths are to be beyond
        monkeypatch.setattr(kind.__init__, "__defaults__", (100,))
    peaks = {}
    for K in (1000, 6000):
        messages = make.run_messages(*make.simulate(K, 1, 500), 500)
        make.write_bag(tmp_path / f"{K}", messages, chunk_size=50_000)
        del messages
        for name, work in (("report", report_of), ("csv", csv_of), ("array", load_run)):
            tracemalloc.start()
            work(tmp_path / f"{K}")
            peaks[name, K] = tracemalloc.get_traced_memory()[1]
            tracemalloc.stop()
    assert peaks["report", 6000] < 1.3 * peaks["report", 1000]
    assert peaks["csv", 6000] < 1.3 * peaks["csv", 1000]
    assert peaks["array", 6000] > 2 * peaks["array", 1000], "what grows is seen to grow"


def report_of(bag):
    write_report(bag, bag / "r.html")


def csv_of(bag):
    with Recording(bag) as recorded:
        export(recorded, bag / "r.csv")


def test_no_room_for_the_temporary_file_is_one_line(record, monkeypatch):
    """A full disk for real: the device that always is."""
    bag = record(K=60).folder
    monkeypatch.setattr(spill, "IN_MEMORY", 100)
    monkeypatch.setattr(tempfile, "TemporaryFile", lambda *_, **__: open("/dev/full", "w+b", buffering=0))  # noqa: SIM115
    with pytest.raises(BagError, match=r"cannot keep samples .*No space left on device; make room there") as seen:
        load_run(bag)
    assert "\n" not in str(seen.value)
    assert seen.value.__cause__.errno == errno.ENOSPC


def test_the_temporary_file_is_gone_afterwards(record, tmp_path, monkeypatch):
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    monkeypatch.setattr(spill, "IN_MEMORY", 100)
    with Recording(record(K=60).folder) as recorded:
        assert sum(1 for _ in recorded.stretches(7)) == 9
    assert list(folder.iterdir()) == []
