# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Which modes of a pair (A, B) the inputs reach, and by what margin; observability asks the same of (A', C')."""

from dataclasses import dataclass

import numpy as np
from scipy import linalg
from scipy.linalg import lapack

from .arrays import Array, frozen

EPS = float(np.finfo(np.float64).eps)
Point = tuple[float, complex, Array]  # a singular value, where, and its left vector


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reach:
    """How far the inputs of (A, B) reach.

    Attributes:
        rank: dimension of the reachable subspace.
        required: number of states.
        margin: min over lambda of the smallest singular value of [A - lambda I, B / norm(B)]: how far the next pair
            with an unreachable mode is.
        floor: rounding level of the margin; at or below it a mode counts as unreachable.
        weakest_mode: the lambda of the margin.
        modes: eigenvalues of the unreachable part, conjugates included.
        reachable: orthonormal basis of the reachable subspace, shape (states, rank).
        lost: orthonormal basis of its complement, shape (states, required - rank); left-invariant under A.
        residual: norm of lost' [B / norm(B), A reachable], which would be zero in exact arithmetic.
        kept: the margin of what is left once the lost part is split off; inf if nothing is left.
    """

    rank: int
    required: int
    margin: float
    floor: float
    weakest_mode: complex
    modes: tuple[complex, ...]
    reachable: Array
    lost: Array
    residual: float
    kept: float

    @property
    def full(self) -> bool:
        """Whether every mode is reached."""
        return self.rank == self.required

    @property
    def clear(self) -> bool:
        """Whether rounding is small, what is lost lost to rounding, and what is kept kept by a hundred times that."""
        return self.floor < 1e-7 and self.residual <= 10 * self.floor and self.kept > 100 * self.floor


def _weakest_at(A: Array, B: Array, z: complex) -> tuple[float, Array]:
    """Smallest singular value of [A - zI, B] and its left vector, by inverse iteration on a QR factor."""
    q = len(A)
    point = z.real if z.imag == 0 else z
    M = np.hstack([A - point * np.eye(q), B])
    R = np.asarray(np.linalg.qr(M.conj().T, mode="r"))
    diagonal = np.abs(R.diagonal())
    tiny = EPS * max(float(diagonal.max()), EPS)
    weak = diagonal < tiny
    R[weak, weak] = tiny  # an exact zero would stop the iteration; this moves the singular value by eps
    solve = lapack.dtrtrs if R.dtype == np.float64 else lapack.ztrtrs
    w = np.random.Generator(np.random.PCG64(1)).standard_normal(q)
    for _ in range(4):
        w = solve(R, solve(R, w, trans=2)[0])[0]
        w = w / np.linalg.norm(w)
    return float(np.linalg.norm(M.conj().T @ w)), w


def _slide(A: Array, B: Array, point: Point) -> Point:
    """Alternates between the left vector w at z and the best z for w, its Rayleigh quotient w' A w: never goes up."""
    sigma, z, w = point
    for _ in range(20):
        new_z = complex(w.conj() @ A @ w)
        if z.imag == 0 or abs(new_z.imag) < 1e-7 * abs(new_z):
            new_z = complex(new_z.real)
        new_sigma, new_w = _weakest_at(A, B, new_z)
        if not new_sigma < 0.97 * sigma:
            break
        sigma, z, w = new_sigma, new_z, new_w
    return sigma, z, w


def _probe(A: Array, B: Array, point: Point) -> Point:
    """Compass search around a point, with steps from four times the singular value found down to a twentieth of it."""
    sigma, z, w = point
    step = 4 * sigma
    for _ in range(25):
        if not step > 0.05 * sigma > 1e-7:  # smaller minima are narrow, and the alternation has found them
            break
        for direction in (1, -1, 1j, -1j):
            new_sigma, new_w = _weakest_at(A, B, z + step * direction)
            if new_sigma < sigma:
                sigma, z, w = new_sigma, z + step * direction, new_w
                break
        else:
            step /= 2
    return sigma, z, w


def weakest_mode(A: Array, B: Array, *, starts: int = 6) -> Point:
    """The smallest singular value of [A - zI, B] over z, by local searches from the most promising eigenvalues.

    Any z below the value at hand lies in a part of the pseudospectrum of A that holds an eigenvalue, hence the starts.
    A value near zero is found to rounding; a large one is an upper bound, as a rule within tens of percent.

    Returns:
        The singular value, z, and the left vector, shape (q,).
    """
    eigenvalues = [complex(z) for z in linalg.eigvals(A) if z.imag >= 0]
    first = [(sigma, z, w) for z in eigenvalues for sigma, w in [_weakest_at(A, B, z)]]
    slid = sorted((_slide(A, B, point) for point in sorted(first, key=_height)[:starts]), key=_height)
    return min((_probe(A, B, point) for point in slid[:2]), key=_height)


def _height(point: Point) -> float:
    return point[0]


def _invariant(w: Array, z: complex) -> Array:
    """Orthonormal real basis of span(w, conj(w)), shape (q, 1) for a real mode, else (q, 2)."""
    if z.imag == 0:
        real = np.asarray(np.real(w), dtype=np.float64)
        return (real / np.linalg.norm(real))[:, None]
    return np.asarray(linalg.qr(np.column_stack([w.real, w.imag]), mode="economic")[0])


def reach(A: Array, B: Array, noise_A: float, noise_B: float) -> Reach:
    """Decides which modes of (A, B) are reachable, one unreachable mode after the other being split off.

    Args:
        A: shape (q, q).
        B: shape (q, m); its overall size does not matter.
        noise_A: rounding level of the entries of A.
        noise_B: rounding level of the entries of B; a B of this size is taken as zero.
    """
    q = len(A)
    size = float(linalg.norm(B, 2)) if B.size else 0.0
    nothing = size <= 100 * noise_B
    B = np.zeros_like(B) if nothing else B / size
    scale = max(1.0, float(linalg.norm(A, 2)) if q else 0.0)
    floor = max(noise_A, 0.0 if nothing else noise_B / size, 30 * q * EPS * scale)
    reachable, lost = np.eye(q), np.empty((q, 0))
    modes: list[complex] = []
    sigmas: list[float] = []
    at = complex(np.nan)
    a, b = A, B
    while len(a):
        sigma, z, w = weakest_mode(a, b)
        at = at if modes else z
        sigmas.append(sigma)
        if sigma > floor:
            break
        if 0 < z.imag < 1e-6:  # a multiple real eigenvalue may have come out as a pair
            real_sigma, real_w = _weakest_at(a, b, complex(z.real))
            if real_sigma <= floor:
                z, w = complex(z.real), real_w
        modes += [z] if z.imag == 0 else [z, z.conjugate()]
        W = _invariant(w, z)
        V = linalg.qr(W)[0][:, W.shape[1] :]
        lost, reachable = np.hstack([lost, reachable @ W]), reachable @ V
        a, b = V.T @ a @ V, V.T @ b
    return Reach(
        rank=q - lost.shape[1], required=q, margin=min(sigmas[:1], default=np.inf), floor=floor, weakest_mode=at,
        modes=tuple(modes), reachable=frozen(reachable), lost=frozen(lost),
        residual=float(np.linalg.norm(lost.T @ np.hstack([B, A @ reachable]))), kept=sigmas[-1] if len(a) else np.inf,
    )  # fmt: skip
