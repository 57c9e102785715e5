# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The water networks beside EPANET itself, wntr's own solver, and the published numbers."""

import json
import warnings
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from epanet import toolkit

from plant_sim import PlantError, hydraulics, net3
from plant_sim.heads import head_model
from plant_sim.hydraulics import PUMP, project, snapshot
from plant_sim.water import NET3, from_inp

WNTR = json.loads((Path(__file__).parent / "data" / "net3_hour5_wntr.json").read_text())


def epanet_heads(path, hour, change, sign):
    """EPANET's heads at ``hour`` and what was changed, once the levels of that hour are reached."""
    with warnings.catch_warnings(), project(Path(path)) as handle:
        warnings.simplefilter("ignore")
        toolkit.setoption(handle, toolkit.ACCURACY, 1e-8)
        toolkit.setoption(handle, toolkit.TRIALS, 500)
        toolkit.openH(handle)
        toolkit.initH(handle, 0)
        while toolkit.runH(handle) < hour * 3600:
            toolkit.nextH(handle)
        for i in range(toolkit.getcount(handle, toolkit.CONTROLCOUNT), 0, -1):
            toolkit.deletecontrol(handle, i)  # they would undo the change
        read = change(handle, sign)
        toolkit.runH(handle)
        nodes = range(1, toolkit.getcount(handle, toolkit.NODECOUNT) + 1)
        heads = {toolkit.getnodeid(handle, i): toolkit.getnodevalue(handle, i, toolkit.HEAD) for i in nodes}
        return heads, read()


def moved_heads(path, hour, change):
    """Change of all heads in EPANET at fixed levels, per unit of ``change``: central difference, by node name."""
    (up, more), (down, less) = (epanet_heads(path, hour, change, sign) for sign in (1, -1))
    return {name: (up[name] - down[name]) / (more - less) for name in up}


def inject(node, step=2e-5):
    def change(handle, sign):
        index = toolkit.getnodeindex(handle, node)
        toolkit.adddemand(handle, index, -sign * step, "", "")
        return lambda: -toolkit.getnodevalue(handle, index, toolkit.DEMAND)

    return change


def speed_up(pump, step=1e-4):
    def change(handle, sign):
        index = toolkit.getlinkindex(handle, pump)
        now = toolkit.getlinkvalue(handle, index, toolkit.SETTING)
        toolkit.setlinkvalue(handle, index, toolkit.SETTING, now + sign * step)
        return lambda: toolkit.getlinkvalue(handle, index, toolkit.SETTING)

    return change


def predicted_heads(path, hour, source):
    """What the model says of the same change: its algebraic part at fixed levels."""
    plant = from_inp(path, hour, inputs=[source], outputs=None, tau=1.0, discretisation="euler")
    system, model = plant.system, head_model(snapshot(path, hour))
    d = model.dynamic
    x = np.zeros(system.n)
    x[d:] = -np.linalg.solve(system.A[d:, d:], system.B[d:, 0])
    return dict(zip(plant.state_names, x, strict=True))


def agree(path, hour, source, change, rtol):
    have, want = predicted_heads(path, hour, source), moved_heads(path, hour, change)
    scale = max(abs(v) for v in want.values())
    for name, value in have.items():
        assert value == pytest.approx(want[name], rel=rtol, abs=rtol * scale), name


def test_net3_steady_state_agrees_with_wntr():
    network = snapshot(NET3, 5)
    assert len(network.nodes) == len(WNTR["heads"]) == 97
    assert len(network.links) == len(WNTR["flows"]) == 119
    for node in network.nodes:
        assert node.head == pytest.approx(WNTR["heads"][node.name], abs=5e-4)
    for link in network.links:
        assert link.flow == pytest.approx(WNTR["flows"][link.name], abs=2e-5)


def test_net3_numbers():
    network = snapshot(NET3, 5)
    model = head_model(network, first=("60", "61"))
    assert model.names[:8] == ("River", "Lake", "1", "2", "3", "60", "61", "10")
    assert (len(model.names), model.dynamic) == (97, 5)
    np.testing.assert_allclose(model.storage[:5], [1, 1, 527.2, 182.4, 1962.5], atol=0.05)
    assert not model.storage[5:].any()
    pipes = [link for link in network.links if link.kind != PUMP]
    assert len(pipes) == 117
    assert min(abs(link.flow) for link in pipes) == pytest.approx(1.5e-4, rel=0.02)  # all of them flow
    flows = {link.name: link for link in network.links}
    assert flows["10"].open
    assert not flows["335"].open
    assert (model.floored, model.left_out) == ((), ())


