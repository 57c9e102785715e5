# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from plant_sim.stepper import LinearStepper
from ros2_deepc.control import DeepcSettings, tune

BASE = DeepcSettings(N=2, L=20, u_min=-1.0, u_max=1.0)


def run(form, K, noise=0.0, seed=0, offset=0.0):
    rng = np.random.Generator(np.random.PCG64(seed))
    stepper = LinearStepper(form, rng.normal(size=form.q))
    u = rng.uniform(-1, 1, (K + form.s - 1, form.D.shape[1]))
    y = np.array([out for out in map(stepper.push, u) if out is not None])
    return u[: len(y)], y + noise * rng.normal(size=y.shape) + offset


def test_finds_the_past_that_exact_data_need(plant_form):
    """Order 6 seen by two outputs: lag 3. Shorter pasts err, longer ones are not simpler."""
    u, y = run(plant_form(5), 700)
    seen = []
    tuning = tune(u, y, BASE, N=(2, 3, 5), L=(8, 16), q=(6,), form=("absolute",), progress=lambda *a: seen.append(a))
    assert tuning.best.N == 3
    assert tuning.best.error < 1e-8
    assert {t.N: t.error > 1e-3 for t in tuning.trials} == {2: True, 3: False, 5: False}
    assert tuning.settings.L == 16
    assert (tuning.settings.N, tuning.settings.q, tuning.settings.form) == (3, 6, "absolute")
    assert [a[:2] for a in seen] == [(1, 3), (2, 3), (3, 3)]
    assert all(t.error < min(tuning.naive) for t in tuning.trials[:2])


def test_an_offset_calls_for_increments(plant_form):
    """Unless the order leaves room for it: an offset is one more state that no input moves."""
    u, y = run(plant_form(6), 700, offset=50.0)
    tuning = tune(u, y, BASE, N=(4,), L=(8,), q=(6,))
    assert tuning.settings.form == "incremental"
    assert tuning.best.error < 1e-6
    absolute = next(t for t in tuning.trials if t.form == "absolute")
    assert absolute.error > 1e-2


@pytest.mark.parametrize("s", [1, 2])
def test_under_noise_the_true_order_and_more_data_win(s, plant_form):
    u, y = run(plant_form(8, q=3, s=s, m=2), 3000, noise=0.05)
    base = DeepcSettings(N=2, L=20, s=s, u_min=-1.0, u_max=1.0)
    tuning = tune(u, y, base, N=(5,), L=(6, 10), q=(1, 3, 10), T=(120, 500), form=("absolute",), folds=4)
    assert (tuning.best.q, tuning.best.T) == (3, 500)
    assert np.all(np.array(tuning.best.first) < 0.1)
    assert np.all(np.array(tuning.best.first) > 0.04)  # nobody predicts the noise


def test_the_horizon_ends_where_predictions_fade(plant_form):
    u, y = run(plant_form(9), 900, noise=0.3)
    short = tune(u, y, BASE, N=(4,), L=(6, 10, 20), form=("absolute",), tolerance=1e-3)
    assert short.settings.L == 6
    long = tune(u, y, BASE, N=(4,), L=(6, 10, 20), form=("absolute",), tolerance=10.0)
    assert long.settings.L == 20


def test_processes_change_nothing(plant_form):
    pytest.importorskip("joblib")
    u, y = run(plant_form(5), 400, noise=0.01)
    one, two = (tune(u, y, BASE, N=(3, 4), L=(6,), q=(0,), jobs=jobs) for jobs in (1, 2))
    assert one == two


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"y": np.zeros((30, 2))}, "u has 60 samples and y 30"),
        ({"N": ()}, "at least one candidate"),
        ({"N": (10,)}, "serves no combination: T = .* need a record of about"),
        ({"u": np.full((60, 3), np.nan)}, "nan"),
    ],
)
def test_says_what_is_wrong(change, text):
    rng = np.random.Generator(np.random.PCG64(0))
    how = {"u": rng.normal(size=(60, 3)), "y": rng.normal(size=(60, 2)), "base": BASE, **change}
    with pytest.raises(ValueError, match=text):
        tune(**how)
