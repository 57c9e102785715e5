# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""A nonlinear grid that runs: inputs held over each sample, events at sampling instants, noisy measurements."""

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from .arrays import Array, matrix
from .grid_events import GridEvent, Switched, apply, rehearse
from .swing_dae import SwingGrid, operating_point, rates
from .swing_radau import SwingIntegrator, SwingState

REACH = 0.34  # step times fastest rate: keeps the error of ten seconds after a disturbance near 1e-5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SwingRun:
    """What a run of a grid needs besides the grid.

    Attributes:
        G: mechanical power asked of each machine per input, shape (g, m).
        C: outputs from (omega, theta), shape (p, g + N).
        tau: sample time, s.
        substeps: steps of the integrator per sample; 0 chooses them from the fastest mode.
        lag: time constant of the turbines, s; 0 = none.
        noise: standard deviation of the measurement noise, shape (p,).
        events: in order of k.
    """

    G: Array
    C: Array
    tau: float
    substeps: int
    lag: float
    noise: Array
    events: tuple[GridEvent, ...]


class SwingStepper:
    """A grid at its operating point, ready to take u(0), u(1), ...

    Args:
        grid: the grid at its operating point.
        run: how it is driven and measured.
        rng: for the measurement noise; None = none.

    Raises:
        PlantError: if there is no operating point, or an event is impossible.
    """

    def __init__(self, grid: SwingGrid, run: SwingRun, rng: np.random.Generator | None) -> None:
        g = grid.machines
        self._run, self._whole, self._rng = run, grid, rng
        self._now = Switched(grid, np.full(g, -np.inf), np.full(g, np.inf))
        rehearse(run.events, self._now)
        theta = operating_point(grid)
        self.state = SwingState(np.zeros(g), theta)
        self.residual = 0.0
        """Largest power mismatch at a load bus at any sampling instant so far, per unit."""
        self.log: list[tuple[int, str]] = []
        """Events so far, as (k, text)."""
        self.status = ""
        """What happened last, in one line; empty if nothing has."""
        fastest = float(np.abs(rates(grid, theta)).max())
        self.substeps = run.substeps or max(1, int(np.ceil(run.tau * fastest / REACH)))
        self._integrator = SwingIntegrator(grid, run.tau / self.substeps)
        self._power = grid.generation.copy()
        self._k = 0

    def push(self, u: ArrayLike) -> Array:
        """Takes u(k), shape (m,); returns y(k), shape (p,), which does not depend on it yet.

        Raises:
            ShapeError: if ``u`` has another shape or is not finite.
            PlantError: if the grid has lost synchronism.
        """
        run = self._run
        u = matrix(u, "u", (run.G.shape[1],))
        y: Array = run.C @ np.concatenate((self.state.omega, self.state.theta))
        if self._rng is not None:
            y = y + run.noise * self._rng.standard_normal(len(y))
        for event in run.events:
            if event.k == self._k:
                self._happen(event)
        wanted = np.clip(self._whole.generation + run.G @ u, self._now.low, self._now.high)
        self._advance(wanted)
        self._k += 1
        return y

    def _happen(self, event: GridEvent) -> None:
        before = self._now.grid
        self._now = apply(event, self._now, self._whole)
        if self._now.grid is not before:
            self._integrator = SwingIntegrator(self._now.grid, self._run.tau / self.substeps)
        self.status = event.text
        self.log.append((self._k, event.text))

    def _advance(self, wanted: Array) -> None:
        """One sample; the turbines follow ``wanted``, shape (g,)."""
        h, start = self._run.tau / self.substeps, self._power
        for i in range(self.substeps):
            self.state = self._integrator.step(self.state, partial(self._turbines, start, wanted, i * h))
        self._power = self._turbines(start, wanted, 0.0, np.array([self._run.tau]))[0]
        self.residual = max(self.residual, self._integrator.residual(self.state))

    def _turbines(self, start: Array, wanted: Array, past: float, t: Array) -> Array:
        """Mechanical power at times past + t (times,), shape (times, g): the first-order lag has a closed form."""
        if self._run.lag == 0:
            return np.tile(wanted, (len(t), 1))
        return np.asarray(wanted + (start - wanted) * np.exp(-(past + t) / self._run.lag)[:, None])
