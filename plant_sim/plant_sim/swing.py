# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Linear swing equations with the network kept, and how to discretise them."""

import warnings
from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from .arrays import Array
from .errors import PlantError

Discretisation = Literal["euler", "implicit", "exact"]


def laplacian(n: int, edges: Sequence[tuple[int, int, float]]) -> Array:
    """Weighted graph Laplacian, shape (n, n), of edges (i, j, weight) with 0-based nodes."""
    L = np.zeros((n, n))
    for i, j, weight in edges:
        L[[i, j], [i, j]] += weight
        L[[i, j], [j, i]] -= weight
    return L


def continuous(M: Array, D: Array, L: Array, G: Array) -> tuple[Array, Array, Array]:
    """Matrices of E dx/dt = -K x + F u for x = (omega_1..g, theta_1..N), machines first (paper, section 6.1).

    No Kron reduction: every bus keeps its angle.
    dtheta_gen/dt = omega, M domega/dt = -D omega - L_gen theta + G_gen u, 0 = -L_load theta + G_load u.

    Args:
        M: inertia, shape (g,).
        D: damping, shape (g,).
        L: Laplacian of the susceptances, shape (N, N).
        G: power that each input injects at each bus, shape (N, m).

    Returns:
        E and K, shape (g + N, g + N), and F, shape (g + N, m).
    """
    g, N = len(M), len(L)
    E, K = np.zeros((g + N, g + N)), np.zeros((g + N, g + N))
    E[:g, g : 2 * g], E[g : 2 * g, :g] = np.eye(g), np.diag(M)
    K[:g, :g], K[g : 2 * g, :g], K[g:, g:] = -np.eye(g), np.diag(D), L
    return E, K, np.vstack([np.zeros((g, G.shape[1])), G])


def _reduced(E: Array, K: Array, F: Array, d: int) -> tuple[Array, Array]:
    """dx/dt = X x_d + U u of the first d unknowns, the algebraic ones eliminated."""
    gain = linalg.solve(K[d:, d:], np.hstack([K[d:, :d], F[d:]]))
    M = E[:d, :d]
    X = linalg.solve(M, K[:d, d:] @ gain[:, :d] - K[:d, :d])
    U = linalg.solve(M, F[:d] - K[:d, d:] @ gain[:, d:])
    return X, U


def largest_euler_step(rates: NDArray[np.complex128]) -> float:
    """Largest tau for which |1 + tau s| <= 1 for every continuous-time eigenvalue s (those at 0 aside)."""
    moving = rates[np.abs(rates) > 1e-9 * max(1.0, float(np.abs(rates).max(initial=0.0)))]
    return float(np.min(-2 * moving.real / np.abs(moving) ** 2, initial=np.inf))


def discretise(
    E: Array, K: Array, F: Array, dynamic: int, tau: float, method: Discretisation
) -> tuple[Array, Array, Array]:
    """Turns E dx/dt = -K x + F u, u held over a sample, into E x+ = A x + B u; the algebraic rows hold at every sample.

    Args:
        E: shape (n, n), zero outside its leading (dynamic, dynamic) block, which is regular.
        K: shape (n, n), regular in its trailing block.
        F: shape (n, m).
        dynamic: number of dynamic unknowns, which come first.
        tau: sample time, s.
        method: "euler" (forward, the paper's), "implicit" (backward Euler), or "exact" (zero-order hold).

    Raises:
        PlantError: if the method is not known or tau is not positive.

    Warns:
        UserWarning: if forward Euler is unstable at this tau although the system is not.
    """
    if not tau > 0:
        raise PlantError(f"tau must be positive, got {tau}")
    d = dynamic
    if method == "euler":
        limit = largest_euler_step(np.asarray(linalg.eigvals(_reduced(E, K, F, d)[0]), dtype=np.complex128))
        if 0 < limit < tau:
            warnings.warn(
                f"forward Euler is unstable at tau = {tau:g} s (stable up to {limit:.3g}): use discretisation='exact'",
                stacklevel=3,
            )
        return E, E - tau * K, tau * F
    if method == "implicit":
        E_new, A, B = E.copy(), E.copy(), tau * F
        E_new[:d] += tau * K[:d]
        A[d:] = -tau * K[d:]
        return E_new, A, B
    if method != "exact":
        raise PlantError(f"discretisation {method!r} is not known: choose euler, implicit or exact")
    X, U = _reduced(E, K, F, d)
    m = F.shape[1]
    step = linalg.expm(tau * np.vstack([np.hstack([X, U]), np.zeros((m, d + m))]))
    A, B = -tau * K, tau * F
    A[:d], B[:d] = 0.0, step[:d, d:]
    A[:d, :d] = step[:d, :d]
    E_new = np.zeros_like(E)
    E_new[:d, :d] = np.eye(d)
    return E_new, A, B
