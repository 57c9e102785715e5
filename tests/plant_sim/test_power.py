# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

import re
import warnings
from pathlib import Path

import numpy as np
import pytest
from scipy import signal

from plant_sim import DescriptorSystem, PlantError, wscc9
from plant_sim.grid_case import load_case, parse_matpower
from plant_sim.power import WSCC9_DAMPING, WSCC9_EDGES, WSCC9_INERTIA, from_case
from plant_sim.swing import continuous, discretise, laplacian

CASE9 = Path(__file__).parent / "data" / "case9.m"
# MW on the nine branches of case9, by the DC power flow of pypower 5.1
CASE9_FLOWS = [67.0, 28.9673913, -61.0326087, 85.0, 23.9673913, -76.0326087, -163.0, 86.9673913, -38.0326087]


def table(case):
    return {"baseMVA": case["baseMVA"], **{k: np.array(case[k], dtype=float) for k in ("bus", "gen", "branch")}}


def case9():
    return parse_matpower(CASE9.read_text())


def dc_flows(case, power):
    """Branch flows [MW] of the model's own steady state when ``power`` [MW] is injected at each bus, and the plant."""
    plant = from_case(case, inputs=load_case(case).buses, name="case")
    system = plant.system
    buses = [int(name.removeprefix("P_")) for name in plant.input_names]
    u = np.array([power[b] for b in buses]) / case["baseMVA"]
    x = np.linalg.lstsq(system.E - system.A, system.B @ u, rcond=None)[0]
    assert np.abs((system.E - system.A) @ x - system.B @ u).max() < 1e-9
    theta = dict(zip(buses, x[-len(buses) :], strict=True))
    branch = case["branch"]
    flows = [
        case["baseMVA"] * (theta[int(f)] - theta[int(t)]) / (row_x * (tap or 1.0)) * status
        for f, t, row_x, tap, status in branch[:, [0, 1, 3, 8, 10]]
    ]
    return np.array(flows), plant


def test_case9_flows_are_those_of_a_dc_power_flow():
    case = case9()
    power = dict.fromkeys(range(1, 10), 0.0) | {1: 67.0, 2: 163.0, 3: 85.0, 5: -90.0, 7: -100.0, 9: -125.0}
    flows, plant = dc_flows(case, power)
    np.testing.assert_allclose(flows, CASE9_FLOWS, atol=1e-6)
    assert plant.prior == (12, 6, 6, 1)


@pytest.mark.filterwarnings("ignore::PendingDeprecationWarning")  # pypower uses numpy.matrix
@pytest.mark.parametrize(("name", "n", "q"), [("case9", 12, 6), ("case39", 49, 20), ("case118", 172, 108)])
def test_flows_agree_with_pypower(name, n, q):
    pypower = pytest.importorskip("pypower.api")
    case = getattr(pypower, name)()
    case["gen"] = np.asarray(case["gen"], dtype=float)  # case9 has integers there, and would truncate the slack
    result, success = pypower.rundcpf(case, pypower.ppoption(VERBOSE=0, OUT_ALL=0))
    assert success
    power = {int(row[0]): -row[2] - row[4] for row in result["bus"]}
    for row in result["gen"]:
        power[int(row[0])] += row[1] * (row[7] > 0)
    flows, plant = dc_flows(table(case), power)
    np.testing.assert_allclose(flows, result["branch"][:, 13], atol=1e-6)
    assert plant.prior == (n, q, n - q, 1)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # pandapower about its own data
@pytest.mark.parametrize("name", ["case9", "case39"])
def test_pandapower_nets_give_the_same_grid(name):
    pypower = pytest.importorskip("pypower.api")
    networks = pytest.importorskip("pandapower.networks")
    ours = load_case(table(getattr(pypower, name)()))
    theirs = load_case(getattr(networks, name)())
    assert (len(theirs.buses), theirs.machines, len(theirs.branches)) == (
        len(ours.buses),
        ours.machines,
        len(ours.branches),
    )
    spectra = [
        np.sort(np.linalg.eigvalsh(laplacian(len(grid.buses), grid.branches))) for grid in (ours, theirs)
    ]  # fmt: skip
    np.testing.assert_allclose(spectra[1], spectra[0], rtol=2e-3, atol=1e-9)  # pandapower's lines are in km and ohm


