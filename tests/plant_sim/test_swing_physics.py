# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The nonlinear grid against independent integrators, its linearisation, its invariants, and its mistakes."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import root

from plant_sim.errors import PlantError, ShapeError
from plant_sim.grid_events import parse_events
from plant_sim.power import WSCC9_DAMPING, WSCC9_EDGES, WSCC9_INERTIA
from plant_sim.swing_dae import SwingGrid, flows, operating_point, rates, stiffness
from plant_sim.swing_plant import WSCC9_GENERATION, WSCC9_LOAD, swing_from_case, wscc9_swing
from plant_sim.swing_stepper import SwingRun, SwingStepper

M, D = np.array(WSCC9_INERTIA), np.array(WSCC9_DAMPING)
OUTPUTS = "f_1 f_2 f_3 " + " ".join(f"theta_{bus}" for bus in range(1, 10))
STEPS = 100  # 10 s


def trajectory(u, **options):
    stepper = wscc9_swing(outputs=OUTPUTS, noise=0.0, **options).start(0)
    y = np.array([stepper.push(row) for row in u])
    y[:, :3] *= 2 * np.pi
    return y, stepper


def right_hand_side(theta, omega, power, load):
    """The equations once more, branch by branch: residuals of machines and of load buses."""
    out = -np.array(load, dtype=float)
    for i, j, x in WSCC9_EDGES:
        flow = np.sin(theta[i] - theta[j]) / x
        out[i] -= flow
        out[j] += flow
    return (out[:3] + power - D * omega) / M, out[3:]


def solve(equations, guess):
    found = root(equations, guess, options={"xtol": 1e-12}).x
    assert np.abs(equations(found)).max() < 1e-10
    return found


def reference(u, load_after):
    """The load angles eliminated by a root finder, the rest by an explicit Runge-Kutta method of order 8."""
    rest = solve(
        lambda t: np.concatenate(right_hand_side(np.r_[0, t], np.zeros(3), WSCC9_GENERATION, WSCC9_LOAD))[1:],
        np.zeros(8),
    )
    last = rest[2:].copy()

    def algebraic(theta_gen):
        last[:] = solve(lambda t: right_hand_side(np.r_[theta_gen, t], np.zeros(3), 0.0, load_after)[1], last)
        return last.copy()

    def rates_of(_, x, power):
        theta = np.r_[x[3:], algebraic(x[3:])]
        return np.r_[right_hand_side(theta, x[:3], power, load_after)[0], x[:3]]

    x = np.r_[np.zeros(4), rest[:2]]
    rows = [np.r_[x, rest[2:]]]
    for row in u[:-1]:
        power = np.array(WSCC9_GENERATION) + row
        x = solve_ivp(rates_of, (0, 0.1), x, "DOP853", args=(power,), rtol=1e-8, atol=1e-9).y[:, -1]
        rows.append(np.r_[x, algebraic(x[3:])])
    return np.array(rows)


@pytest.fixture(scope="module")
def probing():
    return np.random.Generator(np.random.PCG64(1)).uniform(-0.1, 0.1, (STEPS, 3))


@pytest.fixture(scope="module")
def solution(probing):
    """The grid probed at every machine, with a load step of 0.3 at bus 9 from the start."""
    return trajectory(probing, events="load 9 +0.3 @ 0")


def test_within_1e4_of_an_independent_integrator(probing, solution):
    y, stepper = solution
    probing, y = probing[:40], y[:40]
    load = np.array(WSCC9_LOAD)
    load[8] += 0.3
    exact = reference(probing, load)
    # the first sample is taken before the load step, the load angles jump with it
    assert np.abs(y[1:] - exact[1:]).max() < 2e-5
    assert np.abs(y[0, :6] - exact[0, :6]).max() < 1e-12
    assert stepper.residual < 1e-10


