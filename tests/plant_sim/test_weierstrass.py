# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import linalg

from plant_sim import DescriptorSystem, NotRegularError, ShapeError, UnclearStructureError, random_system, wscc9


def transfer(system, z):
    return system.C @ np.linalg.solve(z * system.E - system.A, system.B) + system.D


def test_form_is_what_was_planted(planted_systems):
    for planted in planted_systems:
        form = planted.system.weierstrass()
        assert (form.q, form.r, form.s) == (planted.q, planted.r, planted.s)


def test_form_is_equivalent_to_the_system(planted_systems):
    for planted in planted_systems:
        system, form = planted.system, planted.system.weierstrass()
        assert max(form.residuals) < 1e-10
        np.testing.assert_allclose(form.S @ system.B, np.vstack([form.B1, form.B2]), atol=1e-12)
        np.testing.assert_allclose(system.C @ form.P, np.hstack([form.C1, form.C2]), atol=1e-12)


def test_nilpotency_index_is_exact(planted_systems):
    for planted in planted_systems:
        form = planted.system.weierstrass()
        if form.r:
            assert not np.linalg.matrix_power(form.N, form.s).any()
            assert form.s == 1 or np.linalg.norm(np.linalg.matrix_power(form.N, form.s - 1)) > 1e-6


def test_slow_and_fast_bases_are_orthonormal(planted_systems):
    for planted in planted_systems:
        form = planted.system.weierstrass()
        for basis in (form.P[:, : form.q], form.P[:, form.q :]):
            np.testing.assert_allclose(basis.T @ basis, np.eye(basis.shape[1]), atol=1e-13)


def test_transfer_function_on_the_unit_circle(planted_systems):
    rng = np.random.Generator(np.random.PCG64(3))
    for planted in planted_systems:
        system, form = planted.system, planted.system.weierstrass()
        for z in np.exp(1j * rng.uniform(0, np.pi, 3)):
            slow = form.C1 @ np.linalg.solve(z * np.eye(form.q) - form.A1, form.B1)
            fast = sum(P * z**i for i, P in enumerate(form.markov()))
            scale = np.linalg.cond(z * system.E - system.A)
            expected = transfer(system, z)
            tolerance = 1e-13 * scale * max(1, np.abs(expected).max())
            np.testing.assert_allclose(slow + fast, expected, rtol=0, atol=tolerance)


def test_finite_eigenvalues_agree_with_scipy(planted_systems):
    for planted in planted_systems:
        if planted.s > 1 or not planted.q:  # beyond index 1 QZ mixes finite and infinite eigenvalues
            continue
        alpha, beta = linalg.eig(planted.system.A, planted.system.E, right=False, homogeneous_eigvals=True)
        finite = alpha / np.where(np.abs(beta) > 1e-9 * np.abs(alpha), beta, 1.0)
        finite = finite[np.abs(beta) > 1e-9 * np.abs(alpha)]
        ours = np.linalg.eigvals(planted.system.weierstrass().A1)
        assert len(finite) == len(ours)
        assert max(np.abs(finite - z).min() for z in ours) < 1e-6


@pytest.mark.parametrize(
    ("E", "A", "q", "r", "s"),
    [
        (np.eye(3), np.diag([0.1, 0.2, 0.3]), 3, 0, 1),
        (np.zeros((2, 2)), np.eye(2), 0, 2, 1),
        ([[0, 1], [0, 0]], np.eye(2), 0, 2, 2),
        (np.eye(3, k=1), np.eye(3), 0, 3, 3),
        ([[1.0]], [[0.0]], 1, 0, 1),
        ([[0.0]], [[2.0]], 0, 1, 1),
        (np.diag([1e-9, 0.0]), np.diag([1e-9, 1.0]), 1, 1, 1),  # a row may be small as long as it is small all over
        (np.diag([1e7, 0.0]), np.array([[1.0, 1e7], [1e7, 1e7]]), 1, 1, 1),
    ],
)
def test_edges(E, A, q, r, s):
    n = len(A)
    form = DescriptorSystem(E, A, np.ones((n, 1)), np.ones((1, n))).weierstrass()
    assert (form.q, form.r, form.s) == (q, r, s)
    assert max(form.residuals) < 1e-13


def singular_pencils():
    rng = np.random.Generator(np.random.PCG64(0))
    S, P = rng.standard_normal((2, 5, 5))
    kronecker_E = np.zeros((5, 5))
    kronecker_A = np.zeros((5, 5))
    kronecker_E[:2, :3], kronecker_A[:2, :3] = np.eye(2, 3), np.eye(2, 3, k=1)  # L_2
    kronecker_E[2:5, 3:5], kronecker_A[2:5, 3:5] = np.eye(3, 2), np.eye(3, 2, k=-1)  # L_2'
    yield "zero row", np.diag([1.0, 0.0]), np.diag([1.0, 0.0])
    yield "common null vector", S @ np.diag([1, 1, 1, 0, 0.0]) @ P, S @ np.diag([1, 2, 3, 4, 0.0]) @ P
    yield "L2 and its transpose", S @ kronecker_E @ P, S @ kronecker_A @ P
    yield "repeated equation", [[1, 0], [1, 0]], [[0.5, 1], [0.5, 1]]


