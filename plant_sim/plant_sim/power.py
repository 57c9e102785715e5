# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Electric grids: swing dynamics at the machines, power balance at every other bus."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from .arrays import Array, matrix
from .descriptor import DescriptorSystem
from .errors import PlantError
from .plant import Plant, linear_start, system_prior


def laplacian(n: int, edges: Sequence[tuple[int, int, float]]) -> Array:
    """Weighted graph Laplacian, shape (n, n), of edges (i, j, weight) with 0-based nodes."""
    L = np.zeros((n, n))
    for i, j, weight in edges:
        L[[i, j], [i, j]] += weight
        L[[i, j], [j, i]] -= weight
    return L


def swing_matrices(
    inertia: ArrayLike, damping: ArrayLike, L: Array, G: ArrayLike, tau: float
) -> tuple[Array, Array, Array]:
    """Euler-discretised linear swing equations with the network kept (paper, section 6.1; no Kron reduction).

    State (omega_1..g, theta_1..g, theta_g+1..N): theta+ = theta + tau omega,
    M omega+ = M omega - tau (D omega + L_gen theta - G u), 0 = L_load theta.

    Args:
        inertia: M, shape (g,).
        damping: D, shape (g,).
        L: Laplacian of the susceptances, machines first, shape (N, N).
        G: power injected at the machines by each input, shape (g, m).
        tau: sample time, s.

    Returns:
        E, A, both shape (g + N, g + N), and B, shape (g + N, m).
    """
    M, D = matrix(inertia, "inertia", (None,)), matrix(damping, "damping", (None,))
    g, N = len(M), len(L)
    G = matrix(G, "G", (g, None))
    E = np.zeros((g + N, g + N))
    E[:g, g : 2 * g], E[g : 2 * g, :g] = np.eye(g), np.diag(M)
    K = np.zeros_like(E)
    K[:g, :g], K[g : 2 * g, :g], K[g:, g:] = -np.eye(g), np.diag(D), L
    B = np.vstack([np.zeros((g, G.shape[1])), tau * G, np.zeros((N - g, G.shape[1]))])
    return E, E - tau * K, B


WSCC9_INERTIA = (0.125, 0.034, 0.016)
WSCC9_DAMPING = (0.125, 0.068, 0.048)
# The published weights. They are the reactances of the lines, used as if they were susceptances.
WSCC9_EDGES = (
    (0, 3, 0.058), (1, 4, 0.063), (2, 5, 0.059), (3, 6, 0.085), (3, 7, 0.092),
    (4, 6, 0.161), (4, 8, 0.072), (5, 7, 0.170), (5, 8, 0.101),
)  # fmt: skip
TRANSFERS = ((1, 1, 0), (-1, 0, 1), (0, -1, -1))
_WSCC9 = {
    "full": (np.eye(3), ("P1", "P2", "P3"), "x7", (5.0, 5.0), "one power injection at each machine"),
    "transfers": (TRANSFERS, ("P12", "P13", "P23"), "c0", (5.0, 5.0), "power transfers between machine pairs"),
    "text": (TRANSFERS, ("P12", "P13", "P23"), "x7", (5.0, 0.0), "power transfers between machine pairs"),
}  # fmt: skip


def wscc9(variant: str = "transfers") -> Plant:
    """The paper's first case: the WSCC 9-bus grid with 3 machines, 0.1 s, published weights.

    x = (omega_1..3, theta_1..9). Output x1 is the speed of machine 1;
    c0 = (sum M_i omega_i + sum D_i theta_i) / sum D_i is conserved by every transfer; x7 is the angle at bus 4.

    Args:
        variant: "transfers" (inputs move power between machine pairs, outputs x1 and c0), "text" (the same inputs, the
            paper's outputs x1 and x7), or "full" (an input at each machine, outputs x1 and x7).

    Raises:
        PlantError: if the variant is not known.
    """
    if variant not in _WSCC9:
        raise PlantError(f"wscc9 has no variant {variant!r}: choose {', '.join(_WSCC9)}")
    G, inputs, second, Q, story = _WSCC9[variant]
    M, D = np.array(WSCC9_INERTIA), np.array(WSCC9_DAMPING)
    E, A, B = swing_matrices(M, D, laplacian(9, WSCC9_EDGES), np.array(G), 0.1)
    C = np.zeros((2, 12))
    C[0, 0] = 1.0
    if second == "x7":
        C[1, 6] = 1.0
    else:
        C[1, :3], C[1, 3:6] = M / D.sum(), D / D.sum()
    system = DescriptorSystem(E, A, B, C)
    return Plant(
        name="wscc9",
        variant=variant,
        description=f"WSCC 9-bus grid, 3 machines and 6 load buses, with {story}.",
        sample_time=0.1,
        system=system,
        input_names=inputs,
        input_units=("pu",) * 3,
        output_names=("x1", second),
        output_units=("rad/s", "rad"),
        input_min=np.full(3, -1.0),
        input_max=np.full(3, 1.0),
        prior=system_prior(system),
        D=system.D,
        references=((0, np.array([3.0, 3.0])), (151, np.array([1.0, 5.0]))),
        settings={"N": 6, "L": 14, "T": 104, "Q": list(Q), "R": [1.0, 1.0, 1.0], "terminal": "none"},
        steps=200,
        begin=linear_start(system, lambda rng: np.concatenate([5.0 * rng.random(6), np.zeros(6)])),
    )