def test_wscc9_numbers():
    """The published grid: slow part in (omega, theta_gen), eigenvalues, load angles."""
    system = wscc9().system
    form = system.weierstrass()
    assert (form.q, form.r, form.s) == (6, 6, 1)
    np.testing.assert_allclose(form.B2, 0, atol=1e-12)
    T = form.P[:6, : form.q]  # z1 -> (omega, theta_gen)
    A1 = [
        [0.9, 0, 0, -0.023446, 0.011868, 0.011579],
        [0, 0.8, 0, 0.043631, -0.084742, 0.041111],
        [0, 0, 0.7, 0.090458, 0.087361, -0.177819],
        [0.1, 0, 0, 1, 0, 0],
        [0, 0.1, 0, 0, 1, 0],
        [0, 0, 0.1, 0, 0, 1],
    ]
    B1 = [[0.8, 0.8, 0], [-2.941176, 0, 2.941176], [0, -6.25, -6.25], [0] * 3, [0] * 3, [0] * 3]
    np.testing.assert_allclose(T @ form.A1 @ np.linalg.inv(T), A1, atol=6e-7)
    np.testing.assert_allclose(T @ form.B1, B1, atol=6e-7)
    expected = [0.764390, 0.880288 - 0.055781j, 0.880288 + 0.055781j, 0.937517 - 0.038475j, 0.937517 + 0.038475j, 1]
    np.testing.assert_allclose(np.sort_complex(np.linalg.eigvals(form.A1)), expected, atol=6e-7)
    loads = form.P[6:, : form.q] @ np.linalg.inv(T)
    np.testing.assert_allclose(loads[0], [0, 0, 0, 0.494694, 0.255767, 0.249539], atol=6e-7)
    np.testing.assert_allclose(loads.sum(axis=1), 1, atol=1e-12)


def test_wscc9_plant():
    plant = wscc9()
    assert (plant.name, plant.variant, plant.sample_time, plant.steps) == ("wscc9", "transfers", 0.1, 200)
    assert plant.output_names == ("x1", "c0")
    assert plant.prior == (12, 6, 6, 1)
    assert [(k, tuple(values)) for k, values in plant.references] == [(0, (3, 3)), (151, (1, 5))]
    assert {key: plant.settings[key] for key in ("N", "L", "T", "terminal")} == {
        "N": 6,
        "L": 14,
        "T": 104,
        "terminal": "none",
    }
    assert wscc9("text").settings["Q"] == [5.0, 0.0]
    assert wscc9("full").output_names == ("x1", "x7")
    with pytest.raises(PlantError, match="no variant 'wrong': choose full, transfers, text"):
        wscc9("wrong")


def test_wscc9_starts_at_five_times_a_uniform_draw():
    plant = wscc9()
    z10 = 5 * np.random.Generator(np.random.PCG64([11, 0])).random(6)
    stepper = plant.start(11)
    form = plant.system.weierstrass()
    np.testing.assert_allclose(form.P[:6, :6] @ stepper.z1, z10, atol=1e-12)
    y = stepper.push(np.zeros(3))
    M, D = np.array(WSCC9_INERTIA), np.array(WSCC9_DAMPING)
    np.testing.assert_allclose(y, [z10[0], (M @ z10[:3] + D @ z10[3:]) / D.sum()], atol=1e-12)


