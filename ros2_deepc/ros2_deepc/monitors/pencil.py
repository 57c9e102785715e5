# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Rank of the shifted data pencil for every complex lambda, decided in noise units.

The pencil (S1 - lambda S0)[U; Y] has rank m (d-1) + rank(Y(lambda) Pi), where Pi projects on the kernel of
U(lambda): inputs of the form v lambda^k. So it is enough to follow a q x (q+m) matrix N(lambda). Its smallest singular
value over 1 + |lambda| is a lower bound of that of Y(lambda) Pi and moves by at most the norm of the noise Hankel
matrix, because both shifts of the noise are submatrices of it. lambda is homogeneous, (alpha, beta) with
alpha S1 - beta S0, so that infinity is a point like any other.
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla
from numpy.typing import NDArray

from .compress import Array, Compression

Complex = NDArray[np.complex128]

_RINGS = np.concatenate(
    [[0.0], 0.5 * np.exp(2j * np.pi * np.arange(6) / 6), np.exp(2j * np.pi * (np.arange(12) + 0.5) / 12)]
)
_STAR = np.exp(2j * np.pi * np.arange(6) / 6)
_NEWTON_STEPS = 6
_POLISH_STEPS = 6
_POLISHED = 4


@dataclass(frozen=True, slots=True)
class Minimum:
    """Where the pencil is nearest to losing rank.

    Attributes:
        kappa: smallest singular value over 1 + |lambda|, in scaled units.
        lambda_: where.
        singular_values: of N at that lambda over 1 + |lambda|, shape (q,).
    """

    kappa: float
    lambda_: complex
    singular_values: Array


@dataclass(frozen=True, slots=True)
class Pencil:
    """N(lambda) = [(J1 - lambda J0) n(lambda) C(lambda)^-1, X1 - lambda X0] of a compressed window.

    Attributes:
        M: inverse of the input factor, columns by block, shape (m d, d, m).
        J1: outputs of the later shift per unit of input, shape (q, d, m).
        J0: same of the earlier shift.
        X1: autonomous part of the later shift, shape (q, q).
        X0: same of the earlier shift.
        autonomous: singular values of the outputs without the inputs' share, over the whole window.
    """

    M: Array
    J1: Array
    J0: Array
    X1: Array
    X0: Array

    def evaluate(self, alpha: Complex, beta: Complex) -> tuple[Complex, Complex]:
        """N and its derivative at each (alpha, beta), shapes (k, q, m+q).

        The derivative is along the chart variable (beta where alpha = 1, else alpha), with the normalisation C held.
        """
        d = self.M.shape[1]
        j = np.arange(d)
        # n(lambda): block j is alpha^(d-1-j) beta^j
        v = alpha[:, None] ** (d - 1 - j) * beta[:, None] ** j
        inside = alpha == 1
        t = np.where(inside, beta, alpha)[:, None]
        power = np.where(inside[:, None], j, d - 1 - j)
        dv = power * t ** np.maximum(power - 1, 0)
        Ct = np.asarray(np.linalg.qr(np.tensordot(v, self.M, ((1,), (1,))), mode="r")).transpose(0, 2, 1)
        both = np.concatenate([v, dv])
        F1 = np.tensordot(both, self.J1, ((1,), (1,)))
        F0 = np.tensordot(both, self.J0, ((1,), (1,)))
        k = alpha.size
        a, b = alpha[:, None, None], beta[:, None, None]
        da, db = np.where(inside, 0.0, 1.0)[:, None, None], np.where(inside, 1.0, 0.0)[:, None, None]
        F = a * F1[:k] - b * F0[:k]
        dF = a * F1[k:] - b * F0[k:] + da * F1[:k] - db * F0[:k]
        both = np.linalg.solve(Ct, np.concatenate([F, dF], axis=1).transpose(0, 2, 1)).transpose(0, 2, 1)
        q = F.shape[1]
        N = np.concatenate([both[:, :q], a * self.X1 - b * self.X0], axis=2)
        dN = np.concatenate([both[:, q:], da * self.X1 - db * self.X0], axis=2)
        return N, dN

    def kappa(self, lam: Complex) -> Array:
        """Smallest singular value of N over 1 + |lambda| at each lambda (inf allowed), shape (k,)."""
        alpha, beta = chart(lam)
        N, _ = self.evaluate(alpha, beta)
        return np.asarray(np.linalg.svd(N, compute_uv=False)[:, -1] / (abs(alpha) + abs(beta)))

    def eigenvalues(self) -> Complex:
        """Modes of the slow part as the data show them, shape (q,); inf where X0 is singular."""
        w = sla.eigvals(self.X1, self.X0, homogeneous_eigvals=True)
        with np.errstate(divide="ignore", invalid="ignore"):
            lam = w[0] / w[1]
        return np.where(np.isfinite(lam), lam, np.inf + 0j)

    def refine(self, lam: Complex, steps: int = _NEWTON_STEPS) -> tuple[Complex, Array]:
        """Gauss-Newton descent of kappa from each start; returns the best lambda and kappa met from each."""
        alpha, beta = chart(lam)
        best, at = np.full(lam.shape, np.inf), lam.copy()
        for step in range(steps + 1):
            N, dN = self.evaluate(alpha, beta)
            left, sigma, _ = np.linalg.svd(N, full_matrices=False)
            kappa = sigma[:, -1] / (abs(alpha) + abs(beta))
            better = kappa < best
            best, at = np.where(better, kappa, best), np.where(better, unchart(alpha, beta), at)
            if step == steps:
                break
            a = left[:, :, -1].conj()[:, None, :]
            r, dr = (a @ N)[:, 0], (a @ dN)[:, 0]
            slope = np.einsum("ki,ki->k", dr.conj(), dr).real
            shift = -np.einsum("ki,ki->k", dr.conj(), r) / np.maximum(slope, np.finfo(float).tiny)
            inside = alpha == 1
            t = np.where(inside, beta, alpha) + shift
            alpha, beta = chart(unchart(np.where(inside, 1.0, t), np.where(inside, t, 1.0)))
        return at, best

    def minimum(self) -> Minimum:
        """Global minimum of kappa over the complex plane and infinity.

        A lambda that violates the rank condition makes X1 - lambda X0 nearly singular, so it lies in a component of the
        pseudospectrum of that square pencil, and every component holds an eigenvalue: these are complete starts.
        """
        starts = np.concatenate([self.eigenvalues(), _RINGS, [np.inf]]).astype(np.complex128)
        lam, kappa = self.refine(self.eigenvalues())
        lam, kappa = np.concatenate([lam, starts]), np.concatenate([kappa, self.kappa(starts)])
        best = np.argsort(kappa)[:_POLISHED]
        lam, kappa = lam[best], kappa[best]
        lam[:], kappa[:] = self._polish(lam, kappa)
        i = int(np.argmin(kappa))
        return self.at(complex(lam[i]))

    def _polish(self, lam: Complex, kappa: Array) -> tuple[Complex, Array]:
        """Shrinking star search around each point, in its own chart."""
        radius = np.full(lam.shape, 0.1)
        for _ in range(_POLISH_STEPS):
            alpha, beta = chart(lam)
            inside = alpha == 1
            t = np.where(inside, beta, alpha)[:, None] + radius[:, None] * _STAR
            trial = unchart(np.where(inside[:, None], 1.0, t), np.where(inside[:, None], t, 1.0))
            value = self.kappa(trial.ravel()).reshape(trial.shape)
            j = value.argmin(axis=1)
            rows = np.arange(lam.size)
            better = value[rows, j] < kappa
            lam, kappa = np.where(better, trial[rows, j], lam), np.where(better, value[rows, j], kappa)
            radius = np.where(better, radius, radius / 4)
        return lam, kappa

    def at(self, lam: complex) -> Minimum:
        """All singular values of N over 1 + |lambda| at one lambda."""
        alpha, beta = chart(np.array([lam], dtype=np.complex128))
        N, _ = self.evaluate(alpha, beta)
        sigma = np.linalg.svd(N[0], compute_uv=False) / (abs(alpha) + abs(beta))
        return Minimum(float(sigma[-1]), lam, sigma)


