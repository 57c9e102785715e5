# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ros2_deepc.control import DeepcController, DeepcSettings

GOOD = {"N": 6, "L": 14, "q": 6, "u_min": -1.0, "u_max": 1.0}


@pytest.mark.parametrize(
    ("how", "text"),
    [
        ({"N": 0}, "N = 0: must be a whole number >= 1"),
        ({"L": 2.5}, "L = 2.5: must be a whole number"),
        ({"T": True}, "T = True"),
        ({"T": 84}, r"T = 84 can never reach the rank m\(N\+L\+s-1\)\+q = 66: needs T >= 85"),
        ({"T": 100, "q": 0}, r"T = 100 cannot excite of order N\+L\+q\+s-1 = 26 .* needs T >= 103, or give q"),
        ({"T": 85, "form": "incremental"}, "needs T >= 86"),
        ({"T": 103, "predictor": "causal"}, "needs T >= 119"),
        ({"N": 1, "s": 2, "q": 0, "terminal": "none"}, "needs N >= 2"),
        ({"L": 6}, 'terminal = "equilibrium" holds for the last 6 samples: needs L >= 7'),
        ({"Q": [[1.0, 2.0], [2.0, 1.0]]}, "Q is not positive semidefinite: its least eigenvalue is -1"),
        ({"Q": [[1.0, 2.0], [0.0, 1.0]]}, "Q is not symmetric"),
        ({"Q": [1.0, 2.0, 3.0]}, "Q has 3 entries: give one number or 2"),
        ({"R": np.nan}, "R contains NaN"),
        ({"R": np.inf}, "R must be finite"),
        ({"u_min": 2.0}, r"no u\[0\] is allowed: u_min = 2 exceeds u_max = 1"),
        ({"y_min": [0.0, 5.0], "y_max": [1.0, 4.0]}, r"no y\[1\] is allowed"),
        ({"u_min": [0.0, 0.0]}, "u_min has 2 entries: give one number or 3"),
        ({"du_max": 0.0}, "du_max = 0: a rate limit must be positive"),
        ({"mask": [1.0, 1.5]}, "must lie in"),
        ({"noise": -1.0}, "noise"),
        ({"dither": np.inf}, "dither"),
        ({"terminal": "free"}, "terminal = 'free': must be one of none, equilibrium, hard, soft"),
        ({"solver": "cvxpy"}, "must be one of osqp, daqp"),
        ({"data_policy": "rolling"}, "must be one of fixed, sliding, guarded"),
        ({"terminal_weight": -1.0}, "terminal_weight = -1"),
        ({"guard": 0.0}, "guard = 0"),
    ],
)
def test_says_what_is_wrong_in_one_line(how, text):
    with pytest.raises(ValueError, match=text) as caught:
        DeepcController(3, 2, DeepcSettings(**{**GOOD, **how}))
    assert "\n" not in str(caught.value)


def test_settings_are_immutable_comparable_and_hashable():
    a = DeepcSettings(**GOOD, Q=np.diag([5.0, 5.0]), mask=[1.0, 0.0])
    b = DeepcSettings(**GOOD, Q=[[5, 0], [0, 5]], mask=np.array([1.0, 0.0]))
    assert a == b
    assert hash(a) == hash(b)
    with pytest.raises(dataclasses.FrozenInstanceError):
        a.N = 3
    assert eval(repr(a), {"DeepcSettings": DeepcSettings, "inf": np.inf}) == a


@settings(max_examples=60, deadline=None)
@given(
    m=st.integers(1, 3),
    N=st.integers(2, 5),
    L=st.integers(1, 5),
    s=st.integers(1, 3),
    q=st.integers(0, 4),
    form=st.sampled_from(["absolute", "incremental"]),
    seed=st.integers(0, 1000),
)
def test_the_number_in_the_message_works(m, N, L, s, q, form, seed):
    """White inputs on a plant without memory: the named T is enough, the one below is refused."""
    base = {"N": N, "L": L, "s": s, "q": q, "form": form, "terminal": "none", "u_min": -1.0, "u_max": 1.0}
    try:
        DeepcController(m, 1, DeepcSettings(**base, T=1))
        pytest.fail("T = 1 cannot be enough")
    except ValueError as error:
        if "leaves no room" in str(error):
            return
        T = int(str(error).split("needs T >= ")[1].split(" ")[0].strip(",:"))
    with pytest.raises(ValueError, match=f"needs T >= {T}"):
        DeepcController(m, 1, DeepcSettings(**base, T=T - 1))
    controller = DeepcController(m, 1, DeepcSettings(**base, T=T))
    rng = np.random.Generator(np.random.PCG64(seed))
    A, B, C = np.diag(rng.uniform(0.5, 0.9, q)), rng.normal(size=(q, m)), rng.normal(size=(1, q))
    u, x = rng.uniform(-1, 1, (T + s, m)), rng.normal(size=q)
    for i in range(s - 1):
        controller.commit(u[i])
    for k in range(T - s + 1):
        assert not controller.ready
        controller.commit(u[k + s - 1])
        controller.observe(u[k], C @ x + u[k, :1])
        x = A @ x + B @ u[k]
    for i in range(len(controller._ahead), s - 1):
        controller.commit(u[T - s + 1 + i])
    assert controller.window_length == T
    if not q:  # then T is what Corollary 1 asks, and white inputs give it
        assert controller.ready, controller.missing()
