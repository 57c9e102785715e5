# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The law of the last active set: exact while it holds, never used when it does not."""

import numpy as np
import pytest
import quadprog

from ros2_deepc.control import DeepcSettings
from ros2_deepc.control.active_set import ActiveSet
from ros2_deepc.control.qp import CheckedSolver

from .test_qp import as_program, exact, random_program


@pytest.mark.parametrize("rows", [0, 4])
@pytest.mark.parametrize("seed", range(5))
def test_the_law_is_quadprogs_solution_while_the_set_stays(seed, rows):
    H, f, A, lower, upper = random_program(seed, 8, rows)
    C = np.vstack([np.eye(8), A])
    rng = np.random.Generator(np.random.PCG64(seed))

    def solution(f):
        """x and multipliers, positive where an upper bound pushes."""
        G, b = np.vstack([C, -C]), np.concatenate([lower, -upper])
        some = np.flatnonzero(np.isfinite(b))
        x, _, _, _, multipliers, _ = quadprog.solve_qp(H, -f, G[some].T, b[some])
        y = np.zeros(2 * len(C))
        y[some] = multipliers
        return x, y[len(C) :] - y[: len(C)]

    x, y = solution(f)
    active = ActiveSet(x, y, A, lower, upper)
    assert active.build(H, A)
    compared = 0
    for _ in range(20):
        near = f + 1e-3 * rng.standard_normal(8)
        if np.array_equal(solution(near)[1] != 0, y != 0):
            compared += 1
            for a, b in zip(active.solve(near, lower, upper), solution(near), strict=True):
                assert np.abs(a - b).max() < 1e-10
    assert compared > 10


@pytest.mark.parametrize("rows", [0, 3])
def test_answers_of_the_law_are_exact_and_come_as_soon_as_the_set_has_stayed(rows):
    H, f, A, lower, upper = random_program(7, 8, rows)
    solver = CheckedSolver("osqp")
    solver.load(as_program(H, A, lower, upper))
    rng, names = np.random.Generator(np.random.PCG64(1)), []
    for k in range(200):
        near = f * (1 + k // 40) * (-1) ** (k // 40) + 0.02 * rng.standard_normal(8)
        answer, failed, _ = solver.solve(near, lower, upper)
        solver.settle()
        assert failed == 0
        names.append(answer.solver)
        limit = 1e-9 if answer.solver == "active set" else 1e-4
        assert np.abs(answer.x - exact(H, near, A, lower, upper)).max() < limit
    assert names[:2] == ["osqp", "osqp"]
    assert names.count("active set") > 150
    assert "osqp" in names[40:42]  # the sign of f turns: other bounds hold


def test_bounds_that_depend_on_each_other_have_no_law():
    H, A = np.eye(2), np.array([[1.0, 1.0], [2.0, 2.0]])
    lower, upper = np.array([-9.0, -9.0, -9.0, -9.0]), np.array([9.0, 9.0, 1.0, 2.0])
    active = ActiveSet(np.array([0.5, 0.5]), np.array([0.0, 0.0, 1.0, 1.0]), A, lower, upper)
    assert not active.build(H, A)


def test_a_new_program_forgets_the_law():
    H, f, A, lower, upper = random_program(3, 6, 0)
    solver = CheckedSolver("osqp")
    for H2 in (H, 3 * H + np.eye(6)):
        solver.load(as_program(H2, A, lower, upper))
        names = []
        for _ in range(4):
            answer, _, _ = solver.solve(f, lower, upper)
            solver.settle()
            names.append(answer.solver)
            assert np.abs(answer.x - exact(H2, f, A, lower, upper)).max() < 1e-4
        assert names == ["osqp", "osqp", "active set", "active set"]


def test_at_rest_the_controller_stays_with_the_law(plant_form, loop):
    settings = DeepcSettings(N=6, L=14, q=6, u_min=-1.0, u_max=1.0, du_max=0.5, y_max=5.0)
    run = loop(plant_form(1), settings, 1).collect()
    results = [run.step([0.3, 0.2]) for _ in range(60)]
    assert {r.solver for r in results[-20:]} == {"active set"}
    assert all(r.status.solved for r in results)