def chart(lam: Complex) -> tuple[Complex, Complex]:
    """Homogeneous coordinates of lambda = beta/alpha: (1, lambda) in the unit disc, (1/lambda, 1) outside."""
    inside = abs(lam) <= 1
    with np.errstate(divide="ignore", invalid="ignore"):
        mu = np.where(np.isinf(lam), 0, 1 / np.where(lam == 0, 1, lam))
    return np.where(inside, 1.0 + 0j, mu), np.where(inside, lam, 1.0 + 0j)


def unchart(alpha: Complex, beta: Complex) -> Complex:
    """The lambda = beta/alpha of homogeneous coordinates; inf where alpha = 0."""
    zero = alpha == 0
    return np.where(zero, np.inf + 0j, beta / np.where(zero, 1, alpha))


def reduce(data: Compression, R11_inverse: Array, q: int) -> Pencil:
    """Projects a compressed window on its q strongest autonomous directions.

    Both projections (of the columns on those directions, of the output rows on what these reach) can only make singular
    values smaller, so what the pencil proves holds for the data.
    """
    _, _, right = np.linalg.svd(data.R22, full_matrices=False)
    X = data.R22 @ right[:q].T
    top, bottom = slice(0, data.p * data.L), slice(data.p, data.p * (data.L + 1))
    left, _, _ = np.linalg.svd(np.hstack([X[top], X[bottom]]), full_matrices=False)
    Z = left[:, :q].T
    shape = (q, data.d, data.m)
    J1 = (Z @ data.R21[bottom] @ R11_inverse).reshape(shape)
    J0 = (Z @ data.R21[top] @ R11_inverse).reshape(shape)
    return Pencil(R11_inverse.reshape(-1, data.d, data.m), J1, J0, Z @ X[bottom], Z @ X[top])
