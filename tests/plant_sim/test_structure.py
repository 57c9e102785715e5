# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

import numpy as np
import pytest

from plant_sim import DescriptorSystem, net3, random_system, wscc9
from plant_sim.random_systems import order
from plant_sim.reach import weakest_mode
from plant_sim.steady import steady_states


def kalman_rank(A, B):
    blocks = [B]
    for _ in range(len(A) - 1):
        blocks.append(A @ blocks[-1])
    return np.linalg.matrix_rank(np.hstack(blocks), tol=1e-9)


def test_answers_are_the_planted_ones(planted_systems):
    for planted in planted_systems:
        found = planted.system.structure()
        assert found.r_controllable == planted.r_controllable
        assert found.c_controllable == planted.c_controllable
        assert found.r_observable == planted.r_observable
        assert found.c_observable == planted.c_observable
        assert found.controllability.rank == planted.q - order(planted.uncontrollable_modes)
        assert found.observability.rank == planted.q - order(planted.unobservable_modes)
        assert found.controllability.clear
        assert found.observability.clear


def test_modes_at_fault_are_the_planted_ones(planted_systems):
    for planted in planted_systems:
        found = planted.system.structure()
        for have, want in (
            (found.uncontrollable_modes, planted.uncontrollable_modes),
            (found.unobservable_modes, planted.unobservable_modes),
        ):
            assert len(have) == order(want)
            for z in want:
                assert min(abs(z - mode) for mode in have) < 1e-8


def test_lost_directions_are_lost(planted_systems):
    for planted in planted_systems:
        system, found, form = planted.system, planted.system.structure(), planted.system.weierstrass()
        W = found.controllability.lost
        np.testing.assert_allclose(W.T @ form.B1, 0, atol=1e-11)
        np.testing.assert_allclose(W.T @ form.A1 @ found.controllability.reachable, 0, atol=1e-11)
        blind = found.unobservable
        for _ in range(3):
            np.testing.assert_allclose(system.C @ blind, 0, atol=1e-11)
            blind = form.P[:, : form.q] @ form.A1 @ (form.P[:, : form.q].T @ blind)


def test_rank_agrees_with_kalman_on_small_systems():
    for seed in range(20):
        bad = [[], [0.5], [0.4 + 0.3j]][seed % 3]
        planted = random_system(m=2, p=2, q=4, uncontrollable=bad, conditioning=2.0, seed=seed)
        form = planted.system.weierstrass()
        assert planted.system.structure().controllability.rank == kalman_rank(form.A1, form.B1)


def test_margin_is_the_minimum_over_the_plane():
    for seed in range(5):
        planted = random_system(m=1, p=1, q=4, seed=seed)
        form = planted.system.weierstrass()
        B = form.B1 / np.linalg.norm(form.B1, 2)
        x = np.linspace(-1.2, 1.2, 121)
        z = (x[:, None] + 1j * x[x >= 0]).ravel()
        stack = np.concatenate(
            [form.A1 - z[:, None, None] * np.eye(4), np.broadcast_to(B, (len(z), 4, 1))], axis=2
        )  # fmt: skip
        grid = np.linalg.svd(stack, compute_uv=False)[:, -1].min()
        sigma, at, w = weakest_mode(form.A1, B)
        assert grid - 0.0142 < sigma < 1.01 * grid  # the singular value is 1-Lipschitz in z, the grid 0.02 wide
        assert np.linalg.norm(w.conj() @ np.hstack([form.A1 - at * np.eye(4), B])) == pytest.approx(sigma)


@pytest.mark.parametrize("exponent", range(2, 11, 2))
def test_margin_follows_the_distance(exponent):
    gain = 10.0**-exponent
    for seed in range(3):
        planted = random_system(m=2, p=2, q=4, uncontrollable=[0.5], uncontrollable_gain=gain, seed=seed)
        found = planted.system.structure()
        assert found.r_controllable
        assert 0.01 * gain < found.controllability.margin < 3 * gain
        assert abs(found.controllability.weakest_mode - 0.5) < 2 * gain + 1e-6


@pytest.mark.parametrize(
    ("variant", "rank", "modes"), [("full", 6, ()), ("transfers", 5, (1.0,)), ("text", 5, (1.0,))]
)  # fmt: skip
def test_wscc9(variant, rank, modes):
    found = wscc9(variant).system.structure()
    assert (found.controllability.rank, found.controllability.required) == (rank, 6)
    assert found.uncontrollable_modes == pytest.approx(modes, abs=1e-9)
    assert found.observability.full
    assert not found.c_controllable
    assert not found.c_observable


def test_wscc9_transfers_conserve_net_power():
    found = wscc9().system.structure()
    M, D = [0.125, 0.034, 0.016], [0.125, 0.068, 0.048]
    expected = np.array([*M, *D, *[0] * 6]) / 0.125
    assert found.conserved.shape == (1, 12)
    np.testing.assert_allclose(found.conserved[0], expected, atol=1e-12)
    assert wscc9("full").system.structure().conserved.shape == (0, 12)


