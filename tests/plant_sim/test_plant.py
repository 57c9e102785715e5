# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

import dataclasses
import re
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, entry_points, version
from pathlib import Path

import numpy as np
import pytest

from plant_sim import PlantError, ShapeError, describe, net3, random_system, wscc9
from plant_sim.plant import suggested_settings
from plant_sim.plant_file import load
from plant_sim.random_systems import order, random_modes

CASE9 = Path(__file__).parent / "data" / "case9.m"

TWO_TANKS = """
name: two_tanks
description: A pump fills the upper of two tanks.
sample_time: 2.0
A: [[0.9, 0.0, 0.0], [0.1, 0.8, 0.0], [0.0, 0.2, -1.0]]
E: [[1, 0, 0], [0, 1, 0], [0, 0, 0]]
B: [[0.5], [0.0], [0.0]]
C: [[0, 1, 0], [0, 0, 1]]
input_names: [pump]
input_units: [L/s]
output_names: [level, outflow]
output_units: [m, L/s]
state_names: [upper, lower, outflow]
input_min: [0.0]
input_max: 2.0
initial: {low: [0, 0, 0], high: [1, 2, 0]}
references:
  - {k: 0, values: [1.0, 0.2]}
  - {k: 50, values: [2.0, 0.4]}
settings: {N: 5, terminal: none}
steps: 80
"""


def written(folder, text, name="plant.yaml"):
    path = folder / name
    path.write_text(text)
    return path


def test_yaml_with_matrices(tmp_path):
    plant = load(written(tmp_path, TWO_TANKS))
    assert (plant.name, plant.sample_time, plant.steps) == ("two_tanks", 2.0, 80)
    assert plant.prior == (3, 2, 1, 1)
    assert (plant.input_names, plant.output_units) == (("pump",), ("m", "L/s"))
    np.testing.assert_array_equal([plant.input_min, plant.input_max], [[0], [2]])
    assert [(k, tuple(v)) for k, v in plant.references] == [(0, (1.0, 0.2)), (50, (2.0, 0.4))]
    assert (plant.settings["N"], plant.settings["terminal"]) == (5, "none")
    assert plant.settings["L"] > 0
    draws = np.array([plant.start(seed).push([0.0]) for seed in range(200)])
    np.testing.assert_allclose(draws[:, 1], 0.2 * draws[:, 0], atol=1e-12)
    assert 0 <= draws[:, 0].min() < 0.05
    assert 1.95 < draws[:, 0].max() <= 2


def test_yaml_with_a_grid(tmp_path):
    written(tmp_path, CASE9.read_text(), "case9.m")
    grid = "grid: {file: case9.m, tau: 0.05, inputs: [1, 2], outputs: [omega_1, theta_5]}"
    text = f"{grid}\nsteps: 60\ninput_max: 0.5\ninput_min: -0.5"
    plant = load(written(tmp_path, text))
    assert (plant.name, plant.sample_time, plant.steps) == ("case9", 0.05, 60)
    assert plant.output_names == ("omega_1", "theta_5")
    np.testing.assert_array_equal(plant.input_max, [0.5, 0.5])