@pytest.mark.parametrize("variant", ["transfers", "text"])
def test_transfers_never_move_c0(variant):
    plant = wscc9(variant)
    stepper = plant.start(0)
    rng = np.random.Generator(np.random.PCG64(1))
    u = rng.uniform(-1, 1, (200, 3))
    run = plant.system.simulate(u, stepper.z1)
    M, D = np.array(WSCC9_INERTIA), np.array(WSCC9_DAMPING)
    c0 = (run.x[:, :3] @ M + run.x[:, 3:6] @ D) / D.sum()
    assert np.ptp(c0) < 1e-10
    full = wscc9("full").system.simulate(u, stepper.z1)
    assert np.ptp((full.x[:, :3] @ M + full.x[:, 3:6] @ D) / D.sum()) > 1


def matrices(case="published"):
    """Continuous matrices of the 9-bus grid."""
    edges = WSCC9_EDGES if case == "published" else load_case(case9()).branches
    M, D = np.array(WSCC9_INERTIA), np.array(WSCC9_DAMPING)
    return continuous(M, D, laplacian(9, edges), np.vstack([np.eye(3), np.zeros((6, 3))]))


def reduced(E, K, F):
    """Kron-reduced state-space model of the machines: an independent elimination of the loads."""
    A = -K[:6, :6] + K[:6, 6:] @ np.linalg.solve(K[6:, 6:], K[6:, :6])
    return np.linalg.solve(E[:6, :6], A), np.linalg.solve(E[:6, :6], F[:6])


@pytest.mark.parametrize("method", ["euler", "implicit", "exact"])
def test_discretisation_agrees_with_scipy_on_the_reduced_model(method):
    E, K, F = matrices()
    system = DescriptorSystem(*discretise(E, K, F, 6, 0.1, method), np.eye(12)[[0, 4]])
    names = {"euler": "euler", "implicit": "backward_diff", "exact": "zoh"}
    A, B, *_ = signal.cont2discrete((*reduced(E, K, F), np.eye(2, 6), np.zeros((2, 3))), 0.1, method=names[method])
    u = np.random.Generator(np.random.PCG64(0)).uniform(-1, 1, (30, 3))
    x = np.zeros((30, 6))
    if method == "implicit":  # scipy's backward difference shifts its state; the recursion itself is the reference
        Ac, Bc = reduced(E, K, F)
        A, B = np.linalg.inv(np.eye(6) - 0.1 * Ac), np.linalg.solve(np.eye(6) - 0.1 * Ac, 0.1 * Bc)
    for k in range(29):
        x[k + 1] = A @ x[k] + B @ u[k]
    np.testing.assert_allclose(system.simulate(u).y, x[:, [0, 4]], atol=1e-12)


def test_euler_limits():
    """Euler at 0.1 s is stable on the published weights (up to 0.849 s), not on the physical ones (up to 0.00718 s)."""
    E, K, F = matrices()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        discretise(E, K, F, 6, 0.84, "euler")
    with pytest.warns(UserWarning, match=r"stable up to 0\.849"):
        discretise(E, K, F, 6, 0.86, "euler")
    with pytest.warns(UserWarning, match=r"stable up to 0\.00718"):
        A = discretise(*matrices("physical"), 6, 0.1, "euler")[1]
    assert A.shape == (12, 12)


@pytest.mark.parametrize("method", ["implicit", "exact"])
def test_other_discretisations_are_stable(method):
    plant = from_case(CASE9, tau=0.5, discretisation=method)
    assert np.abs(np.linalg.eigvals(plant.system.weierstrass().A1)).max() < 1 + 1e-9
    assert plant.name == "case9"


def test_load_buses_are_algebraic_inputs():
    plant = from_case(case9(), inputs=[1, 5], outputs=["omega_1", "theta_5"])
    D0 = plant.system.weierstrass().markov()[0]
    assert abs(D0[1, 1]) > 1e-3  # an injection at a load bus moves its angle at once
    np.testing.assert_allclose(D0[0], 0, atol=1e-12)
    np.testing.assert_allclose(D0[:, 0], 0, atol=1e-12)


