# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Trajectories of a descriptor system."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from .arrays import Array, frozen, matrix
from .descriptor import DescriptorSystem
from .errors import InconsistentStateError, PlantError, ShapeError
from .stepper import LinearStepper
from .weierstrass import Weierstrass


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trajectory:
    """Samples k = 0, ..., T-1 of a trajectory.

    Attributes:
        u: inputs, shape (T, m).
        y: outputs, measurement noise included, shape (T, p).
        x: states, shape (T, n).
        inconsistency: distance of a given x(0) from the consistent x(0) used, relative; 0 if none was given.
    """

    u: Array
    y: Array
    x: Array
    inconsistency: float = 0.0


def _deviations(value: ArrayLike | None, size: int, name: str) -> Array | None:
    """Standard deviations per channel, shape (size,), from a number or a vector."""
    if value is None:
        return None
    a = np.asarray(value, dtype=np.float64)
    a = matrix(np.full(size, a) if a.ndim == 0 else a, name, (size,))
    if (a < 0).any():
        raise ShapeError(f"{name} is a standard deviation and must not be negative")
    return a


def _with_disturbance(form: Weierstrass, W: Array) -> Weierstrass:
    """``form`` with the columns of W, shape (n, w), as further inputs that the outputs do not see directly."""
    SW = form.S @ W
    return replace(
        form,
        B1=np.hstack([form.B1, SW[: form.q]]),
        B2=np.hstack([form.B2, SW[form.q :]]),
        D=np.hstack([form.D, np.zeros((len(form.D), W.shape[1]))]),
    )


def _states(form: Weierstrass, z1: Array, v: Array) -> Array:
    """x(k) = P [z1(k); -sum_i N^i B2 v(k+i)] for k = 0..T-1 (paper, (2_6)); z1 (T, q), v (T+s-1, m) -> (T, n)."""
    T = len(z1)
    z2, block = np.zeros((T, form.r)), form.B2
    for i in range(form.s):
        z2 -= v[i : i + T] @ block.T
        block = form.N @ block
    return np.hstack([z1, z2]) @ form.P.T


def _initial(system: DescriptorSystem, z10: ArrayLike | None, x0: ArrayLike | None) -> Array:
    if z10 is not None and x0 is not None:
        raise PlantError("give z1(0) or x(0), not both")
    if x0 is not None:
        return system.slow_state(matrix(x0, "x0", (system.n,)))
    q = system.weierstrass().q
    return np.zeros(q) if z10 is None else matrix(z10, "z10", (q,))


def simulate(
    system: DescriptorSystem,
    u: ArrayLike,
    z10: ArrayLike | None = None,
    *,
    x0: ArrayLike | None = None,
    tolerance: float = 1e-8,
    process_noise: ArrayLike | None = None,
    measurement_noise: ArrayLike | None = None,
    rng: np.random.Generator | None = None,
) -> Trajectory:
    """Restriction of an infinite trajectory to k = 0, ..., T-1 (paper, (2_4) and (2_6)).

    Args:
        system: the system.
        u: inputs u(0), ..., u(T+s-2), shape (T+s-1, m): y(k) uses u(k), ..., u(k+s-1).
        z10: slow state z1(0) in the coordinates of `DescriptorSystem.weierstrass`, shape (q,); default 0.
        x0: or a full state x(0), shape (n,). Its slow part is used; its fast part is fixed by the inputs.
        tolerance: largest accepted inconsistency of ``x0``, relative; inf accepts any.
        process_noise: standard deviation of a white disturbance w in E x(k+1) = A x(k) + B u(k) + w(k); a number
            or shape (n,).
        measurement_noise: standard deviation of white noise on y, number or shape (p,).
        rng: generator of the noise; required with it.

    Raises:
        ShapeError: if a shape does not fit.
        InconsistentStateError: if ``x0`` contradicts the algebraic equations and the inputs by more than ``tolerance``.
    """
    form = system.weierstrass()
    inputs = matrix(u, "u", (None, system.m))
    T = len(inputs) - form.s + 1
    if T < 1:
        raise ShapeError(f"u must have at least s = {form.s} rows for one output (T + s - 1 for T), got {len(inputs)}")
    z1_start = _initial(system, z10, x0)
    process = _deviations(process_noise, system.n, "process_noise")
    measurement = _deviations(measurement_noise, system.p, "measurement_noise")
    if rng is None and (process is not None or measurement is not None):
        raise PlantError("noise needs rng, e.g. numpy.random.Generator(numpy.random.PCG64(0))")
    if process is not None:
        form = _with_disturbance(form, np.diag(process))

    stepper = LinearStepper(form, z1_start, outputs_noise=measurement, rng=rng)
    z1, y, v = np.empty((T, form.q)), np.empty((T, system.p)), np.empty((len(inputs), form.D.shape[1]))
    for j, row in enumerate(inputs):
        v[j, : system.m] = row
        if process is not None and rng is not None:
            v[j, system.m :] = rng.standard_normal(system.n)
        k = j - form.s + 1
        if k >= 0:
            z1[k] = stepper.z1
        out = stepper.push(v[j])
        if out is not None:
            y[k] = out
    x = _states(form, z1, v)
    gap = 0.0
    if x0 is not None:
        given = np.asarray(x0, dtype=np.float64)
        size = max(float(np.linalg.norm(x[0])), float(np.linalg.norm(given)), 1e-300)
        gap = float(np.linalg.norm(x[0] - given)) / size
        if gap > tolerance:
            raise InconsistentStateError(
                f"x(0) contradicts the algebraic equations: relative distance {gap:.1e} from the "
                f"consistent state with the same slow part (accepted up to {tolerance:.0e}); "
                "give z1(0), or tolerance=inf to project"
            )
    return Trajectory(u=frozen(inputs[:T].copy()), y=frozen(y), x=frozen(x), inconsistency=gap)
