# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The watch over a loop: bounds, useless predictions, and what the agent does then."""

import numpy as np
import pytest

from ros2_deepc.control import DeepcSettings
from ros2_deepc.control.agent import Agent
from ros2_deepc.control.modes import Mode, Safety
from ros2_deepc.control.watch import Bounds, Watch


def taught(**bounds):
    """A watch that has seen changes of size 1 in output 0 and none in output 1."""
    watch = Watch(2, Bounds(**bounds))
    for k in range(20):
        watch.learn([k % 2, 5.0])
    return watch


def test_outputs_beyond_their_bounds_are_named():
    watch = taught(trip_min=-1.0, trip_max=(2.0, 6.0))
    assert watch.look([2.0, 6.0], None) == ""
    assert watch.look([2.1, 6.0], None).startswith("output 0 is 2.1")
    assert watch.look([0.0, -1.5], None).startswith("output 1 is -1.5")
    assert watch.look([np.nan, 0.0], None).startswith("output 0 is nan")


def test_only_a_window_full_of_errors_counts_and_output_that_never_moved_does_not():
    watch = taught(trip_error=1.5, trip_window=4)
    assert watch.look([0.0, 99.0], [99.0, 0.0]) == ""  # a single surprise
    for _ in range(3):
        assert watch.look([0.0, 99.0], [1.0, 0.0]) == ""
    for _ in range(2):
        assert watch.look([0.0, 99.0], [2.0, 0.0]) == ""
    assert "off by 2 times" in watch.look([0.0, 99.0], [2.0, 0.0])
    watch.clear()
    assert watch.look([0.0, 99.0], [2.0, 0.0]) == ""


def test_no_prediction_is_no_error():
    watch = taught(trip_error=0.1, trip_window=1)
    assert watch.look([0.0, 5.0], None) == ""
    assert watch.look([0.0, 5.0], [np.nan, np.nan]) == ""
    assert Watch(2, Bounds(trip_error=0.1, trip_window=1)).look([0.0, 5.0], [9.0, 9.0]) == ""


@pytest.mark.parametrize(
    ("bounds", "message"),
    [
        ({"trip_min": 1.0, "trip_max": 1.0}, "must lie below"),
        ({"trip_error": 0.0}, "must be positive"),
        ({"trip_error": np.nan}, "must be positive"),
        ({"trip_window": 0}, "at least 1"),
    ],
)
def test_bounds_that_cannot_work(bounds, message):
    with pytest.raises(ValueError, match=message):
        Bounds(**bounds)
    with pytest.raises(ValueError, match="one number or 2"):
        Watch(2, Bounds(trip_max=(1.0, 2.0, 3.0)))


def loop(agent, steps, gain=lambda k: 0.3):
    """y(k+1) = .9 y(k) + gain(k) u(k), driven by the agent; returns its decisions."""
    y, u, decisions = 0.0, agent.start()[0], []
    for k in range(steps):
        decisions.append(agent.step(k, [y]))
        y, u = 0.9 * y + gain(k) * u[0], decisions[-1].u
    return decisions


def agent_with(**kwargs):
    settings = DeepcSettings(N=2, L=6, T=40, q=1, u_min=-1.0, u_max=1.0, R=0.1, terminal="none")
    agent = Agent(1, 1, settings, 0, **kwargs)
    agent.references.set(0, [0.5])
    return agent


def test_a_loop_whose_plant_has_turned_around_ends_in_the_fallback():
    def turned(k):
        return 0.3 if k < 60 else -0.3

    blind = loop(agent_with(), 120, turned)
    assert {d.mode for d in blind[41:]} == {Mode.CONTROLLING}
    safety = Safety(fallback="ramp", ramp=5)
    watched = loop(agent_with(safety=safety, bounds=Bounds(trip_error=1.0, trip_window=5)), 120, turned)
    first = next(d.k for d in watched if d.mode is Mode.FALLBACK)
    assert 60 < first < 75
    assert "predictions were off" in watched[first].reason
    assert watched[-1].mode is Mode.FALLBACK
    assert watched[-1].u[0] == 0.0


def test_a_bound_ends_in_the_fallback_only_under_control():
    agent = agent_with(bounds=Bounds(trip_max=0.4))
    decisions = loop(agent, 60)
    first = next(d.k for d in decisions if d.mode is Mode.FALLBACK)
    assert first >= 40
    assert "beyond its bounds" in decisions[first].reason
    assert agent.request(Mode.COLLECTING) == ""
    assert agent.mode is Mode.COLLECTING


def test_amplitude_is_a_share_of_the_range():
    inputs = np.array([d.u for d in loop(agent_with(amplitude=0.1), 30)])
    assert np.abs(inputs).max() <= 0.1
    assert np.abs(inputs).max() > 0.08
    switching = np.array([d.u for d in loop(agent_with(excitation="prbs", amplitude=0.5), 30)])
    assert set(switching.ravel()) == {-0.5, 0.5}


def test_the_safe_input_of_the_ramp_lies_within_the_limits():
    settings = DeepcSettings(N=2, L=6, T=40, q=1, u_min=0.4, u_max=0.8, terminal="none")
    agent = Agent(1, 1, settings, 0, Safety(fallback="ramp", ramp=2))
    loop(agent, 3)
    agent.request(Mode.FALLBACK)
    assert agent.step(3, [0.0]).u[0] >= 0.4
    assert agent.step(4, [0.0]).u[0] == 0.4
