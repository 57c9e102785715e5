# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ros2_deepc.behavior import excitation_order
from ros2_deepc.control import Excitation

LOW, HIGH = np.array([-1.0, 0.5, -3.0]), np.array([1.0, 0.9, 5.0])


def rng(seed=0):
    return np.random.Generator(np.random.PCG64(seed))


def play(signal, n):
    return np.array([signal.next() for _ in range(n)])


@settings(max_examples=40, deadline=None)
@given(
    kind=st.sampled_from(["uniform", "prbs", "multisine", "record"]),
    amplitude=st.floats(0.05, 1),
    rate=st.one_of(st.none(), st.floats(0.01, 3)),
    hold=st.integers(1, 5),
    seed=st.integers(0, 99),
)
def test_stays_inside_the_limits(kind, amplitude, rate, hold, seed):
    source = rng(seed).normal(0, 5, (30, 3)) if kind == "record" else kind
    u = play(Excitation(source, LOW, HIGH, rng(seed), du_max=rate, amplitude=amplitude, hold=hold, period=40), 120)
    assert (u >= LOW).all()
    assert (u <= HIGH).all()
    if rate is not None:
        assert np.abs(np.diff(u, axis=0)).max() <= rate + 1e-12
    elif kind != "record":
        assert (np.ptp(u, axis=0) <= amplitude * (HIGH - LOW) + 1e-12).all()


def test_white_input_draws_as_numpy_does():
    same = rng(4)
    expected = np.array([same.uniform(LOW, HIGH) for _ in range(20)])
    assert np.array_equal(play(Excitation("uniform", LOW, HIGH, rng(4)), 20), expected)


def test_orders():
    white = play(Excitation("uniform", LOW, HIGH, rng(1)), 104)
    assert excitation_order(white) == 26
    slow = play(Excitation("uniform", LOW, HIGH, rng(1), du_max=0.1), 104)
    assert excitation_order(slow) == 26
    binary = play(Excitation("prbs", LOW, HIGH, rng(1)), 160)
    assert set(np.unique(binary[:, 0])) == {-1.0, 1.0}
    assert excitation_order(binary) >= 26
    # 63 tones on three channels: 21 each, hence order 42 (one more for the mean, as far as T allows)
    sines = play(Excitation("multisine", LOW, HIGH, rng(1), period=128), 400)
    assert excitation_order(sines - sines[:128].mean(axis=0)) == 42
    assert np.abs(np.corrcoef(sines[:128].T) - np.eye(3)).max() < 1e-12


def test_a_record_is_repeated():
    record = np.array([[0.0, 0.6, 1.0], [0.5, 0.7, -1.0]])
    assert np.array_equal(play(Excitation(record, LOW, HIGH, rng()), 5), record[[0, 1, 0, 1, 0]])


def test_starts_from_what_was_applied():
    signal = Excitation("uniform", LOW, HIGH, rng(), du_max=0.05)
    signal.next()
    last = np.array([0.9, 0.5, 4.0])
    assert np.abs(signal.next(last) - last).max() <= 0.05 + 1e-12


@pytest.mark.parametrize(
    ("how", "text"),
    [
        ({"kind": "noise"}, "must be one of uniform, prbs, multisine"),
        ({"u_max": np.inf}, "finite input limits"),
        ({"u_min": 6.0}, "u_min <= u_max"),
        ({"amplitude": 0.0}, "amplitude = 0"),
        ({"du_max": 0.0}, "rate limit must be positive"),
        ({"kind": "multisine", "period": 6}, "needs 7"),
        ({"kind": np.zeros((4, 2))}, r"needs \(T, 3\)"),
        ({"kind": [[np.nan, 0, 0]]}, "nan"),
    ],
)
def test_says_what_is_wrong(how, text):
    how = {"kind": "uniform", "u_min": LOW, "u_max": HIGH, **how}
    how = {k: np.broadcast_to(v, 3) if k in ("u_min", "u_max") else v for k, v in how.items()}
    with pytest.raises(ValueError, match=text):
        Excitation(rng=rng(), **how)
