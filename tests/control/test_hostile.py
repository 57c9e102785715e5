# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Plants and settings that nobody wishes for: a right result, or one line that says what is wrong."""

import numpy as np
import pytest

from plant_sim.stepper import LinearStepper
from ros2_deepc.control import DeepcController, DeepcSettings

SOLVERS = ["osqp", "daqp"]


class Bench:
    """A plant behind other units, offsets and further outputs; its own input is (u - offset) / u_unit."""

    def __init__(self, plant, u_unit=1.0, y_unit=1.0, further=lambda y: y, **how):
        self.form, self.u_unit, self.y_unit, self.further = plant, u_unit, y_unit, further
        self.rng = np.random.Generator(np.random.PCG64(1))
        self.stepper = LinearStepper(plant, self.rng.standard_normal(plant.q))
        base = {"N": 6, "L": 14, "q": plant.q, "Q": 5.0 / y_unit**2, "R": 1.0 / u_unit**2}
        settings = DeepcSettings(**{**base, "u_min": -u_unit, "u_max": u_unit, **how})
        self.controller = DeepcController(plant.D.shape[1], self.told(np.zeros(plant.D.shape[0])).size, settings)

    def told(self, y):
        return self.further(y * self.y_unit)

    @property
    def steady_gain(self):
        form = self.form
        return form.C1 @ np.linalg.solve(np.eye(form.q) - form.A1, form.B1) + form.markov().sum(axis=0)

    def run(self, steady_input, steps=60):
        """Inputs, last outputs and results while the outputs of a steady input, in plant units, are asked for."""
        goal, results = self.told(self.steady_gain @ steady_input), []
        u = self.rng.uniform(-1, 1, self.form.D.shape[1]) * self.u_unit
        for _ in range(1000):
            y = self.told(self.stepper.push(u / self.u_unit))
            self.controller.observe(u, y)
            if self.controller.ready:
                results.append(self.controller.step(goal))
                u = results[-1].u
                if len(results) == steps:
                    return y - goal, results
            else:
                u = self.rng.uniform(-1, 1, u.size) * self.u_unit
        raise AssertionError(self.controller.missing())


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("limits", [False, True])
@pytest.mark.parametrize("terminal", ["none", "equilibrium", "soft", "hard"])
@pytest.mark.parametrize(("u_unit", "y_unit"), [(1e6, 1.0), (1.0, 1e-6), (1e-6, 1e6)])
def test_units_change_nothing(u_unit, y_unit, terminal, limits, solver, plant_form):
    """Megawatts in watts, heads in micrometres: the same run, in other numbers."""
    runs = []
    for u, y in ((1.0, 1.0), (u_unit, y_unit)):
        how = {"du_max": 0.3 * u, "y_max": 4.0 * y} if limits else {}
        bench = Bench(plant_form(1), u, y, terminal=terminal, solver=solver, **how)
        results = bench.run(np.array([0.3, -0.2, 0.3]), 40)[1]
        assert all(result.status.solved for result in results)
        runs.append((np.array([r.u for r in results]) / u, [r.feasible for r in results], results[-1].cost))
    assert np.abs(runs[0][0] - runs[1][0]).max() < (1e-3 if solver == "osqp" else 1e-7)
    assert runs[0][1] == runs[1][1]
    assert runs[0][2] == pytest.approx(runs[1][2], rel=1e-3)


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("terminal", ["none", "equilibrium", "soft", "hard"])
@pytest.mark.parametrize(("m", "p"), [(1, 3), (4, 1), (1, 1), (5, 5)])
def test_more_inputs_or_more_outputs(m, p, terminal, solver, plant_form):
    bench = Bench(plant_form(2, m=m, p=p, q=4), terminal=terminal, solver=solver)
    off, results = bench.run(np.full(m, 0.3))
    assert all(result.status.solved for result in results)
    if terminal == "equilibrium":
        assert np.abs(off).max() < 1e-5


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize(
    ("further", "how"),
    [
        (lambda y: np.append(y, y[0]), {}),
        (lambda y: np.append(y, y[0] - 2 * y[1]), {}),
        (lambda y: np.append(y, 0.0), {}),
        (lambda y: np.append(y, 7.0), {"q": 7, "N": 7}),
        (lambda y: y + 5.0, {"q": 7, "N": 7}),
        (lambda y: y + 1e3, {"form": "incremental"}),
    ],
    ids=["twice", "dependent", "zero", "constant", "offset", "increments"],
)
def test_outputs_that_say_nothing_new(further, how, solver, plant_form):
    off, results = Bench(plant_form(1), further=further, solver=solver, **how).run(np.array([0.3, -0.2, 0.3]), 120)
    assert all(result.status.solved for result in results)
    assert np.abs(off).max() < 1e-5
    assert results[-1].feasible


@pytest.mark.parametrize("solver", SOLVERS)
def test_an_input_that_may_not_move_in_the_end(solver, plant_form):
    """Data from a wide range, then one input is tied down: the others do what they can."""
    bench = Bench(plant_form(1), solver=solver)
    bench.run(np.zeros(3), 5)
    bench.controller.tune(u_min=[-1.0, 0.2, -1.0], u_max=[1.0, 0.2, 1.0])
    off, results = bench.run(np.array([0.3, 0.2, 0.3]), 90)
    assert all(result.u[1] == 0.2 for result in results)
    assert np.abs(off).max() < 1e-5


@pytest.mark.parametrize(("L", "s"), [(1, 1), (2, 1), (2, 3)])
def test_a_horizon_shorter_than_lag_or_index(L, s, plant_form, loop, truth):
    form = plant_form(4, q=4, s=s)
    settings = DeepcSettings(N=8, L=L, q=4, s=s, u_min=-1.0, u_max=1.0, terminal="none", solver="daqp")
    run, model = loop(form, settings, 1).collect(), truth(form, L)
    for _ in range(10):
        z1, committed = run.stepper.z1, run.committed
        result = run.step([0.3, 0.1])
        exact = model.predict(z1, np.vstack([committed, result.u_plan]))
        assert np.abs(result.y_plan - exact).max() < 1e-8 * max(1.0, np.abs(exact).max())


@pytest.mark.parametrize(
    ("how", "text"),
    [
        ({"Q": np.inf}, "Q must be finite"),
        ({"R": [1.0, np.nan, 1.0]}, "R contains NaN"),
        ({"terminal_weight": np.inf}, "terminal_weight = inf"),
        ({"slack_weight": np.nan}, "slack_weight = nan"),
        ({"u_min": np.nan}, "u_min contains NaN"),
        ({"u_min": -np.inf, "u_max": -np.inf}, "allows infinity only"),
        ({"y_min": np.inf}, "allows infinity only"),
        ({"du_max": 0.0}, "du_max = 0"),
        ({"L": 6}, "needs L >= 7"),
    ],
)
def test_settings_without_sense_are_refused(how, text):
    with pytest.raises(ValueError, match=text):
        DeepcController(3, 2, DeepcSettings(**{"N": 6, "L": 14, **how}))
