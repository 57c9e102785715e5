# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

import hashlib
import os
import subprocess
import sys

import numpy as np
import pytest
from scipy import signal

from plant_sim import DescriptorSystem, InconsistentStateError, PlantError, ShapeError, net3, random_system, wscc9
from plant_sim.stepper import LinearStepper


def rng(seed=0):
    return np.random.Generator(np.random.PCG64(seed))


def residuals(system, run, u):
    """Residuals of both equations, relative to the size of their terms."""
    dynamics = run.x[1:] @ system.E.T - run.x[:-1] @ system.A.T - run.u[:-1] @ system.B.T
    size = np.abs(run.x).max() * max(np.abs(system.E).max(), np.abs(system.A).max()) + np.abs(u).max()
    output = run.y - run.x @ system.C.T - run.u @ system.D.T
    return np.abs(dynamics).max() / size, np.abs(output).max() / max(1.0, np.abs(run.y).max())


def test_trajectories_solve_the_equations(planted_systems):
    for i, planted in enumerate(planted_systems):
        system = planted.system
        u = rng(i).uniform(-1, 1, (20 + planted.s - 1, system.m))
        run = system.simulate(u, rng(i + 1).standard_normal(planted.q))
        assert run.u.shape == (20, system.m)
        assert run.y.shape == (20, system.p)
        assert run.x.shape == (20, system.n)
        assert max(residuals(system, run, u)) < 1e-10


def test_starts_where_asked(planted_systems):
    for i, planted in enumerate(planted_systems):
        system = planted.system
        z10 = rng(i).standard_normal(planted.q)
        run = system.simulate(rng(i).uniform(-1, 1, (5 + planted.s, system.m)), z10)
        np.testing.assert_allclose(system.slow_state(run.x[0]), z10, atol=1e-10)


def test_stream_has_the_bits_of_the_batch(planted_systems):
    for i, planted in enumerate(planted_systems):
        system, s = planted.system, planted.s
        u, z10 = rng(i).uniform(-1, 1, (30, system.m)), rng(i).standard_normal(planted.q)
        stepper = LinearStepper(system.weierstrass(), z10)
        outputs = [stepper.push(row) for row in u]
        assert outputs[: s - 1] == [None] * (s - 1)
        assert np.array(outputs[s - 1 :]).tobytes() == system.simulate(u, z10).y.tobytes()


def test_output_uses_exactly_the_inputs_up_to_s_minus_1_ahead():
    system = random_system(m=1, p=1, q=2, blocks=[3], seed=4).system
    u = rng().uniform(-1, 1, (12, 1))
    y = system.simulate(u).y
    for ahead, moves in ((2, True), (3, False)):
        v = u.copy()
        v[4 + ahead] += 1.0
        assert (system.simulate(v).y[4] != y[4]).any() == moves


def test_plain_system_agrees_with_scipy():
    planted = random_system(m=2, p=2, q=4, seed=1)
    system = planted.system
    A, B = np.linalg.solve(system.E, system.A), np.linalg.solve(system.E, system.B)
    u, x0 = rng().uniform(-1, 1, (25, 2)), rng(1).standard_normal(4)
    _, y, x = signal.dlsim((A, B, system.C, system.D, 1.0), u, x0=x0)
    run = system.simulate(u, x0=x0)
    np.testing.assert_allclose(run.x, x, atol=1e-11)
    np.testing.assert_allclose(run.y, y, atol=1e-11)
    assert run.inconsistency < 1e-12


def test_pole_at_infinity_is_a_preview():
    shift = DescriptorSystem(np.eye(3, k=1), np.eye(3), [[0], [0], [1]], [[1, 0, 0]])  # y(k) = -u(k+2)
    u = rng().uniform(-1, 1, (10, 1))
    np.testing.assert_array_equal(shift.simulate(u).y, -u[2:])


def test_inconsistent_start_is_refused_or_projected():
    system = wscc9().system
    x0 = np.concatenate([np.ones(6), np.zeros(6)])
    u = np.zeros((3, 3))
    with pytest.raises(InconsistentStateError, match=r"relative distance 7\.1e-01 .*give z1\(0\), or tolerance=inf"):
        system.simulate(u, x0=x0)
    run = system.simulate(u, x0=x0, tolerance=np.inf)
    assert run.inconsistency == pytest.approx(np.sqrt(6 / 12))  # all six loads must follow to angle 1
    np.testing.assert_allclose(run.x[0], np.ones(12), atol=1e-12)
    assert system.simulate(u, x0=np.ones(12)).inconsistency < 1e-12


