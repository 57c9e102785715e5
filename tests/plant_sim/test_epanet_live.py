# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""EPANET as a running plant: what the physics must keep, what goes wrong on the way, and mistakes."""

import gc

import numpy as np
import pytest
from epanet import toolkit

from plant_sim.demand import parse_demand
from plant_sim.epanet_live import LiveNetwork
from plant_sim.epanet_plant import epanet_from_inp, net3_epanet
from plant_sim.errors import PlantError, ShapeError
from plant_sim.water import NET3

MIDDLE = (0.6, 1.0)
LITTLE = """[JUNCTIONS]
A 10 0
B 5 4
C 0 6
[RESERVOIRS]
R 60
[TANKS]
T 20 3 1 6 12 0
[PIPES]
1 R A 500 300 120 0 OPEN
2 A T 400 250 120 0 OPEN
3 B C 400 200 120 0 OPEN
[VALVES]
V A B 200 PRV 40 0
[OPTIONS]
UNITS LPS
HEADLOSS H-W
[TIMES]
DURATION 24:00
[END]
"""


@pytest.fixture
def little(tmp_path):
    """A reservoir, a tank, a pressure reducing valve, two consumers."""
    path = tmp_path / "little.inp"
    path.write_text(LITTLE)
    return path


def speeds(seed, count):
    return np.random.Generator(np.random.PCG64(seed)).uniform((0.4, 0.8), (0.8, 1.2), (count, 2))


def inflow(network, tank):
    """Net flow into a tank, from the links around it [m3/s]."""
    total = 0.0
    for link in range(1, toolkit.getcount(network._handle, toolkit.LINKCOUNT) + 1):
        first, second = toolkit.getlinknodes(network._handle, link)
        flow = toolkit.getlinkvalue(network._handle, link, toolkit.FLOW)
        total += flow * ((second == tank.index) - (first == tank.index))
    return total


def test_water_is_conserved_in_every_tank_at_every_step():
    stepper = net3_epanet(outputs="level:1 level:2 level:3").start(0)
    network = stepper.network
    areas = [np.pi / 4 * toolkit.getnodevalue(network._handle, t.index, toolkit.TANKDIAM) ** 2 for t in network.tanks]
    for k, u in enumerate(speeds(1, 100)):
        network.solve(u, k)
        before = network.read()
        expected = [900 * inflow(network, tank) / area for tank, area in zip(network.tanks, areas, strict=True)]
        network.advance(k)
        after = [network.level(tank) for tank in network.tanks]
        assert np.abs(after - before - expected).max() < 1e-5
        assert np.abs(expected).max() > 1e-4
    assert stepper.log == []


@pytest.mark.parametrize("demand", ["constant", "diurnal", "file"])
def test_the_forecast_is_what_epanet_delivers(demand):
    stepper = net3_epanet(demand=demand, outputs="level:3 demand", swing=0.2).start(0)
    network, told = stepper.network, stepper.forecast(0, 120)
    junctions = [n for n in range(1, toolkit.getcount(network._handle, toolkit.NODECOUNT) + 1)
                 if toolkit.getnodetype(network._handle, n) == toolkit.JUNCTION]  # fmt: skip
    delivered = []
    for k in range(120):
        network.solve(MIDDLE, k)
        delivered.append(sum(toolkit.getnodevalue(network._handle, n, toolkit.DEMAND) for n in junctions))
        assert network.read()[1] == told[k, 0]
        network.advance(k)
    np.testing.assert_allclose(told[:, 0], delivered, rtol=1e-9)
    assert (np.ptp(told) > 0.05) == (demand != "constant")


def test_an_injection_adds_to_the_balance_of_the_network(little):
    plant = epanet_from_inp(little, inputs=["inject:C"], outputs=["flow:1", "flow:2", "flow:3"],
                            input_min=[0], input_max=[0.02], demand="constant")  # fmt: skip
    stepper = plant.start(0)
    still, helped = stepper.push([0.0]), stepper.push([0.004])
    np.testing.assert_allclose(still[2], 0.006, atol=1e-9)
    np.testing.assert_allclose(helped[2], 0.002, atol=1e-9)
    assert plant.D is None  # flows answer at once


def test_a_valve_holds_what_it_is_set_to(little):
    plant = epanet_from_inp(little, inputs=["valve:V"], outputs=["pressure:B", "level:T", "head:C"],
                            input_min=[20], input_max=[60])  # fmt: skip
    stepper = plant.start(0)
    for setting in (40.0, 30.0, 38.0):
        assert abs(stepper.push([setting])[0] - setting) < 1e-6
    assert plant.input_units == ("m",)
    assert plant.prior.q == 1


def test_a_tank_that_fills_and_empties_is_an_event_and_stays_within_its_ends():
    stepper = net3_epanet(outputs="level:3").start(0)
    levels = [stepper.push([0.8, 1.2])[0] for _ in range(60)]
    high = stepper.network.tanks[2].high
    assert (41, "tank 3 is full") in stepper.log
    assert "tank 3 is full" in stepper.status
    assert high - 1e-6 < max(levels) < high + 1e-6
    levels = [stepper.push([0.4, 0.8])[0] for _ in range(200)]
    texts = [text for _, text in stepper.log]
    assert "tank 3 is between its ends again" in texts
    assert "tank 2 is empty" in texts
    assert min(levels) >= stepper.network.tanks[2].low - 1e-6