def test_machine_constants():
    """One pu for 0.1 s gives the machines together a momentum sum M omega of 0.1 pu s, which D / M = d lets decay."""
    u = np.zeros((20, 3))
    u[0, 0] = 1.0
    M = 2 * np.array([23.64, 6.4, 3.01]) / (2 * np.pi * 60)
    free = from_case(case9(), inertia=[23.64, 6.4, 3.01], damping=0.0)
    np.testing.assert_allclose(free.system.simulate(u).y[1:] @ M, 0.1, rtol=1e-9)
    damped = from_case(case9(), inertia=[23.64, 6.4, 3.01], damping=0.5).system.simulate(u).y @ M
    np.testing.assert_allclose(damped[2:] / damped[1:-1], np.exp(-0.05), rtol=1e-9)


def test_machines_at_one_bus_are_merged_and_stopped_ones_ignored():
    case = case9()
    case["gen"] = np.vstack([case["gen"], case["gen"][1], case["gen"][2]])
    case["gen"][-1, 7] = 0
    grid = load_case(case)
    assert grid.machines == 3
    np.testing.assert_allclose(grid.ratings, [1, 2, 1])


def test_matpower_text():
    text = CASE9.read_text()
    case = parse_matpower(text)
    assert (case["bus"].shape[0], case["gen"].shape[0], case["branch"].shape[0]) == (9, 3, 9)
    spaced = parse_matpower(
        re.sub(r"\t", " , ", text.replace("\t1\t4", "\t1\t4", 1)).replace("[\n ,", "[\n").replace("\n ,", "\n")
    )
    np.testing.assert_array_equal(spaced["branch"], case["branch"])


def broken(**changes):
    case = case9()
    for key, change in changes.items():
        change(case[key])
    return case


@pytest.mark.parametrize(
    ("case", "options", "message"),
    [
        ("nowhere.m", {}, "no such file: nowhere.m"),
        ({"bus": np.eye(3)}, {}, "the case has no table gen"),
        ({**case9(), "bus": np.ones((3, 1))}, {}, "bus must have at least 3 columns"),
        (broken(branch=lambda t: t.__setitem__((3, 3), 0.0)), {}, "branch 3-6 has no reactance"),
        (broken(branch=lambda t: t.__setitem__((0, 10), 0.0), gen=lambda t: t.__setitem__((0, 7), 0.0)), {},
         r"no machine reaches 1 buses \(1\)"),
        (broken(gen=lambda t: t.__setitem__((slice(None), 7), 0.0)), {}, "no machine in service"),
        (broken(branch=lambda t: t.__setitem__((2, 3), np.nan)), {}, r"branch\[2, 2\] is nan"),
        (case9(), {"inputs": [77]}, "no bus 77"),
        (case9(), {"outputs": ["omega_5"]}, "bus 5 of grid has no machine"),
        (case9(), {"outputs": ["speed"]}, "no output 'speed'"),
        (case9(), {"inertia": 0.0}, "positive inertia"),
        (case9(), {"tau": -1.0}, "tau must be positive"),
        (case9(), {"discretisation": "magic"}, "choose euler, implicit or exact"),
    ],
)  # fmt: skip
def test_unusable_cases_say_why(case, options, message):
    with pytest.raises(PlantError, match=message):
        from_case(case, **options)


def test_unreadable_files_say_why(tmp_path):
    for name, text, message in (
        ("a.m", "mpc.bus = [1 2];", "no table mpc.gen"),
        ("b.m", "mpc.bus = [1 2; 3];\nmpc.gen=[1];\nmpc.branch=[1];", "mpc.bus is not a table"),
        ("c.txt", "", "case files are MATPOWER .m files"),
        ("d.json", '{"_module": "pandapower.auxiliary"}', "pandapower.from_json"),
    ):
        path = tmp_path / name
        path.write_text(text)
        with pytest.raises(PlantError, match=message):
            load_case(path)
