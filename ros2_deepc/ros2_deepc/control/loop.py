# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The closed loop as a plain function: what the nodes do over topics, without them."""

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from .agent import Agent, Decision

Array = NDArray[np.float64]


class Stepper(Protocol):
    """A running plant: takes u(0), u(1), ... in order."""

    def push(self, u: Array) -> Array | None:
        """Takes the next input, shape (m,); returns the newest outputs that it determines, shape (p,), or None."""


class Loop(NamedTuple):
    """A finished loop.

    Attributes:
        u: inputs, shape (K+s-1, m).
        y: outputs, shape (K, p), y[k] and u[k] of the same instant.
        decisions: one a sample, in order of k.
    """

    u: Array
    y: Array
    decisions: list[Decision]


def run_loop(agent: Agent, plant: Stepper, steps: int) -> Loop:
    """Runs plant and controller against each other until outputs ``steps`` - 1.

    Gives the same bits as the nodes do in lockstep with the same seed.
    """
    inputs = agent.start()
    outputs: list[Array] = []
    decisions: list[Decision] = []
    pushed = 0
    while len(outputs) < steps:
        y = plant.push(inputs[pushed])
        pushed += 1
        if y is None:
            continue
        decisions.append(agent.step(len(outputs), y))
        outputs.append(y)
        u = decisions[-1].u
        inputs.append(inputs[-1] if u is None else u)  # a plant holds what it has
        agent.prepare()
    return Loop(np.array(inputs[:pushed]), np.array(outputs), decisions)
