# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The picture says what the run holds; whatever a run lacks, there is a picture."""

import numpy as np
import pytest
from deepc_msgs.msg import ControllerState
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imread

from ros2_deepc.bags import load_run
from ros2_deepc.bags.figure import _fill, draw
from ros2_deepc.bags.stretches import Strip, thin
from ros2_deepc.bags.trends import Trends


def words(run) -> set[str]:
    """All text in the picture of a run."""
    figure = Figure(figsize=(12.8, 7.2))
    FigureCanvasAgg(figure)
    _fill(figure, Trends.of(run))
    figure.canvas.draw()
    return {t.get_text() for t in figure.findobj(lambda a: hasattr(a, "get_text") and a.get_visible())}


def test_picture_names_everything(record, tmp_path):
    run = load_run(record(K=200, collect=100, metadata={"seed": "4"}).folder)
    found = words(run)
    for text in ("bench  ·  two", "collecting", "controlling", "head0  [m]", "valve1", "inputs  [m3/s]", "limit",
                 "reference", "R-controllable", "proved", "refuted", "not decidable", "solve  [ms]"):  # fmt: skip
        assert text in found, text
    assert any("not proved at λ = 1.000+0.500i" in t for t in found)
    draw(run, tmp_path / "figure.png")
    assert imread(tmp_path / "figure.png").shape[:2] == (1080, 1920)


@pytest.mark.parametrize("m", [0, 1, 9])
@pytest.mark.parametrize("p", [1, 7])
def test_any_size_has_a_picture(make, tmp_path, m, p):
    messages = [("plant_info", make.plant_info(m, p))]
    for k in range(12):
        messages += [("inputs", make.sample(k, np.full(m, 0.1)))] if m else []
        messages += [("outputs", make.sample(k, np.arange(p) + k))]
    make.write_bag(tmp_path / "bag", messages)
    draw(load_run(tmp_path / "bag"), tmp_path / "figure.svg")
    assert (tmp_path / "figure.svg").stat().st_size > 5000


def test_faults_have_a_picture(make, tmp_path):
    u, y, ref = make.simulate(60, 1, 20)
    messages = make.run_messages(u, y, ref, 20)
    for name, message in messages:
        if name == "controller/state" and 30 <= message.k < 40:
            message.mode = ControllerState.HOLDING
        if name == "controller/state" and message.k >= 50:
            message.mode = ControllerState.FALLBACK
    messages = [m for m in messages if not (m[0] == "inputs" and m[1].k == 33)]
    messages += [("outputs", make.sample(k, [0, 0], epoch=1)) for k in range(8)]
    messages += [
        ("controller/state", make.state(7, ControllerState.IDLE, [], [], epoch=1)),
        ("monitor/report", make.report(7, 1)),
    ]
    make.write_bag(tmp_path / "bag", messages)
    found = words(load_run(tmp_path / "bag"))
    assert {"holding", "fallback"} <= found
    assert any("2 epochs" in t for t in found)


def test_strip():
    x = np.arange(4.0)
    strip = Strip(4, [1, 2])
    assert strip.runs(4.0) == []
    strip.add(x, np.array([1, 1, 2, 1]), ["a", "b", "c", "d"])
    assert strip.runs(4.0) == [(0, 2, 1, "b"), (2, 3, 2, "c"), (3, 4, 1, "d")]


def test_thin_keeps_extremes_ends_and_gaps():
    rng = np.random.Generator(np.random.PCG64(3))
    y = rng.standard_normal(100_003)
    y[70_000], y[20_000] = 50.0, np.nan
    x = np.arange(y.size, dtype=float)
    tx, ty = thin(x, y, 1000)
    assert len(tx) <= 2100
    assert np.nanmax(ty) == 50.0
    assert np.nanmin(ty) == np.nanmin(y)
    assert (tx[0], tx[-1]) == (0, y.size - 1)
    assert np.isnan(ty).sum() == 1
    assert (np.diff(tx) > 0).all()
    np.testing.assert_array_equal(ty, y[tx.astype(int)])
