# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""From samples to inputs: excite until the data describe the plant, then control it. The controller node wraps it."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .controller import DeepcController
from .reference import ReferenceSchedule
from .result import Status, StepResult
from .settings import DeepcSettings

Array = NDArray[np.float64]

_EXCITATION_STREAM = 1  # the plant's own randomness is stream 0 of the same seed


class Mode(IntEnum):
    """What the controller is doing; the numbers are those of deepc_msgs/ControllerState."""

    IDLE = 0
    COLLECTING = 1
    CONTROLLING = 2
    HOLDING = 3
    FALLBACK = 4
    SHADOW = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class Decision:
    """What was decided when outputs k arrived.

    Attributes:
        k: index of the newest outputs used.
        u: the next undecided input, u(k+s), shape (m,).
        mode: what the controller is doing.
        reason: one line on why.
        reference: reference that holds at k, shape (p,), or None.
        result: the optimisation behind u, or None while collecting.
    """

    k: int
    u: Array
    mode: Mode
    reason: str
    reference: Array | None
    result: StepResult | None


class Agent:
    """The decisions of one run (one epoch), sample by sample.

    Args:
        m: number of inputs.
        p: number of outputs.
        settings: of the controller; ``u_min`` and ``u_max`` must be finite, they bound the excitation.
        seed: of the excitation.

    Raises:
        ValueError: if the settings cannot work (the message says what would).
    """

    def __init__(self, m: int, p: int, settings: DeepcSettings, seed: int) -> None:
        self.controller = DeepcController(m, p, settings)
        self.references = ReferenceSchedule(p)
        self.settings = settings
        self.failures = 0
        self._m = m
        self._low = np.broadcast_to(np.asarray(settings.u_min, dtype=np.float64), (m,))
        self._high = np.broadcast_to(np.asarray(settings.u_max, dtype=np.float64), (m,))
        if not (np.isfinite(self._low).all() and np.isfinite(self._high).all()):
            raise ValueError("excitation needs finite input limits: give u_min and u_max")
        self._rng = np.random.Generator(np.random.PCG64([seed, _EXCITATION_STREAM]))
        self._inputs: list[Array] = []

    def start(self) -> list[Array]:
        """The inputs u(0), ..., u(s-1) that must be known before outputs 0 can exist; each (m,)."""
        return [self._next(self._excite()) for _ in range(max(self.settings.s, 1))]

    def step(self, k: int, y: ArrayLike) -> Decision:
        """Takes outputs k and decides u(k+s).

        Args:
            k: index of the outputs, one more than the last.
            y: outputs, shape (p,).
        """
        self.controller.observe(self._inputs[k], y)
        result, mode = None, Mode.COLLECTING
        target = self.references.at(k + 1)
        if not self.controller.ready:
            u, reason = self._excite(), self.controller.missing()
        elif target is None:
            u, reason = self._excite(), "the data suffice, but no reference was given"
        else:
            result, mode = self.controller.step(target), Mode.CONTROLLING
            u, reason = result.u, result.reason
            self.failures += result.status in (Status.SHIFTED_PLAN, Status.FALLBACK)
        self._next(u)
        reference = self.references.at(k)
        return Decision(k=k, u=u, mode=mode, reason=reason, reference=reference, result=result)

    def prepare(self) -> None:
        """Does the work of the next step that does not need its sample; call it once the command is out."""
        self.controller.prepare()

    def _next(self, u: Array) -> Array:
        self._inputs.append(u)
        self.controller.commit(u)
        return u

    def _excite(self) -> Array:
        return self._rng.uniform(self._low, self._high)