@pytest.mark.parametrize(
    ("inputs", "rank", "conserved"), [("junction", 3, [0, 1]), ("river", 4, [1]), ("all", 5, [])]
)  # fmt: skip
@pytest.mark.parametrize("hour", [5, 2])
def test_net3(hour, inputs, rank, conserved):
    found = net3(hour, inputs).system.structure()
    assert (found.controllability.rank, found.controllability.required) == (rank, 5)
    assert (found.observability.rank, found.observability.required) == (5, 5)
    assert not found.c_controllable
    assert not found.c_observable
    np.testing.assert_allclose(found.conserved, np.eye(97)[conserved], atol=1e-9)
    assert found.controllability.clear
    assert found.observability.clear


def test_net3_needs_both_outputs():
    system = net3().system
    for rows, rank in (([1], 4), ([0], 1)):
        assert DescriptorSystem(system.E, system.A, system.B, system.C[rows]).structure().observability.rank == rank


def test_conserved_stays(planted_systems):
    rng = np.random.Generator(np.random.PCG64(0))
    seen = 0
    for planted in planted_systems:
        rows = planted.system.structure().conserved
        assert len(rows) == sum(z == 1 for z in planted.uncontrollable_modes)
        run = planted.system.simulate(rng.uniform(-1, 1, (15 + planted.s, planted.system.m)), rng.random(planted.q))
        np.testing.assert_allclose(np.ptp(run.x @ rows.T, axis=0), 0, atol=1e-9 * max(1.0, np.abs(run.x).max()))
        seen += len(rows)
    assert seen > 3


def test_nothing_to_reach_or_to_see():
    still = DescriptorSystem(np.eye(2), np.diag([0.5, 0.9]), np.zeros((2, 1)), np.zeros((1, 2))).structure()
    assert (still.controllability.rank, still.observability.rank) == (0, 0)
    assert sorted(z.real for z in still.uncontrollable_modes) == pytest.approx([0.5, 0.9])
    static = DescriptorSystem([[0.0]], [[1.0]], [[1.0]], [[1.0]]).structure()
    assert static.r_controllable
    assert static.c_controllable
    assert static.c_observable


def test_repeated_mode_needs_as_many_inputs():
    twins = np.diag([0.5, 0.5, 0.3])
    one = DescriptorSystem(np.eye(3), twins, np.ones((3, 1)), np.eye(3)).structure()
    assert one.controllability.rank == 2
    assert one.uncontrollable_modes == pytest.approx((0.5,))
    jordan = twins + np.diag([1.0, 0.0], k=1)
    assert DescriptorSystem(np.eye(3), jordan, np.ones((3, 1)), np.eye(3)).structure().r_controllable
    cut = DescriptorSystem(np.eye(3), jordan, [[1.0], [0.0], [1.0]], np.eye(3)).structure()
    assert cut.uncontrollable_modes == pytest.approx((0.5,))


def test_wscc9_steady_states():
    plant = wscc9("text")
    C = np.eye(12)[[0, 6, 3]]
    system = DescriptorSystem(plant.system.E, plant.system.A, plant.system.B, C)
    states = steady_states(system, plant.input_min, plant.input_max)
    low, high = states.output_range()
    np.testing.assert_allclose(high, [0, 3.617, 34.633], atol=1e-3)
    np.testing.assert_allclose(low, -high, atol=1e-9)
    u, y, distance = states.nearest([0, 2, 0])
    assert distance < 1e-9
    np.testing.assert_allclose(y, [0, 2, 0], atol=1e-9)
    run = system.simulate(np.tile(u, (2000, 1)))
    np.testing.assert_allclose(run.y[-1], y, atol=1e-6)


def test_net3_steady_states():
    plant = net3()
    states = steady_states(plant.system, plant.input_min, plant.input_max, plant.start(0).z1)
    for target, u2 in ((3.0, 0.17), (5.0, 0.67)):
        u, _y, distance = states.nearest([4, target])
        assert distance < 1e-9
        assert u[1] == pytest.approx(u2, abs=5e-3)
    assert states.nearest([5, 3])[2] == pytest.approx(1.0)
    np.testing.assert_allclose(states.output_range()[0][0], 4.0)


def test_steady_states_are_held(planted_systems):
    for planted in planted_systems:
        system, s = planted.system, planted.s
        m = system.m
        if any(abs(z) >= 1 for z in planted.uncontrollable_modes):
            continue
        states = steady_states(system, -np.ones(m), np.ones(m))
        u = states.nearest(np.ones(system.p))[0]
        assert (np.abs(u) <= 1 + 1e-9).all()
        y = states.y0 + states.Y @ np.linalg.lstsq(states.U, u - states.u0, rcond=None)[0]
        late = system.simulate(np.tile(u, (400 + s, 1))).y[-1]
        np.testing.assert_allclose(late, y, atol=1e-6 * max(1.0, np.abs(y).max()))
