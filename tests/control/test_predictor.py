# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Predictors from one factor: joint, causal, from the Gram matrix; rank decisions; noise."""

import numpy as np
import pytest

from plant_sim.stepper import LinearStepper
from ros2_deepc.behavior import Record, data_matrix
from ros2_deepc.control import DeepcSettings
from ros2_deepc.control.layout import lay_out
from ros2_deepc.control.predictor import PoorDataError, Truncation, fit, fit_causal, fit_gram
from ros2_deepc.control.settings import size

N, L, M, P, Q = 6, 10, 2, 2, 4


def record(form, T, seed, noise=0.0, feedback=None):
    """A run: white inputs, or feedback of the measured output plus white inputs."""
    rng = np.random.Generator(np.random.PCG64([seed, 1]))
    stepper, u, y = LinearStepper(form, rng.normal(size=form.q)), [], []
    last = np.zeros(form.D.shape[0])
    for _ in range(T + form.s - 1):
        u.append(rng.uniform(-1, 1, form.D.shape[1]) + (0 if feedback is None else feedback @ last))
        out = stepper.push(u[-1])
        if out is not None:
            last = out + noise * rng.normal(size=out.size)
            y.append(last)
    return Record(np.array(u), np.array(y))


def layout(s=1, **how):
    sized = size(DeepcSettings(N=N + s - 1, L=L, q=Q, s=s, terminal="none", **how), M, P)
    return sized, lay_out(sized)


def matrix(run, sized, rows):
    return data_matrix([run], sized.rows_u, sized.rows_y)[rows.stacked]


@pytest.mark.parametrize("s", [1, 2, 3])
@pytest.mark.parametrize("seed", range(4))
def test_rank_identities(seed, s, plant_form):
    """rank [H_{N+L+s-1}(u); H_{N+L}(y)] = m (N+L+s-1) + q on rich data, whatever the index."""
    form = plant_form(60 + seed, m=M, p=P, q=Q, s=s)
    sized, rows = layout(s)
    W = matrix(record(form, 120, seed), sized, rows)
    fitted = fit(W, rows, W.shape[1], Truncation())
    assert fitted.rank == np.linalg.matrix_rank(W) == sized.rank_need == M * (N + L + 2 * (s - 1)) + Q
    assert fitted.order == Q
    assert fitted.gap > 1e6


@pytest.mark.parametrize("s", [1, 2, 3])
@pytest.mark.parametrize("seed", range(3))
def test_three_ways_one_predictor(seed, s, plant_form):
    form = plant_form(70 + seed, m=M, p=P, q=Q, s=s)
    sized, rows = layout(s)
    W = matrix(record(form, 200, seed), sized, rows)
    other = matrix(record(form, 120, seed + 1), sized, rows)  # another run of the same plant
    known = np.vstack([other[: rows.known_u], other[rows.inputs : rows.inputs + rows.context]])
    free, future = other[rows.known_u : rows.inputs], other[rows.inputs + rows.context :]
    for fitted in (
        fit(W, rows, W.shape[1], Truncation("order", Q)),
        fit_causal(W, rows, W.shape[1], Truncation("none")),
        fit_gram(W @ W.T, rows, W.shape[1], Truncation("order", Q), noise_block=True),
    ):
        assert np.abs(fitted.G @ free + fitted.F @ known - future).max() < 1e-7
        assert np.abs(fitted.noise).max(initial=0) < 1e-6
        blocks = fitted.G.reshape(L, P, L, M)
        for j in range(L):  # y(k+j) needs no input that is decided later
            assert np.abs(blocks[j, :, j + 1 :]).max(initial=0) < 1e-7


def test_cuts():
    sv = np.array([10.0, 5.0, 4.0, 1e-3, 9e-4, 1e-15])
    assert Truncation("none").keep(sv, 1e-12) == 5
    assert Truncation("order", 2).keep(sv, 1e-12) == 2
    assert Truncation("order", 0).keep(sv, 1e-12) == 5
    assert Truncation("order", 9).keep(sv, 1e-12) == 5
    assert Truncation("noise", floor=1e-2).keep(sv, 1e-12) == 3
    assert Truncation("gap").keep(sv[:5], 1e-5) == 3
    assert Truncation("gap").keep(sv, 1e-12) == 5  # down to rounding is the largest gap of all
    assert Truncation("gap").keep(np.zeros(3), 1e-12) == 0