def test_process_noise_is_the_residual():
    planted = random_system(m=2, p=2, q=3, blocks=[2, 1], seed=2)
    system = planted.system
    u = rng().uniform(-1, 1, (4001, 2))
    std = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    run = system.simulate(u, process_noise=std, rng=rng(5))
    w = run.x[1:] @ system.E.T - run.x[:-1] @ system.A.T - run.u[:-1] @ system.B.T
    np.testing.assert_allclose(w.std(axis=0), std, rtol=0.05)
    correlation = np.corrcoef(w.T) - np.eye(6)
    assert np.abs(correlation).max() < 0.06
    np.testing.assert_allclose(run.y, run.x @ system.C.T + run.u @ system.D.T, atol=1e-10)


def test_measurement_noise_is_white_and_seeded():
    system = wscc9().system
    u = rng().uniform(-1, 1, (4000, 3))
    clean = system.simulate(u).y
    v = system.simulate(u, measurement_noise=[0.1, 0.02], rng=rng(1)).y - clean
    np.testing.assert_allclose(v.std(axis=0), [0.1, 0.02], rtol=0.05)
    assert abs(np.corrcoef(v[1:, 0], v[:-1, 0])[0, 1]) < 0.05
    again = system.simulate(u, measurement_noise=[0.1, 0.02], rng=rng(1)).y - clean
    assert v.tobytes() == again.tobytes()


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"u": np.ones((2, 2))}, ShapeError, "s = 3 rows for one output"),
        ({"u": np.ones((9, 1))}, ShapeError, r"u must have shape \(any, 2\)"),
        ({"u": np.full((9, 2), np.nan)}, ShapeError, r"u\[0, 0\] is nan"),
        ({"u": np.ones((9, 2)), "z10": np.ones(3)}, ShapeError, r"z10 must have shape \(2\), got \(3,\)"),
        ({"u": np.ones((9, 2)), "x0": np.ones(3)}, ShapeError, r"x0 must have shape \(5\)"),
        ({"u": np.ones((9, 2)), "x0": np.ones(5), "z10": np.ones(2)}, PlantError, "not both"),
        ({"u": np.ones((9, 2)), "measurement_noise": 0.1}, PlantError, "noise needs rng"),
        ({"u": np.ones((9, 2)), "process_noise": -1.0, "rng": rng()}, ShapeError, "must not be negative"),
    ],
)
def test_bad_arguments(arguments, error, message):
    system = random_system(m=2, p=2, q=2, blocks=[3], seed=0).system
    with pytest.raises(error, match=message):
        system.simulate(**arguments)


def test_stepper_refuses_what_is_no_input():
    stepper = wscc9().start(0)
    for bad in ([1.0, 2.0], [np.nan, 0, 0]):
        with pytest.raises(ShapeError):
            stepper.push(bad)


def fingerprint():
    """Hash of two runs and of a canonical form."""
    digest = hashlib.sha256()
    for plant in (wscc9(), net3(inputs="all")):
        stepper, inputs = plant.start(3), rng(1)
        for _ in range(50):
            digest.update(stepper.push(inputs.uniform(-1, 1, 3)).tobytes())
    form = random_system(m=3, p=2, q=9, blocks=[3, 2, 1], seed=5).system.weierstrass()
    return digest.hexdigest() + hashlib.sha256(form.A1.tobytes() + form.markov().tobytes()).hexdigest()


def test_same_bits_in_another_process_with_other_threads():
    code = f"import runpy; print(runpy.run_path({__file__!r})['fingerprint']())"
    environment = os.environ | {"OMP_NUM_THREADS": "2", "OPENBLAS_NUM_THREADS": "2", "PYTHONHASHSEED": "7"}
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, sys.path))
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == fingerprint()


@pytest.mark.parametrize(
    ("shape", "form", "outputs"),
    [
        ((0, 1, 1), (0, 0, 1), [2.0]),
        ((2, 0, 1), (2, 0, 1), [0.0]),
        ((2, 1, 0), (2, 0, 1), []),
        ((1, 1, 1), (1, 0, 1), [2.0]),
    ],
)
def test_systems_may_lack_states_inputs_or_outputs(shape, form, outputs):
    n, m, p = shape
    system = DescriptorSystem(np.eye(n), 0.5 * np.eye(n), np.ones((n, m)), np.ones((p, n)), 2 * np.ones((p, m)))
    have = system.weierstrass()
    assert (have.q, have.r, have.s) == form
    assert system.simulate(np.ones((4, m))).y[0].tolist() == outputs
    assert system.structure().r_controllable == (m > 0 and n < 2)