def test_net3_structure():
    plant = net3()
    assert plant.prior == (97, 5, 92, 1)
    eigenvalues = np.sort(np.linalg.eigvals(plant.system.weierstrass().A1).real)
    np.testing.assert_allclose(eigenvalues, [0.258, 0.574, 0.943, 1, 1], atol=5e-4)
    hours = 2.4 / (1 - eigenvalues[:3])
    np.testing.assert_allclose(hours, [3.24, 5.63, 42.3], rtol=2e-3)
    at_two = np.sort(np.linalg.eigvals(net3(hour=2).system.weierstrass().A1).real)
    np.testing.assert_allclose(2.4 / (1 - at_two[:3]), [5.51, 8.07, 80.9], rtol=2e-3)


def test_net3_plant():
    plant = net3()
    assert (plant.sample_time, plant.output_names, plant.steps) == (8640.0, ("R1", "T3"), 200)
    assert [(k, tuple(values)) for k, values in plant.references] == [(0, (5, 3)), (160, (3, 5))]
    assert {key: plant.settings[key] for key in ("N", "L", "T", "terminal")} == {
        "N": 5,
        "L": 12,
        "T": 100,
        "terminal": "equilibrium",
    }
    stepper = plant.start(0)
    np.testing.assert_allclose(stepper.push(np.zeros(3)), [4, 2], atol=1e-12)
    rng = np.random.Generator(np.random.PCG64(0))
    y = np.array([stepper.push(rng.uniform(-1, 1, 3)) for _ in range(200)])
    assert np.abs(y[:, 0] - 4).max() < 1e-9  # the Lake is a constant
    assert np.ptp(y[:, 1]) > 0.5
    assert not plant.system.B[:, [0, 2]].any()


def test_net3_dc_gain():
    """An injection of 1 m3/s at junction 60 raises tank 3 by 3.94 m in the end."""
    plant = net3()
    rest = plant.system.simulate(np.tile([0.0, 1.0, 0.0], (600, 1)))
    assert rest.y[-1, 1] == pytest.approx(3.94, abs=0.01)


def test_net3_reservoir_inputs():
    system = net3(inputs="all").system
    run = system.simulate(np.tile([1.0, 0.0, -0.5], (4, 1)))
    np.testing.assert_allclose(run.y[:, 0], [0, -0.5, -1.0, -1.5], atol=1e-12)
    np.testing.assert_allclose(run.x[:, 0], [0, 1, 2, 3], atol=1e-12)
    with pytest.raises(PlantError, match="choose junction, river, all"):
        net3(inputs="sea")


@pytest.mark.parametrize("hour", [5, 2])
def test_net3_linearisation_agrees_with_epanet(hour):
    agree(NET3, hour, "60", inject("60"), 2e-3)


def test_net3_pump_speed_agrees_with_epanet():
    agree(NET3, 2, "pump:335", speed_up("335"), 5e-3)


@pytest.mark.parametrize("curve", ["one", "three", "many"])
@pytest.mark.parametrize(("formula", "rough"), [("H-W", 110), ("D-W", 0.3), ("C-M", 0.012)])
def test_formulas_agree_with_epanet(town, formula, rough, curve):
    path = town(formula=formula, rough=rough, curve=curve)
    agree(path, 0, "J3", inject("J3"), 2e-3)
    agree(path, 0, "pump:U", speed_up("U"), 2e-3)


@pytest.mark.parametrize("valve", ["TCV 5", "PRV 20", "PSV 40", "FCV 3", "PBV 4", "GPV G"])
def test_valves_agree_with_epanet(town, valve):
    path = town(valve=valve)
    agree(path, 0, "J3", inject("J3"), 2e-3)
    if valve != "PBV 4":
        agree(path, 0, "J1", inject("J1"), 2e-3)


@pytest.mark.parametrize(
    ("option", "section"),
    [
        ("Emitter Exponent 0.6", "[EMITTERS]\n J3 2"),
        ("Demand Model PDA\n Required Pressure 60\n Pressure Exponent 0.5", ""),
    ],
)
def test_pressure_dependent_outflow_agrees_with_epanet(town, option, section):
    path = town()
    path.write_text(path.read_text().replace("[OPTIONS]", f"{section}\n[OPTIONS]\n {option}"))
    assert sum(node.relief > 0 for node in snapshot(path, 0).nodes) == (1 if section else 4)
    agree(path, 0, "pump:U", speed_up("U"), 2e-3)


def test_constant_power_pump_agrees_with_epanet(town):
    path = town()
    path.write_text(path.read_text().replace("HEAD C SPEED 0.9", "POWER 15"))
    agree(path, 0, "J3", inject("J3"), 2e-3)
    with pytest.raises(PlantError, match="pump U runs at constant power"):
        from_inp(path, 0, inputs=["pump:U"])