def test_ten_seconds_against_casadi_idas(probing, solution):
    casadi = pytest.importorskip("casadi")
    omega, angle, load_angle, power = (casadi.SX.sym(n, k) for n, k in (("w", 3), ("t", 3), ("l", 6), ("p", 3)))
    theta = casadi.vertcat(angle, load_angle)
    out = [-value for value in WSCC9_LOAD]
    out[8] -= 0.3
    for i, j, x in WSCC9_EDGES:
        flow = casadi.sin(theta[i] - theta[j]) / x
        out[i] -= flow
        out[j] += flow
    acceleration = (casadi.vertcat(*out[:3]) + power - D * omega) / M
    dae = {"x": casadi.vertcat(omega, angle), "z": load_angle, "p": power,
           "ode": casadi.vertcat(acceleration, omega), "alg": casadi.vertcat(*out[3:])}  # fmt: skip
    idas = casadi.integrator("idas", "idas", dae, 0, 0.1, {"reltol": 1e-9, "abstol": 1e-10})
    y, _ = solution
    x, z = y[0, :6], y[0, 6:]
    for k in range(STEPS - 1):
        step = idas(x0=x, z0=z, p=np.array(WSCC9_GENERATION) + probing[k])
        x, z = np.array(step["xf"]).ravel(), np.array(step["zf"]).ravel()
        assert np.abs(np.r_[x, z] - y[k + 1]).max() < 1e-4


def test_order_five(probing):
    fine, _ = trajectory(probing[:20], events="", substeps=128)
    errors = [np.abs(trajectory(probing[:20], events="", substeps=n)[0] - fine).max() for n in (4, 8, 16)]
    assert errors[0] / errors[1] > 2**4.5
    assert errors[1] / errors[2] > 2**4.5


def test_transfers_conserve_what_the_linear_grid_conserves():
    """sum (M omega + D theta) feels only net power; sines are odd, so the nonlinear grid keeps it, too."""
    rng = np.random.Generator(np.random.PCG64(2))
    y, _ = trajectory(rng.uniform(-0.5, 0.5, (200, 3)), inputs="transfers", events="")
    kept = y[:, :3] @ M + y[:, 3:6] @ D
    assert np.ptp(kept) < 1e-11
    assert np.ptp(y[:, 0]) > 0.1


def test_small_signals_follow_the_linearisation():
    grid = wscc9_grid()
    theta = operating_point(grid)
    A, B = linearised(grid, theta)
    u = 1e-4 * np.random.Generator(np.random.PCG64(3)).uniform(-1, 1, (100, 3))
    y, _ = trajectory(u, events="")
    x, worst = np.zeros(6), 0.0
    for k in range(len(u)):
        worst = max(worst, np.abs(np.r_[y[k, :3], y[k, 3:6] - theta[:3]] - x).max())
        x = A @ x + B @ u[k]
    assert worst < 1e-6 * np.abs(y[:, :3]).max() + 1e-8


def wscc9_grid(scale=1.0):
    load = scale * np.array(WSCC9_LOAD)
    return SwingGrid(
        buses=tuple(range(1, 10)), M=M, D=D, branches=tuple((i, j) for i, j, _ in WSCC9_EDGES),
        b=1 / np.array([x for *_, x in WSCC9_EDGES]), generation=scale * np.array(WSCC9_GENERATION), load=load,
    )  # fmt: skip


def linearised(grid, theta, tau=0.1):
    K = stiffness(grid.incidence(), grid.b, theta)
    K = K[:3, :3] - K[:3, 3:] @ np.linalg.solve(K[3:, 3:], K[3:, :3])
    X = np.block([[-np.diag(D / M), -K / M[:, None]], [np.eye(3), np.zeros((3, 3))]])
    step = expm(tau * np.block([[X, np.vstack([np.diag(1 / M), np.zeros((3, 3))])], [np.zeros((3, 9))]]))
    return step[:6, :6], step[:6, 6:]


def test_physical_modes():
    """The modes that physical lines give: 1.76 and 3.12 Hz."""
    modes = rates(wscc9_grid(), operating_point(wscc9_grid()))
    swinging = np.sort(modes.imag[modes.imag > 1])
    np.testing.assert_allclose(swinging / (2 * np.pi), [1.76, 3.12], atol=0.01)