@pytest.mark.parametrize(("E", "A"), [case[1:] for case in singular_pencils()], ids=[c[0] for c in singular_pencils()])
def test_singular_pencil_is_refused(E, A):
    n = len(A)
    with pytest.raises(NotRegularError, match=r"take part|singular"):
        DescriptorSystem(E, A, np.ones((n, 1)), np.ones((1, n)))


def test_random_singular_pencils_never_pass():
    """Kronecker blocks L_e and L_h' hidden among finite and infinite eigenvalues by random S and P."""
    noticed = 0
    for index in range(60):
        rng = np.random.Generator(np.random.PCG64([index, 5]))
        e, h, q, b = (int(v) for v in rng.integers(0, [4, 4, 4, 3]))
        E = linalg.block_diag(np.eye(e, e + 1), np.eye(h + 1, h), np.eye(q), np.eye(b, k=1))
        A = linalg.block_diag(np.eye(e, e + 1, k=1), np.eye(h + 1, h, k=-1), rng.standard_normal((q, q)), np.eye(b))
        S, P = rng.standard_normal((2, len(E), len(E)))
        try:
            with pytest.raises(UnclearStructureError):
                DescriptorSystem(S @ E @ P, S @ A @ P, np.ones((len(E), 1)), np.ones((1, len(E)))).weierstrass()
        except NotRegularError:
            noticed += 1
    assert noticed >= 57


def test_doubtful_rank_is_not_guessed():
    system = DescriptorSystem(np.diag([1.0, 1e-13]), np.diag([0.5, 1.0]), np.ones((2, 1)), np.ones((1, 2)))
    with pytest.raises(UnclearStructureError, match=r"relative singular value 1\.0e-13.*tolerance="):
        system.weierstrass()
    assert system.weierstrass(tolerance=1e-12).q == 1
    assert system.weierstrass(tolerance=1e-15).q == 2


@settings(max_examples=25, deadline=None)
@given(
    q=st.integers(0, 5), blocks=st.lists(st.integers(1, 3), max_size=3), seed=st.integers(0, 2**31),
    exponents=st.tuples(st.integers(-20, 20), st.integers(-20, 20)),
)  # fmt: skip
def test_structure_does_not_depend_on_units(q, blocks, seed, exponents):
    if q + sum(blocks) == 0:
        return
    planted = random_system(m=2, p=2, q=q, blocks=blocks, seed=seed)
    rng = np.random.Generator(np.random.PCG64(seed))
    rows = 2.0 ** rng.integers(*sorted((exponents[0], exponents[0] + 8)), size=planted.system.n)
    factor = 2.0 ** exponents[1]
    system = planted.system
    scaled = DescriptorSystem(
        rows[:, None] * system.E * factor, rows[:, None] * system.A * factor, rows[:, None] * system.B, system.C
    )
    form = scaled.weierstrass()
    assert (form.q, form.r, form.s) == (planted.q, planted.r, planted.s)


def test_immutable():
    system = wscc9().system
    with pytest.raises(dataclasses.FrozenInstanceError):
        system.A = np.eye(12)
    form = system.weierstrass()
    for owner, names in ((system, "EABCD"), (form, ("S", "P", "A1", "B1", "C1", "N", "B2", "C2", "D"))):
        for name in names:
            with pytest.raises(ValueError, match="read-only"):
                getattr(owner, name)[...] = 0


def test_matrices_are_copied():
    A = np.diag([0.5, 0.2])
    system = DescriptorSystem(np.eye(2), A, np.ones((2, 1)), np.ones((1, 2)))
    A[0, 0] = 99.0
    assert system.A[0, 0] == 0.5


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"A": np.ones((2, 3))}, r"A must have shape \(2, 2\), got \(2, 3\)"),
        ({"E": np.eye(3)}, r"E must have shape \(2, 2\), got \(3, 3\)"),
        ({"B": np.ones((3, 1))}, r"B must have shape \(2, any\), got \(3, 1\)"),
        ({"C": np.ones((1, 3))}, r"C must have shape \(any, 2\), got \(1, 3\)"),
        ({"D": np.ones((2, 1))}, r"D must have shape \(1, 1\), got \(2, 1\)"),
        ({"B": np.ones(2)}, r"B must have shape \(2, any\), got \(2,\)"),
        ({"A": [[1.0, np.nan], [0.0, 1.0]]}, r"A\[0, 1\] is nan"),
        ({"E": [[np.inf, 0.0], [0.0, 1.0]]}, r"E\[0, 0\] is inf"),
        ({"C": "what"}, "C must be a real matrix"),
        ({"A": np.eye(2) * 1j}, "A must be a real matrix"),
        ({"A": np.eye(2)[:1]}, r"A must have shape \(1, 1\), got \(1, 2\)"),
    ],
)
def test_bad_matrices_are_named(change, message):
    good = {"E": np.eye(2), "A": np.diag([0.5, 0.2]), "B": np.ones((2, 1)), "C": np.ones((1, 2)), "D": np.zeros((1, 1))}
    with pytest.raises(ShapeError, match=message):
        DescriptorSystem(**(good | change))