@pytest.mark.parametrize(("name", "n", "q"), [("Net1", 11, 2), ("Net2", 36, 1)])
def test_networks_that_others_ship(name, n, q):
    package = find_spec("wntr")
    if package is None:
        pytest.skip("wntr, which ships the file, is not installed")
    plant = from_inp(Path(package.submodule_search_locations[0]) / f"library/networks/{name}.inp", 1, inputs=["22"])
    assert plant.prior == (n, q, n - q, 1)


def test_valve_that_holds_a_head_passes_the_injection_on(town):
    path = town(valve="PRV 20")
    plant = from_inp(path, 0, inputs=["J4", "J2"], outputs=["J4", "J2", "T"], tau=60.0)
    run = plant.system.simulate(np.eye(2)[[0, 0, 0]])
    np.testing.assert_allclose(run.y[:, 0], 0, atol=1e-12)  # J4 is held
    other = plant.system.simulate(np.eye(2)[[1, 1, 1]])
    np.testing.assert_allclose(run.y[:, 1:], other.y[:, 1:], atol=1e-12)  # what enters J4 is saved at J2
    agree(path, 0, "J4", inject("J4"), 2e-3)


def test_water_is_conserved(town):
    """What is injected ends in the tank or in a reservoir, step by step."""
    path = town()
    plant = from_inp(path, 0, inputs=["J1"], tau=60.0, discretisation="euler")
    model = head_model(snapshot(path, 0))
    assert model.names[:3] == ("R", "LOW", "T")
    run = plant.system.simulate(np.ones((5, 1)))
    stored = model.storage[2] * np.diff(run.x[:, 2])
    into_reservoirs = -60.0 * run.x[:-1] @ model.flow.sum(axis=0)
    np.testing.assert_allclose(stored + into_reservoirs, 60.0, rtol=1e-9)


def test_cut_off_parts_are_named(town):
    path = town()
    closed = (
        path.read_text()
        .replace("[OPTIONS]", "[STATUS]\n V Closed\n P5 Closed\n[OPTIONS]")
        .replace(" J4 0 5", " J4 0 0")
    )
    path.write_text(closed)
    plant = from_inp(path, 0, inputs=["J1"])
    assert any("left out" in note and "J4" in note for note in plant.notes)
    assert "J4" not in plant.state_names
    with pytest.raises(PlantError, match="node J4 is cut off by closed links"):
        from_inp(path, 0, inputs=["J4"])


def test_links_at_rest_are_named():
    assert any("at rest" in note and "333" in note for note in net3(hour=2).notes)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"inputs": ["nowhere"]}, "no node 'nowhere'"),
        ({"outputs": ["nowhere"]}, "no node 'nowhere'"),
        ({"inputs": ["pump:nope"]}, "no pump 'nope'"),
        ({"inputs": ["pump:335"]}, "pump 335 is off at this hour"),
        ({"inputs": []}, "name nodes as inputs"),
        ({"inputs": ["Lake"]}, "Lake is a reservoir"),
        ({"tau": 0.0}, "tau must be positive"),
        ({"hour": 0.37}, r"its steps lead to hour=|no solution at hour 0.37"),
    ],
)
def test_wrong_requests(options, message):
    with pytest.raises(PlantError, match=message):
        from_inp(NET3, **({"hour": 5} | options))


def test_unusable_files(town, tmp_path):
    with pytest.raises(PlantError, match="no such file"):
        from_inp(tmp_path / "none.inp")
    path = town()
    good = path.read_text()
    for text, message in (
        (good.replace("P1 J1 J2", "P1 J1 J9"), r"EPANET cannot read town.inp: Error 203: undefined node J9"),
        (good.replace("[PIPES]", "[PIPPES]"), "EPANET cannot read town.inp"),
        ("", "no steady state of town.inp up to hour 0: Error 223: not enough nodes"),
    ):
        path.write_text(text)
        with pytest.raises(PlantError, match=message):
            from_inp(path, 0)


def test_no_convergence_is_said(town, monkeypatch):
    monkeypatch.setattr(hydraulics, "TRIALS", 2)
    with pytest.raises(PlantError, match=r"does not converge on town.inp at hour 0: relative flow change \d"):
        snapshot(town(), 0)


def test_any_network_has_the_same_interface():
    plant = from_inp(NET3, 2, tau=1800.0)
    assert plant.input_names == ("pump:10", "pump:335")
    assert plant.output_names == ("1", "2", "3")
    assert plant.prior == (97, 5, 92, 1)
    assert plant.system.structure().r_observable
