# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Plain singular-value test of the data pencil under noise: what `ros2_deepc.monitors` is measured against.

Theorem 1* with Weyl's inequality and nothing else: one window without instruments, kappa over 1 + |lambda|, the norm of
the noise from simulation, lambda by search alone (eigenvalues, Gauss-Newton, pattern search), no cover. Written apart
from the package on purpose: it shares no line with what it is compared to.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
import scipy.linalg as sla

SIMULATED = 2000
"""Noise matrices behind each bound: its 99.9 % quantile rests on the two largest."""

STARTS, POLISHED = 6, 4
EPS = np.finfo(float).eps


class Window(NamedTuple):
    """[H_{L+sb}(u); H_{L+1}(y)] projected on its q strongest autonomous directions, scaled channels."""

    R11: np.ndarray
    Y1: np.ndarray
    Y0: np.ndarray
    X1: np.ndarray
    X0: np.ndarray
    m: int


def blocks(w: np.ndarray, rows: int, columns: int) -> np.ndarray:
    return np.vstack([w[i : i + columns].T for i in range(rows)])


@cache
def noise_norm(p: int, L: int, columns: int) -> float:
    """99.9 % quantile of the norm of H_{L+1} of unit white Gaussian noise."""
    rng = np.random.Generator(np.random.PCG64([p, L, columns]))
    norms = []
    for _ in range(SIMULATED):
        H = blocks(rng.standard_normal((columns + L, p)), L + 1, columns)
        norms.append(np.sqrt(np.linalg.eigvalsh(H @ H.T)[-1]))
    return float(np.quantile(norms, 0.999))


def reduce(u: np.ndarray, y: np.ndarray, L: int, sb: int, q: int, std: float) -> tuple[Window | None, float]:
    """The window and the bound of noise and rounding in it; no window where the test cannot be asked."""
    m, p, c = u.shape[1], y.shape[1], len(y) - L
    a = m * (L + sb)
    if c < a + q or p * L < q:
        return None, np.inf
    W = np.vstack([blocks(u, L + sb, c), blocks(y, L + 1, c)])
    R = np.linalg.qr(W.T, mode="r").T
    bound = std * noise_norm(p, L, c) + 10 * EPS * np.sqrt(len(W)) * np.linalg.norm(R)
    R11, R21 = R[:a, :a], R[a:, :a]
    size = np.linalg.svd(R11, compute_uv=False)
    left, sigma, _ = np.linalg.svd(R[a:, a:])
    if size[-1] <= 100 * EPS * size[0] or sigma.size < q or np.any(sigma[q:] > bound):
        return None, bound
    X = left[:, :q] * sigma[:q]
    top, bottom = slice(0, p * L), slice(p, p * (L + 1))
    Z = np.linalg.svd(np.hstack([X[top], X[bottom]]))[0][:, :q].T
    return Window(R11, Z @ R21[bottom], Z @ R21[top], Z @ X[bottom], Z @ X[top], m), bound


def pencils(w: Window, lam: np.ndarray) -> np.ndarray:
    """[(Y1 - l Y0) Q(l), X1 - l X0] over 1 + |l|, Q an orthonormal basis of the data directions with U(l) = 0."""
    t, far = np.where(abs(lam) > 1, 1 / np.where(lam == 0, 1, lam), lam), abs(lam) > 1
    d = len(w.R11) // w.m
    powers = t[:, None] ** np.where(far[:, None], np.arange(d)[::-1], np.arange(d))
    n = np.einsum("kj,ab->kjab", powers, np.eye(w.m)).reshape(len(lam), -1, w.m)
    Q = np.linalg.qr(np.linalg.solve(w.R11, n))[0]
    one, other = (np.where(side, t, 1)[:, None, None] for side in (far, ~far))
    N = np.concatenate([(one * w.Y1 - other * w.Y0) @ Q, one * w.X1 - other * w.X0 + 0j], axis=2)
    return np.asarray(N / (1 + abs(t))[:, None, None])


def kappa(w: Window, lam: np.ndarray) -> np.ndarray:
    """Smallest singular value at each lambda; infinity is a large number."""
    return np.asarray(np.linalg.svd(pencils(w, lam), compute_uv=False)[:, -1])


def newton(w: Window, lam: np.ndarray) -> np.ndarray:
    """Six Gauss-Newton steps on the weakest direction, by differences; the best point met from each start."""
    best, value = lam, kappa(w, lam)
    for _ in range(6):
        step = 1e-7 * np.maximum(1, abs(lam))
        N = pencils(w, lam) * (1 + np.minimum(abs(lam), 1 / abs(lam)))[:, None, None]
        there = pencils(w, lam + step) * (1 + np.minimum(abs(lam + step), 1 / abs(lam + step)))[:, None, None]
        weakest = np.linalg.svd(N)[0][:, :, -1].conj()[:, None, :]
        r, dr = (weakest @ N)[:, 0], (weakest @ (there - N))[:, 0] / step[:, None]
        lam = lam - np.sum(dr.conj() * r, axis=1) / np.maximum(np.sum(abs(dr) ** 2, axis=1), 1e-300)
        lam = np.where(np.isfinite(lam) & (lam != 0), lam, 1e-9)
        now = kappa(w, lam)
        best, value = np.where(now < value, lam, best), np.minimum(now, value)
    return best


def smallest(w: Window) -> float:
    """Smallest kappa that the search meets."""
    modes = sla.eigvals(w.X1, w.X0)
    rings = np.exp(1j * np.pi * np.arange(9) / 8)
    lam = np.concatenate([modes[np.isfinite(modes)], [1e-9], 0.5 * rings, rings, [1e9]])
    lam = np.where(lam == 0, 1e-9, lam)
    lam = np.concatenate([lam, newton(w, lam[np.argsort(kappa(w, lam))[:STARTS]])])
    value = kappa(w, lam)
    order = np.argsort(value)[:POLISHED]
    at, low, step = lam[order], value[order], 0.05 * np.maximum(abs(lam[order]), 1e-3)
    for _ in range(25):
        around = at[:, None] + step[:, None] * np.array([1, -1, 1j, -1j])
        around = np.where(around == 0, 1e-9, around)
        there = kappa(w, around.ravel()).reshape(around.shape)
        i = np.argmin(there, axis=1)
        gain = there[np.arange(len(at)), i] < low
        at = np.where(gain, around[np.arange(len(at)), i], at)
        low, step = np.where(gain, there.min(axis=1), low), np.where(gain, step, step / 3)
    return float(low.min())


def proves(u: np.ndarray, y: np.ndarray, std: np.ndarray, L: int, s: int, q: int) -> bool:
    """Whether the test shows R-controllability at one window length; std of the noise on each output."""
    scale = np.sqrt(np.mean(y**2, axis=0))
    w, bound = reduce(u / np.sqrt(np.mean(u**2, axis=0)), y / scale, L, s, q, float(np.max(std / scale)))
    return w is not None and kappa(w, np.array([1e9 + 0j]))[0] > bound and smallest(w) > bound


def lengths(p: int, q: int) -> list[int]:
    """Window lengths of a scan: from just above the lag of a generic plant, half as much more each time."""
    lag = -(-q // p)
    return [lag + 1, round(1.5 * (lag + 1)), 2 * (lag + 1), 3 * (lag + 1), 4 * (lag + 1)]
