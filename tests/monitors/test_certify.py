# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The rank at every lambda: against the full pencil, against grids, and where it is hardest."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ros2_deepc.behavior import hankel
from ros2_deepc.monitors.certify import Curvature, Squares, _examine, candidates, certify
from ros2_deepc.monitors.compress import compress
from ros2_deepc.monitors.modal import modal
from ros2_deepc.monitors.pencil import Points, reduce
from ros2_deepc.monitors.search import minimum


def window(rng, A, B, C, L=None, T=80):
    q, m = B.shape
    L = L or q
    x, u, y = rng.standard_normal(q), rng.uniform(-1, 1, (T, m)), []
    for v in u:
        y.append(C @ x)
        x = A @ x + B @ v
    y = np.array(y)
    W = np.vstack([hankel(u, L + 1), hankel(y, L + 1)])
    return W, compress(W, m, len(C), L, W.shape[1])


def random_pencil(rng, q=4, m=2, p=2, L=None):
    A = rng.standard_normal((q, q)) / np.sqrt(q)
    W, data = window(rng, A, rng.standard_normal((q, m)), rng.standard_normal((p, q)), L)
    return A, W, data, reduce(data, q)


def full_kappa(W, m, p, L, lam):
    """sigma_q(Y(lambda) Pi_U(lambda)) over |S1 - lambda S0| from the data matrix itself."""
    U, Y = W[: m * (L + 1)], W[m * (L + 1) :]
    Ul, Yl = U[m:] - lam * U[:-m], Y[p:] - lam * Y[:-p]
    projector = np.eye(W.shape[1]) - np.linalg.pinv(Ul) @ Ul
    shift = np.linalg.norm(np.eye(L, L + 1, 1) - lam * np.eye(L, L + 1), 2)
    return np.linalg.svd(Yl @ projector, compute_uv=False) / shift


def grid():
    inner = np.linspace(-1, 1, 41)
    z = (inner[:, None] + 1j * inner).ravel()
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.concatenate([z, np.where(z == 0, np.inf, 1 / np.where(z == 0, 1, z))])


@pytest.mark.parametrize("lam", [0.3, -0.9 + 0.2j, 1.0, 4.0j])
def test_kappa_bounds_the_full_pencil_from_below_and_has_its_rank(rng, lam):
    for _ in range(5):
        _, W, data, pencil = random_pencil(rng)
        full = full_kappa(W, 2, 2, data.L, lam)
        reduced = pencil.singular_values(np.array([lam]))[0]
        assert np.all(reduced <= full[:4] * (1 + 1e-9))
        assert reduced[-1] > 0.3 * full[3]
        assert full[4] < 1e-12 * full[0]


def test_eigenvalues_of_the_pencil_are_those_of_the_plant(rng):
    A, _, _, pencil = random_pencil(rng, q=5)
    found, true = minimum(pencil).modes.eigenvalues, np.linalg.eigvals(A)
    assert abs(found[:, None] - true).min(axis=0).max() < 1e-9


def test_certificate_decides_on_both_sides_of_the_minimum(rng):
    z = grid()
    for _ in range(20):
        *_, pencil = random_pencil(rng, q=int(rng.integers(2, 6)))
        lowest = min(pencil.singular_values(z)[:, -1].min(), minimum(pencil).kappa)
        assert certify(pencil, 0.9 * lowest).complete
        assert not certify(pencil, 1.1 * lowest).complete


def test_search_finds_the_minimum_of_a_grid(rng):
    z = grid()
    for _ in range(20):
        *_, pencil = random_pencil(rng, q=int(rng.integers(2, 6)))
        assert minimum(pencil).kappa <= 1.1 * pencil.singular_values(z)[:, -1].min()


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    re=st.floats(-1, 1),
    im=st.floats(-1, 1),
    outer=st.booleans(),
    half=st.floats(1e-6, 0.1),
    share=st.floats(0.01, 0.99),
)
def test_a_square_that_is_done_holds_no_small_kappa(seed, re, im, outer, half, share):
    rng = np.random.Generator(np.random.PCG64(seed))
    *_, pencil = random_pencil(rng, q=3)
    centre = Points(np.array([re + 1j * im]), np.array([outer]))
    value = pencil.evaluate(centre)
    eps = share * np.linalg.svd(value.N[0], compute_uv=False)[-1] / pencil.weight(centre.t)[0]
    done, _ = _examine(pencil, Curvature(pencil), Squares(centre, np.array([half])), eps)
    t = centre.t + half * (rng.uniform(-1, 1, 50) + 1j * rng.uniform(-1, 1, 50))
    inside = Points(t, np.full(50, outer))
    kappa = np.linalg.svd(pencil.evaluate(inside).N, compute_uv=False)[:, -1] / pencil.weight(t)
    assert not done[0] or kappa.min() > eps


def test_candidates_hold_every_small_kappa(rng):
    z = grid()
    for _ in range(10):
        *_, pencil = random_pencil(rng)
        kappa = pencil.singular_values(z)[:, -1]
        eps = np.quantile(kappa, 0.02)
        squares = candidates(modal(pencil), eps)
        for lam in z[(kappa <= eps) & (z.imag >= 0)]:
            both = [lam, 1 / lam if lam else 1e300]
            assert any(
                max(abs((both[int(o)] - t).real), abs((both[int(o)] - t).imag)) <= h * (1 + 1e-12)
                for t, o, h in zip(*squares.at, squares.half, strict=True)
            )


@pytest.mark.parametrize("distance", [0.0, 1e-4, 1e-8])
def test_nearly_defective_pair_with_one_uncontrollable_mode_is_never_proved(rng, distance):
    for _ in range(20):
        A = np.diag([0.7, 0.7 + distance, -0.3]) + np.diag([1.0, 0.0], 1)
        B = np.vstack([rng.standard_normal((1, 2)), np.zeros((1, 2)), rng.standard_normal((1, 2))])
        T = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        _, data = window(rng, T @ A @ np.linalg.inv(T), T @ B, rng.standard_normal((2, 3)))
        pencil = reduce(data, 3)
        eps = data.floor + pencil.floor
        assert minimum(pencil).kappa <= eps or not certify(pencil, eps).complete


def test_defective_and_multiple_modes_are_proved_where_controllable(rng):
    cases = [np.eye(3) * 0.8 + np.eye(3, k=1), np.diag([1.0, 1.0, 0.5]), np.zeros((3, 3))]
    for A in cases:
        T = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        B, C = T @ rng.standard_normal((3, 3)), rng.standard_normal((3, 3)) @ np.linalg.inv(T)
        _, data = window(rng, T @ A @ np.linalg.inv(T), B, C)
        pencil = reduce(data, 3)
        assert certify(pencil, data.floor + pencil.floor).complete


def test_memory_of_a_cover_is_bounded(rng, monkeypatch):
    *_, pencil = random_pencil(rng)
    eps = 0.95 * minimum(pencil).kappa
    whole = certify(pencil, eps)
    monkeypatch.setattr("ros2_deepc.monitors.certify._MEMORY", 1)
    assert certify(pencil, eps) == whole  # the same squares in smaller batches


def test_budget_ends_the_cover(rng):
    *_, pencil = random_pencil(rng)
    outcome = certify(pencil, 0.999 * minimum(pencil).kappa, budget=3)
    assert not outcome.complete
    assert outcome.counterexample is None