def test_derivative_of_the_flows():
    grid, rng = wscc9_grid(), np.random.Generator(np.random.PCG64(4))
    A, theta = grid.incidence(), rng.normal(0, 0.5, 9)
    h = 1e-6
    numeric = np.array(
        [(flows(A, grid.b, theta + h * e) - flows(A, grid.b, theta - h * e)) / (2 * h) for e in np.eye(9)]
    )
    np.testing.assert_allclose(stiffness(A, grid.b, theta), numeric.T, atol=1e-7)


def test_a_load_step_without_control_shifts_all_frequencies_by_the_damping():
    stepper = wscc9_swing(noise=0.0, events="load 9 +0.3 @ 5").start(0)
    y = np.array([stepper.push(np.zeros(3)) for _ in range(300)])
    np.testing.assert_array_equal(np.abs(y[:6]) < 1e-9, True)
    np.testing.assert_allclose(y[-1], -0.3 / D.sum() / (2 * np.pi), rtol=1e-6)
    assert stepper.log == [(5, "load 9 +0.3 @ 5")]


def test_turbine_lag_is_the_exact_response_of_a_first_order_lag():
    stepper = wscc9_swing(lag=0.5, noise=0.0, events="").start(0)
    for _ in range(7):
        stepper.push([0.1, 0.0, 0.0])
    expected = WSCC9_GENERATION[0] + 0.1 * (1 - np.exp(-0.7 / 0.5))
    assert abs(stepper._power[0] - expected) < 1e-12


def test_a_machine_at_its_limit_gives_no_more():
    free, limited = (
        wscc9_swing(noise=0.0, events=events).start(0) for events in ("", "limit 2 0 1.65 @ 0")
    )  # fmt: skip
    for k in range(20):
        a, b = free.push([0.0, 0.02, 0.0]), limited.push([0.0, 0.5 if k else 0.02, 0.0])
    np.testing.assert_array_equal(a, b)


def test_trip_and_close_a_line():
    y, _ = trajectory(np.zeros((400, 3)), events="trip 4-7 @ 10; close 7-4 @ 200")
    theta = operating_point(wscc9_grid())
    relative = y[:, 3:] - y[:, 3:4]
    assert np.abs(relative[:10] - (theta - theta[0])).max() < 1e-9
    assert np.abs(relative[190] - (theta - theta[0])).max() > 0.05  # the power goes another way
    assert np.abs(relative[-1] - (theta - theta[0])).max() < 1e-6  # and back
    assert np.abs(y[-1, :3]).max() < 1e-6


def test_noise_comes_from_the_seed_and_has_the_level_asked_for():
    def run(seed):
        stepper = wscc9_swing(noise=1e-3, events="", substeps=1).start(seed)
        return np.array([stepper.push(np.zeros(3)) for _ in range(400)])

    first = run(3)
    np.testing.assert_array_equal(first, run(3))
    assert not np.array_equal(first, run(4))
    assert abs(first.std() * 2 * np.pi - 1e-3) < 1e-4


def test_a_lost_grid_says_so():
    stepper = wscc9_swing(noise=0.0, events="load 9 +60 @ 3").start(0)
    for _ in range(3):
        stepper.push(np.zeros(3))
    with pytest.raises(PlantError, match="lost synchronism"):
        stepper.push(np.zeros(3))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"inputs": "wheels"}, "choose machines or transfers"),
        ({"outputs": "f_4"}, "no output 'f_4'"),
        ({"outputs": "power_1"}, "no output"),
        ({"events": "load 9 0.3"}, "is not understood"),
        ({"events": "melt 9 @ 3"}, "is not understood"),
        ({"events": "load nine 1 @ 3"}, "is not understood"),
        ({"events": "load 19 1 @ 3"}, "no bus 19"),
        ({"events": "trip 1-2 @ 3"}, "no branch 1-2"),
        ({"events": "close 4-7 @ 3"}, "no branch 4-7 to close"),
        ({"events": "trip 4-7 @ 1; trip 5-7 @ 2"}, "leaves bus 7 without any machine"),
        ({"events": "limit 7 0 1 @ 0"}, "no machine at bus 7"),
        ({"events": "limit 2 2 1 @ 0"}, "lower limit exceeds"),
        ({"lag": -1.0}, "must not be negative"),
        ({"noise": float("nan")}, "must not be negative"),
    ],
)
def test_mistakes_are_named_before_the_run(options, message):
    with pytest.raises(PlantError, match=message):
        wscc9_swing(**options)


