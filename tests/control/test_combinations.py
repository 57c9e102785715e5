# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Any settings on any plant: predictions are the plant's own, inputs keep their limits, nothing fails."""

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from plant_sim.stepper import LinearStepper
from ros2_deepc.control import DeepcController, DeepcSettings

choices = {
    "s": st.integers(1, 3),
    "form": st.sampled_from(["absolute", "incremental"]),
    "data_policy": st.sampled_from(["fixed", "sliding", "guarded"]),
    "predictor": st.sampled_from(["joint", "causal"]),
    "terminal": st.sampled_from(["none", "equilibrium", "hard", "soft"]),
    "disturbances": st.integers(0, 1),
    "solver": st.sampled_from(["osqp", "daqp"]),
    "du_max": st.sampled_from([np.inf, 0.5]),
    "y_max": st.sampled_from([np.inf, 2.0]),
    "noise_block": st.sampled_from(["off", "ridge"]),
}


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    how=st.fixed_dictionaries(choices),
    q=st.integers(1, 4),
    known=st.booleans(),
    gap=st.booleans(),
    seed=st.integers(0, 20),
)
def test_predictions_are_the_plants(how, q, known, gap, seed, plant_form):
    m, nd, s = 2, how["disturbances"], how["s"]
    form = plant_form(200 + seed, m=m + nd, p=2, q=q, s=s, radius=(0.4, 0.9))
    N = q + s  # one more than the paper asks
    T = 0 if known or nd else 4 * (N + N + 4 + q + s)  # room for a causal predictor and for what a gap costs
    base = {"N": N, "L": N + 4, "q": q if known else 0, "T": T + 120 if T or gap or nd else 0}
    how = {**base, **how, "u_min": -1.0, "u_max": 1.0, "dither": 0.2}
    controller = DeepcController(m, 2, DeepcSettings(**how))
    rng = np.random.Generator(np.random.PCG64([seed, 3]))
    stepper = LinearStepper(form, rng.standard_normal(q))
    d = rng.uniform(-1, 1, (2000, nd))
    u = [rng.uniform(-0.25, 0.25, m) for _ in range(s)]  # within the rate limit from one to the next
    for i in range(s - 1):
        stepper.push(np.append(u[i], d[i]))
        controller.commit(u[i])
    controller.commit(u[s - 1])
    solved = 0
    for k in range(600):
        y = stepper.push(np.append(u[k + s - 1], d[k + s - 1]))
        if gap and k == 40:  # this sample is lost
            controller.cut()
            for v in u[k + 1 : k + s]:
                controller.commit(v)
        else:
            controller.observe(u[k], y, d[k] if nd else None)
        if not controller.ready:
            u.append(rng.uniform(-0.25, 0.25, m))
            controller.commit(u[-1])
            continue
        forecast = d[k + 1 : k + s + how["L"]] if nd else None
        result = controller.step([0.3, -0.2], forecast)
        solved += 1
        assert result.status.solved, result.reason
        assert (np.abs(result.u) <= 1).all()
        assert (np.abs(result.u - u[-1]) <= how["du_max"] + 1e-12).all()
        copy = LinearStepper(form, stepper.z1)
        ahead = [*u[k + 1 : k + s], *result.u_plan]
        told = [copy.push(np.append(v, d[k + 1 + i])) for i, v in enumerate(ahead)]
        exact = np.array([out for out in told if out is not None])
        assert np.abs(result.y_plan - exact).max() < 1e-6 * max(1.0, np.abs(exact).max())
        u.append(result.u)
        if solved == 25:
            return
    raise AssertionError(controller.missing())
