# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
import dataclasses

import numpy as np
import pytest
import quadprog
from hypothesis import given, settings
from hypothesis import strategies as st

from ros2_deepc.control.problem import Condensed
from ros2_deepc.control.qp import Answer, CheckedSolver, Daqp, Osqp, fault


def random_program(seed, n, rows, spread=1.0):
    rng = np.random.Generator(np.random.PCG64(seed))
    U, _ = np.linalg.qr(rng.normal(size=(n, n)))
    H = (U * np.logspace(0, spread, n)) @ U.T
    A = rng.normal(size=(rows, n))
    lower, upper = np.append(-np.ones(n), -0.5 * np.ones(rows)), np.append(np.ones(n), np.full(rows, np.inf))
    return (H + H.T) / 2, 3 * rng.normal(size=n), A, lower, upper


def as_program(H, A, lower, upper):
    """Only what solvers look at."""
    n = H.shape[0]
    none = {f.name: np.zeros((n, 0)) for f in dataclasses.fields(Condensed)}
    return Condensed(**{**none, "H": H, "A": A, "lower": lower, "upper": upper})


def exact(H, f, A, lower, upper):
    C = np.vstack([np.eye(H.shape[0]), A])
    G, b = np.vstack([C, -C]), np.concatenate([lower, -upper])
    some = np.isfinite(b)
    return quadprog.solve_qp(H, -f, G[some].T, b[some])[0]


@pytest.mark.parametrize(("kind", "limit"), [(Osqp, 1e-4), (Daqp, 1e-9)])
@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), n=st.integers(1, 12), rows=st.integers(0, 4))
def test_agrees_with_quadprog_over_reloads_and_solves(kind, limit, seed, n, rows):
    solver = kind()
    for load in range(2):
        H, _, A, lower, upper = random_program(seed + load, n, rows)
        solver.load(H, A, lower, upper)
        for solve in range(3):
            f = random_program(100 * seed + solve, n, rows)[1]
            answer = solver.solve(f, lower, upper)
            assert fault(answer, H, f, A, lower, upper) == ""
            assert np.abs(answer.x - exact(H, f, A, lower, upper)).max() < limit


@pytest.mark.parametrize("first", ["osqp", "daqp"])
def test_an_infeasible_program_gets_no_answer_and_the_next_one_does(first):
    H, f, _, lower, upper = random_program(6, 4, 0)
    A = np.ones((1, 4))
    solver = CheckedSolver(first)
    low, high = np.append(lower, 10.0), np.append(upper, 11.0)
    solver.load(as_program(H, A, low, high))
    answer, failed, remark = solver.solve(f, low, high)
    assert answer is None
    assert failed == 2
    assert "osqp" in remark
    assert "daqp" in remark
    low, high = np.append(lower, -1.0), np.append(upper, 1.0)
    answer, _, _ = solver.solve(f, low, high)
    assert np.abs(answer.x - exact(H, f, A, low, high)).max() < 1e-4


@pytest.mark.parametrize("rows", [0, 2])
def test_the_check_catches_every_kind_of_wrong_answer(rows):
    H, f, A, lower, upper = random_program(7, 5, rows)
    solver = Daqp()
    solver.load(H, A, lower, upper)
    good = solver.solve(f, lower, upper)
    assert fault(good, H, f, A, lower, upper) == ""
    wrong = {
        "nan": (np.full(5, np.nan), good.y),
        "outside": (good.x + np.array([3.0, 0, 0, 0, 0]), good.y),
        "not optimal": (0.5 * good.x, good.y),
        "huge": (np.full(5, 1e9), good.y),
    }
    for x, y in wrong.values():
        assert fault(Answer(x, y, True, 1, ""), H, f, A, lower, upper)
    assert fault(Answer(good.x, good.y, False, 1, "gave up"), H, f, A, lower, upper) == "gave up"
    if rows:  # a multiplier that pushes where nothing is touched
        free = np.zeros(5 + rows)
        free[:5] = -(H @ np.zeros(5) + f)
        assert "multipliers" in fault(Answer(np.zeros(5), free, True, 1, ""), H, f, A, lower, upper)