def test_yaml_with_a_water_network(tmp_path):
    from plant_sim.water import NET3

    text = f"name: my_net\nwater: {{file: {NET3}, hour: 5, inputs: ['60'], tau: 600}}\ninitial: {[1.0] * 97}"
    plant = load(written(tmp_path, text))
    assert (plant.name, plant.prior) == ("my_net", (97, 5, 92, 1))
    np.testing.assert_allclose(plant.start(0).push([0.0]), [1, 1, 1], atol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("sample_time: 2.0", ""), "plant.yaml: the file lacks sample_time"),
        (("sample_time: 2.0", "sample_time: -1"), "sample_time must be a positive number"),
        (("steps: 80", "stepps: 80"), "unknown key 'stepps': it may hold A, B, C"),
        (("[0.1, 0.8, 0.0]", "[0.1, 0.8]"), "plant.yaml: A must be a real matrix: rows differ in length"),
        (("[0.0, 0.2, -1.0]", "[0.0, 0.2, 0.0]"), "plant.yaml: .*singular|column 2"),
        (("B: [[0.5], [0.0], [0.0]]", "B: [[0.5], [0.0]]"), r"B must have shape \(3, any\)"),
        (("input_names: [pump]", "input_names: [a, b]"), "2 inputs and 2 outputs need as many units"),
        (("input_max: 2.0", "input_max: -2.0"), "input_min must be below input_max"),
        (("values: [2.0, 0.4]", "values: [2.0]"), r"reference must have shape \(2\)"),
        (("{k: 50,", "{k: -50,"), "references must be in order of k"),
        (("{k: 50,", "{"), "a key 'k' is missing"),
        (("{low: [0, 0, 0],", "{low: [0, 0],"), r"initial.low must have shape \(3\)"),
        (("state_names: [upper, lower, outflow]", "state_names: [upper]"), "3 states, got 1 names"),
        (("A: [[", "A: [[[["), "plant.yaml is not YAML"),
        (("name: two_tanks", "grid: {file: none.m}"), "unknown key"),
    ],
)
def test_wrong_yaml_says_what_is_wrong(tmp_path, change, message):
    assert change[0] in TWO_TANKS
    with pytest.raises(PlantError, match=message):
        load(written(tmp_path, TWO_TANKS.replace(*change)))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("grid: {file: none.m}", "no such file"),
        ("grid: {tau: 1.0}", "section grid lacks file"),
        ("water: {file: none.inp, colour: blue}", "section water: .*colour"),
        ("water: 3", "plant.yaml: "),
        ("- 1", "must hold keys and values"),
    ],
)
def test_wrong_sections_say_what_is_wrong(tmp_path, text, message):
    with pytest.raises(PlantError, match=message):
        load(written(tmp_path, text))
    with pytest.raises(PlantError, match="No such file"):
        load(tmp_path / "other.yaml")


def test_plants_start_from_their_seed():
    plant = wscc9()
    runs = []
    for seed in (1, 1, 2):
        stepper = plant.start(seed)
        runs.append(np.array([stepper.push(np.ones(3)) for _ in range(5)]).tobytes())
    assert runs[0] == runs[1] != runs[2]


def test_reference_holds_from_its_sample_on():
    plant = net3()
    assert [tuple(plant.reference(k)) for k in (0, 159, 160, 500)] == [(5, 3), (5, 3), (3, 5), (3, 5)]
    assert dataclasses.replace(plant, references=((3, [1.0, 2.0]),)).reference(2) is None


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"sample_time": float("nan")}, "sample_time"),
        ({"input_units": ("pu",)}, "units"),
        ({"output_names": ("a",), "output_units": ("b",)}, "3 inputs and 2 outputs, the names are for 3 and 1"),
        ({"input_min": [0.0]}, "input_min must have shape"),
        ({"D": np.zeros((2, 2))}, "D must have shape"),
        ({"references": ((0, [np.nan, 0.0]),)}, r"reference\[0\] is nan"),
    ],
)
def test_inconsistent_plants_are_refused(changes, message):
    with pytest.raises(ShapeError, match=message):
        dataclasses.replace(wscc9(), **changes)


def test_plants_are_immutable():
    plant = wscc9()
    with pytest.raises(ValueError, match="read-only"):
        plant.input_min[0] = 0
    with pytest.raises(TypeError):
        plant.settings["N"] = 3


def test_description_prints_the_numbers():
    text = describe(wscc9())
    for part in (
        "n = 12, q = 6, r = 6, s = 1",
        "1.000000, 0.937517 +- 0.038475i, 0.880288 +- 0.055781i, 0.764390",
        "R-controllable: NO, 5 of 6, lost at lambda = 1.000000",
        "R-observable: yes, 6 of 6",
        "C-controllable: NO",
        "omega_1 + 0.272 omega_2 + 0.128 omega_3 + theta_1 + 0.544 theta_2 + 0.384 theta_3",
        "reference     from k = 0: (3, 3) is no steady state",
    ):
        assert part in text
    text = describe(net3())
    for part in (
        "n = 97, q = 5, r = 92, s = 1",
        "R-controllable: NO, 3 of 5, lost at lambda = 1.000000, 1.000000",
        "conserved     River",
        "R1: 4 only m",
        "capped at 1000 m2/s: 20, 40, 50",
        "(3, 5) is no steady state, 1 away from one",
    ):
        assert part in text
    assert "(5, 3) can be held" in describe(net3(inputs="all"))