def test_noise_of_known_size_is_cut_off(plant_form):
    form = plant_form(80, m=M, p=P, q=Q)
    sized, rows = layout()
    W = matrix(record(form, 400, 0, noise=1e-4), sized, rows)
    floor = 1.35 * 1e-4 * (np.sqrt(P * (N + L)) + np.sqrt(W.shape[1]))
    assert fit(W, rows, W.shape[1], Truncation("none")).order == P * N
    assert fit(W, rows, W.shape[1], Truncation("noise", floor=floor)).order == Q
    assert fit(W, rows, W.shape[1], Truncation("gap")).order == Q
    assert fit(W, rows, W.shape[1], Truncation("none", floor=floor)).rank == sized.rank_need


def test_causal_regression_is_not_fooled_by_feedback(plant_form):
    """Noisy data under output feedback: the joint regression takes the controller's answers for causes."""
    errors = {"joint": [], "causal": []}
    for seed in range(4):
        form = plant_form(90 + seed, m=M, p=P, q=Q, radius=(0.3, 0.8), feedthrough=False)
        rng = np.random.Generator(np.random.PCG64(seed))
        gain = rng.normal(size=(M, P))
        while np.abs(np.linalg.eigvals(np.block([[form.A1, form.B1 @ gain], [form.C1, np.zeros((P, P))]]))).max() > 0.9:
            gain *= 0.8
        sized, rows = layout()
        truth = fit(matrix(record(form, 200, 50), sized, rows), rows, 185, Truncation("order", Q))
        run = record(form, 6000, seed, noise=0.5, feedback=gain)
        W = matrix(Record(run.u, run.y), sized, rows)
        for name, regress in (("joint", fit), ("causal", fit_causal)):
            fitted = regress(W, rows, W.shape[1], Truncation("none"))
            errors[name].append(np.abs(fitted.G - truth.G).max())
    assert np.median(errors["causal"]) < 0.6 * np.median(errors["joint"])


def test_poor_inputs_are_named(plant_form):
    form = plant_form(81, m=M, p=P, q=Q)
    sized, rows = layout()
    run = record(form, 200, 0)
    flat = Record(np.column_stack([run.u[:, 0], np.zeros(len(run.u))]), run.y)
    W = matrix(flat, sized, rows)
    for regress in (fit, fit_causal):
        with pytest.raises(PoorDataError, match="excite"):
            regress(W, rows, W.shape[1], Truncation())
    with pytest.raises(PoorDataError, match="excite"):
        fit_gram(W @ W.T, rows, W.shape[1], Truncation(), noise_block=False)
    short = matrix(Record(run.u[:30], run.y[:30]), sized, rows)
    with pytest.raises(PoorDataError, match="15 columns of data cannot hold 32 input rows"):
        fit(short, rows, short.shape[1], Truncation())


@pytest.mark.parametrize("policy", ["fixed", "sliding"])
@pytest.mark.parametrize("noise", [1e-6, 1e-3, 1e-2])
def test_the_doubt_is_the_size_of_the_error_that_noise_makes(noise, policy, plant_form, truth, loop):
    form = plant_form(100, feedthrough=False)
    ratios = []
    for seed in range(5):
        settings = DeepcSettings(N=6, L=14, q=6, T=150, u_min=-1.0, u_max=1.0, data_policy=policy)
        run = loop(form, settings, seed, noise=noise).collect()
        run.controller._data.predictor()
        predictor = run.controller._data.predictor()  # sliding: of the squared data matrix from now on
        y_scale = np.tile(run.controller._data.scale[1], 14)[:, None]
        u_scale = np.tile(run.controller._data.scale[0], 14)
        exact = truth(form, 14).T * u_scale / y_scale
        error = np.linalg.norm(predictor.G * u_scale / y_scale - exact) / np.linalg.norm(exact)
        ratios.append(predictor.doubt / error)
    assert 0.7 < np.median(ratios) < 2.0
    clean = loop(form, settings, 1).collect().controller._data.predictor()
    assert clean.doubt < 1e-7