def test_warnings_of_epanet_become_the_status_and_are_noted_once(little):
    text = little.read_text().replace("B 5 4", "B 5 2000")
    little.write_text(text)
    plant = epanet_from_inp(little, inputs=["valve:V"], outputs=["pressure:C"], input_min=[20], input_max=[60])
    stepper = plant.start(0)
    for _ in range(5):
        stepper.push([40.0])
    assert "EPANET: pressure below zero at A, B, C" in stepper.status
    said = [text for _, text in stepper.log if text.startswith("EPANET")]
    assert said
    assert len(said) == len(set(said))


def test_two_runs_side_by_side_give_the_same_bits():
    inputs = speeds(2, 60)
    first, second = (net3_epanet(demand="diurnal", outputs="level:3 pressure:61", noise=0.01).start(7) for _ in "ab")
    together = [(first.push(u), second.push(u)) for u in inputs]
    alone = net3_epanet(demand="diurnal", outputs="level:3 pressure:61", noise=0.01).start(7)
    for (a, b), u in zip(together, inputs, strict=True):
        c = alone.push(u)
        assert a.tobytes() == b.tobytes() == c.tobytes()


def test_levels_do_not_depend_on_the_input_of_their_instant():
    plant = net3_epanet(outputs="level:3 demand")
    low, high = plant.start(0), plant.start(0)
    assert low.push([0.4, 0.8])[0] == high.push([0.8, 1.2])[0]
    assert low.push(MIDDLE)[0] < high.push(MIDDLE)[0]
    np.testing.assert_array_equal(plant.D, np.zeros((2, 2)))


def test_a_stopped_pump_starts_again():
    stepper = epanet_from_inp(NET3, inputs=["pump:335", "pump:10"], outputs=["flow:335", "flow:10"],
                              input_min=[0, 0], input_max=[1, 1.2]).start(0)  # fmt: skip
    running, stopped, again = stepper.push(MIDDLE), stepper.push([0.6, 0.0]), stepper.push(MIDDLE)
    assert running[1] > 0.1
    assert abs(stopped[1]) < 1e-6
    assert again[1] > 0.1


def test_own_series_of_demand(tmp_path):
    path = tmp_path / "factors.txt"
    path.write_text("1\n1.5\n0.5\n")
    stepper = net3_epanet(demand=str(path), outputs="demand level:3").start(0)
    drawn = [stepper.push(MIDDLE)[0] for _ in range(6)]
    np.testing.assert_allclose(np.array(drawn) / drawn[0], [1, 1.5, 0.5, 1, 1.5, 0.5])
    for bad, message in (("1\n-1\n", "positive"), ("one\n", "must be numbers"), ("1,2\n3,4\n", "one a line")):
        path.write_text(bad)
        with pytest.raises(PlantError, match=message):
            parse_demand(str(path), 1.0, 0.1, 900)


def test_references_of_outputs_that_are_not_named_stay_where_they_began():
    plant = net3_epanet(outputs="pressure:61 level:3")
    (k0, first), (k1, second) = plant.references
    assert (k0, k1) == (0, 275)
    assert (first[1], second[1]) == (9.4, 9.2)
    assert first[0] == second[0] > 50


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"inputs": ["pump:V"]}, "'V' of little is no pump"),
        ({"inputs": ["valve:1"]}, "is no valve"),
        ({"inputs": ["inject:T"]}, "is no junction"),
        ({"inputs": ["speed:1"]}, "is not understood"),
        ({"inputs": []}, "at least one input"),
        ({"outputs": ["level:A"]}, "is no level"),
        ({"outputs": ["pressure:Z"]}, "has no node 'Z'"),
        ({"outputs": ["flow:Z"]}, "has no link 'Z'"),
        ({"dt": 0.5}, "whole seconds"),
        ({"demand": "sometimes"}, "neither known nor a file"),
        ({"multiplier": 0.0}, "must be positive"),
        ({"swing": 1.0}, "must lie in"),
        ({"noise": -1.0}, "must not be negative"),
        ({"path": "nowhere.inp"}, "no such file"),
    ],
)
def test_mistakes_are_named(little, change, message):
    given = {"path": little, "inputs": ["valve:V"], "outputs": ["level:T"], "input_min": [20], "input_max": [60]}
    given |= change
    with pytest.raises(PlantError, match=message):
        epanet_from_inp(given.pop("path"), **given)


def test_inputs_are_checked():
    stepper = net3_epanet().start(0)
    with pytest.raises(ShapeError):
        stepper.push([0.6])
    with pytest.raises(ShapeError):
        stepper.push([0.6, np.inf])


def test_a_network_that_is_no_longer_used_closes_its_project():
    network = LiveNetwork(NET3, ["pump:10"], ["level:3"], 900, parse_demand("constant", 1.0, 0.0, 900))
    closed = network.close
    assert closed.alive
    del network
    gc.collect()
    assert not closed.alive