def test_description_when_nothing_can_rest(tmp_path):
    ramp = "sample_time: 1.0\nA: [[1.0]]\nB: [[1.0]]\nC: [[1.0]]\n"
    assert "at rest       y1: any value" in describe(load(written(tmp_path, ramp)))
    text = describe(load(written(tmp_path, ramp + "input_min: 0.5\ninput_max: 1.0")))
    assert "at rest       no steady state respects the input limits" in text


def test_description_of_a_nonlinear_plant():
    plant = dataclasses.replace(wscc9(), system=None, state_names=())
    assert "nonlinear; prior n = 12, q = 6, r = 6, s = 1" in describe(plant)


def test_settings_let_the_record_have_full_rank(planted_systems):
    for planted in planted_systems:
        chosen = suggested_settings(planted.system)
        depth = chosen["N"] + chosen["L"]
        assert chosen["T"] - depth + 1 >= planted.system.m * depth + planted.q
        assert chosen["N"] >= planted.s


def test_entry_points_lead_to_the_plants():
    try:
        version("ros2-deepc")
    except PackageNotFoundError:
        pytest.skip("the distribution is not installed")
    found = {entry.name: entry.load() for entry in entry_points(group="ros2_deepc.plants")}
    assert found["wscc9"] is wscc9
    assert found["net3"] is net3


def test_import_is_light():
    code = (
        "import sys, plant_sim; print([n for n in ('epanet', 'rclpy', 'scipy.optimize', 'yaml') if n in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True,
                          env={"PYTHONPATH": ":".join(filter(None, sys.path))})  # fmt: skip
    assert done.stdout.strip() == "[]"


def test_random_systems_come_from_their_seed():
    first, again, other = (random_system(m=2, p=1, q=3, blocks=[2], seed=seed) for seed in (1, 1, 2))
    assert first.system.A.tobytes() == again.system.A.tobytes() != other.system.A.tobytes()
    assert first.blocks == (2,)


def test_random_systems_have_the_asked_condition():
    planted = random_system(m=1, p=1, q=3, blocks=[2], conditioning=50.0, seed=0)
    assert np.linalg.cond(planted.S) == pytest.approx(50, rel=1e-6)
    assert np.linalg.cond(planted.P) == pytest.approx(50, rel=1e-6)
    target = np.block([[np.eye(3), np.zeros((3, 2))], [np.zeros((2, 3)), planted.N]])
    np.testing.assert_allclose(planted.S @ planted.system.E @ planted.P, target, atol=1e-12)


def test_random_modes_fill_the_order():
    rng = np.random.Generator(np.random.PCG64(0))
    for q in range(8):
        modes = random_modes(q, rng, radius=(0.5, 0.6))
        assert order(modes) == q
        assert all(0.5 <= abs(z) <= 0.6 for z in modes)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"q": 1, "uncontrollable": [0.5, 0.6]}, "at least 2"),
        ({"q": 0}, "at least one state"),
        ({"q": 2, "blocks": [0]}, "must be positive"),
        ({"q": 2, "modes": [0.5]}, "modes take 1 states, but 2 are left"),
        ({"q": 2, "blocks": [1], "uncontrollable_blocks": 2}, "only 1 Jordan blocks"),
        ({"q": 2, "modes": [0.5, 0.5]}, "fewer equal eigenvalues"),
    ],
)
def test_impossible_random_systems_are_refused(arguments, message):
    with pytest.raises(PlantError, match=message):
        random_system(m=1, p=1, **arguments)


DOCUMENT = Path(__file__).parents[2] / "docs" / "plants.md"


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", DOCUMENT.read_text(), re.DOTALL)


def test_examples_of_the_documentation_run(town, tmp_path, monkeypatch):
    written(tmp_path, CASE9.read_text(), "case9.m")
    town()
    monkeypatch.chdir(tmp_path)
    for code in blocks("python"):
        exec(compile(code, str(DOCUMENT), "exec"), {"print": lambda *_: None})
    plants = [load(written(tmp_path, text)) for text in blocks("yaml")]
    assert [plant.name for plant in plants] == ["my_grid", "my_town", "two_tanks"]
    assert plants[0].system.structure().r_observable
    for plant in plants:
        assert plant.name in describe(plant)