def test_inputs_are_checked():
    stepper = wscc9_swing().start(0)
    with pytest.raises(ShapeError):
        stepper.push([0.0, 0.0])
    with pytest.raises(ShapeError):
        stepper.push([0.0, np.nan, 0.0])


def test_events_are_sorted_and_keep_their_text():
    events = parse_events(" trip 4-7 @ 30 ; load 9 -.5e-1 @ 4;; limit 2 -1 1 @ 8")
    assert [(e.k, e.kind, e.buses, e.values) for e in events] == [
        (4, "load", (9,), (-0.05,)),
        (8, "limit", (2,), (-1.0, 1.0)),
        (30, "trip", (4, 7), ()),
    ]


def test_the_ieee_case_gives_the_same_schedule():
    """case9 schedules 163 and 85 MW and leaves 67 MW to the machine at the reference bus."""
    pandapower = pytest.importorskip("pandapower.networks")
    plant = swing_from_case(pandapower.case9(), name="case9", noise=0.0)
    assert "0.67 pu" in plant.notes[0]
    assert (plant.prior.q, plant.prior.s) == (5, 1)
    stepper = plant.start(0)
    y = np.array([stepper.push([0.05, 0.0, 0.0]) for _ in range(100)])
    assert y[-1].min() > 0
    assert stepper.residual < 1e-10


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of pandapower
@pytest.mark.parametrize("case", ["case39"])
def test_any_case_rests_at_its_operating_point_and_moves_when_pushed(case):
    pandapower = pytest.importorskip("pandapower.networks")
    rests_and_moves(swing_from_case(getattr(pandapower, case)(), name=case, noise=0.0))


def test_a_random_grid_rests_at_its_operating_point_and_moves_when_pushed():
    rng = np.random.Generator(np.random.PCG64(5))
    buses = np.zeros((30, 13))
    buses[:, 0], buses[:, 1], buses[:, 2] = np.arange(101, 131), 1, rng.uniform(0, 30, 30)
    buses[7, 1] = 3
    gen = np.zeros((6, 21))
    gen[:, 0], gen[:, 1], gen[:, 6], gen[:, 7] = (101, 108, 110, 115, 120, 125), 40.0, 100.0, 1
    ring = [(101 + i, 101 + (i + 1) % 30) for i in range(30)] + [(101 + i, 101 + (i + 9) % 30) for i in range(0, 30, 3)]
    branch = np.zeros((len(ring), 13))
    branch[:, :2], branch[:, 3], branch[:, 10] = ring, rng.uniform(0.01, 0.05, len(ring)), 1
    case = {"baseMVA": 100.0, "bus": buses, "gen": gen, "branch": branch}
    rests_and_moves(swing_from_case(case, noise=0.0, events="trip 101-102 @ 5; load 110 +0.1 @ 7"), at_rest=5)


def rests_and_moves(plant, at_rest=3):
    stepper, m = plant.start(0), len(plant.input_names)
    rest = np.array([stepper.push(np.zeros(m)) for _ in range(at_rest)])
    assert np.abs(rest).max() < 1e-9
    u = np.zeros(m)
    u[0] = 0.1
    pushed = np.array([stepper.push(u) for _ in range(10)])
    assert np.abs(pushed[-1]).max() > 1e-6
    assert stepper.residual < 1e-10


def test_unbalanced_powers_and_overloaded_lines_have_no_operating_point():
    grid = wscc9_grid()
    with pytest.raises(PlantError, match="must balance"):
        operating_point(SwingGrid(**{n: getattr(grid, n) for n in ("buses", "M", "D", "branches", "b", "load")},
                                  generation=np.ones(3)))  # fmt: skip
    with pytest.raises(PlantError, match="cannot carry"):
        operating_point(wscc9_grid(scale=20.0))
    run = SwingRun(G=np.eye(3), C=np.eye(3, 12), tau=0.1, substeps=0, lag=0.0, noise=np.zeros(3), events=())
    assert SwingStepper(grid, run, None).substeps == 6
