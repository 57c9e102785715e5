# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Plants with a known model, the loop around the controller, and predictive control on that model by another solver."""

from dataclasses import dataclass, field

import numpy as np
import pytest
import quadprog

from plant_sim.random_systems import random_system
from plant_sim.stepper import LinearStepper
from ros2_deepc.control import DeepcController, DeepcSettings
from ros2_deepc.control.problem import CALM, TINY


def generator(*seed):
    return np.random.Generator(np.random.PCG64(list(seed)))


@dataclass
class Truth:
    """Exact predictions y_f = O z1 + T [committed; planned] from the quasi-Weierstrass form, and MPC on them."""

    form: object
    L: int

    def __post_init__(self):
        f, L = self.form, self.L
        p, m = f.D.shape
        steps = L + f.s - 1
        self.O = np.vstack([f.C1 @ np.linalg.matrix_power(f.A1, k) for k in range(L)])
        self.T = np.zeros((p * L, m * steps))
        for k in range(L):
            for j in range(k):
                block = f.C1 @ np.linalg.matrix_power(f.A1, k - 1 - j) @ f.B1
                self.T[p * k : p * (k + 1), m * j : m * (j + 1)] += block
            for i, P in enumerate(f.markov()):
                self.T[p * k : p * (k + 1), m * (k + i) : m * (k + i + 1)] += P

    def predict(self, z1, inputs):
        """Outputs (L, p) from the slow state and inputs (L + s - 1, m)."""
        return (self.O @ z1 + self.T @ np.ravel(inputs)).reshape(self.L, -1)

    def equilibrium(self, z1, committed, last, goal, settings, y_scale):
        """Planned inputs (L, m) for terminal "equilibrium" with rest as equality rows; None if they cannot hold.

        Up to a weight of 10, rest is a square as any other. The plan's last sample is the steady state that it tracks.
        Unknowns: the inputs up to the tail, and a slack per limited output. quadprog on the null space of the equality
        rows.
        """
        L, (p, m), tail, form = self.L, self.form.D.shape, settings.tail, self.form
        known = m * (form.s - 1)
        block = np.kron(np.eye(L - tail + 1)[np.minimum(np.arange(L), L - tail)], np.eye(m))
        G, g = self.T[:, known:] @ block, self.O @ z1 + self.T[:, :known] @ np.ravel(committed)
        off, away = G - np.tile(G[-p:], (L, 1)), g - np.tile(g[-p:], L)
        Q, R, offset = settings.Q, settings.R, settings.offset_weight
        pull = offset * Q * np.sum(G[-p:, -m:] ** 2) / m
        gain = form.C1 @ np.linalg.pinv(np.eye(len(form.A1)) - form.A1) @ form.B1 + form.markov().sum(axis=0)
        acting = np.linalg.pinv(gain, rcond=1e-9) @ gain
        squares = [
            (off, away, Q),
            (G[-p:], g[-p:] - goal, offset * Q),
            (block - np.kron(np.ones((L, 1)), block[-m:]), np.zeros(m * L), R),
            (acting @ block[-m:], -acting @ last, max(CALM * pull, TINY * R)),
            ((np.eye(m) - acting) @ block[-m:], np.zeros(m), TINY * R),
        ]
        rest = (off[-p * tail : -p], away[-p * tail : -p])
        if settings.terminal_weight <= 10:
            squares.append((*rest, settings.terminal_weight * Q))
            rest = (rest[0][:0], rest[1][:0])
        n, low, high = G.shape[1], np.broadcast_to(settings.y_min, p), np.broadcast_to(settings.y_max, p)
        limited = p if np.isfinite([low, high]).any() else 0
        price = settings.slack_weight * np.mean(Q * y_scale**2)  # of a slack of the size of the data
        H, f = np.zeros((n + limited, n + limited)), np.zeros(n + limited)
        H[:n, :n] = sum(2 * weight * C.T @ C for C, _, weight in squares)
        f[:n] = sum(2 * weight * C.T @ d for C, d, weight in squares)
        if limited:
            H[n:, n:], f[n:] = price * np.diag(y_scale**-2.0), price / y_scale
        slack = np.tile(np.eye(p), (L, 1))[:, :limited]
        moves, before = block - np.vstack([np.zeros((m, n)), block[:-m]]), np.zeros(m * L)
        before[:m] = np.clip(last, settings.u_min, settings.u_max)
        rate = np.tile(np.broadcast_to(settings.du_max, m), L)
        wide = np.zeros((m * L, limited))
        rows = [  # C x >= b
            (np.eye(n + limited)[:n], np.full(n, settings.u_min)),
            (-np.eye(n + limited)[:n], np.full(n, -settings.u_max)),
            (np.eye(n + limited)[n:], np.zeros(limited)),
            (np.hstack([moves, wide]), before - rate),
            (-np.hstack([moves, wide]), -before - rate),
            (np.hstack([G, slack]), np.tile(low, L) - g),
            (np.hstack([-G, slack]), g - np.tile(high, L)),
        ]
        C, b = np.vstack([C for C, _ in rows]), np.concatenate([b for _, b in rows])
        E = np.hstack([rest[0], np.zeros((len(rest[0]), limited))])
        x0 = -np.linalg.lstsq(E, rest[1], rcond=1e-9)[0]
        if np.abs(E @ x0 + rest[1]).max(initial=0.0) > 1e-9 * max(1.0, np.abs(away).max()):
            return None
        _, sv, Vt = np.linalg.svd(E)
        N = Vt[int((sv > 1e-9 * sv.max(initial=0.0)).sum()) :].T
        reduced, keep = C @ N, np.isfinite(b)
        trivial = np.abs(reduced).sum(axis=1) < 1e-9  # the equality rows leave them nothing to say
        if (trivial & (C @ x0 < b - 1e-9)).any():
            return None
        keep &= ~trivial
        N = np.linalg.solve(np.linalg.cholesky(N.T @ H @ N), N.T).T  # N' H N = 1: prices lie nine decades apart
        try:
            v = quadprog.solve_qp(np.eye(N.shape[1]), -N.T @ (f + H @ x0), (C @ N)[keep].T, (b - C @ x0)[keep])[0]
        except ValueError:  # "constraints are inconsistent"
            return None
        return (block @ (x0 + N @ v)[:n]).reshape(L, m)

    def mpc(self, z1, committed, goal, Q, R, low, high, zero_tail=0):
        """Planned inputs (L, m) of (6.1) without data: quadprog on the model; zero_tail > 0 imposes (6.1c)."""
        L, (p, m) = self.L, self.form.D.shape
        known = m * (self.form.s - 1)
        G, g = self.T[:, known:], self.O @ z1 + self.T[:, :known] @ np.ravel(committed)
        Qs, Rs = np.kron(np.eye(L), Q), np.kron(np.eye(L), R)
        e = g - np.ravel(np.broadcast_to(goal, (L, p)))
        H, f = G.T @ Qs @ G + Rs, G.T @ Qs @ e
        basis, offset = np.eye(m * L), np.zeros(m * L)
        if zero_tail:
            E = np.vstack([np.eye(m * L)[-m * zero_tail :], G[-p * zero_tail :]])
            d = np.concatenate([np.zeros(m * zero_tail), -e[-p * zero_tail :]])
            _, sv, Vt = np.linalg.svd(E)
            rank = int((sv > 1e-9 * sv[0]).sum())
            offset = np.linalg.lstsq(E, d, rcond=1e-9)[0]
            assert np.abs(E @ offset - d).max() < 1e-7 * max(1, np.abs(d).max()), "the terminal condition cannot hold"
            basis = Vt[rank:].T
        Hb = basis.T @ H @ basis
        fb = basis.T @ (f + H @ offset)
        C = np.vstack([basis, -basis])
        b = np.concatenate([low - offset, offset - high])
        keep = np.abs(C).sum(axis=1) > 1e-12
        x = quadprog.solve_qp((Hb + Hb.T) / 2, -fb, C[keep].T, b[keep])[0]
        return (offset + basis @ x).reshape(L, m)


@dataclass
class Loop:
    """A controller on a plant: excites with white noise until the controller is ready, then closes the loop."""

    form: object
    settings: DeepcSettings
    seed: int = 0
    z10: object = None
    noise: float = 0.0
    dither: float = 0.0
    u: list = field(default_factory=list)
    y: list = field(default_factory=list)

    def __post_init__(self):
        self.p, self.m = self.form.D.shape
        self.rng = generator(self.seed, 7)
        z10 = self.rng.standard_normal(self.form.q) if self.z10 is None else self.z10
        self.stepper = LinearStepper(self.form, z10)
        self.controller = DeepcController(self.m, self.p, self.settings)
        for _ in range(self.settings.s - 1):
            self.stepper.push(self.apply(self.excitation()))
        self.apply(self.excitation())

    def excitation(self):
        low = np.broadcast_to(self.settings.u_min, (self.m,))
        high = np.broadcast_to(self.settings.u_max, (self.m,))
        return self.rng.uniform(np.maximum(low, -1), np.minimum(high, 1))

    def apply(self, u):
        self.u.append(np.array(u))
        self.controller.commit(u)
        return self.u[-1]

    def sense(self):
        """The plant takes the last decided input and answers; the controller observes."""
        y = self.stepper.push(self.u[-1]) + self.noise * self.rng.standard_normal(self.p)
        self.y.append(y)
        self.controller.observe(self.u[len(self.y) - 1], y)
        return y

    def collect(self):
        """Runs open loop until the controller is ready."""
        while True:
            self.sense()
            if self.controller.ready:
                return self
            self.apply(self.excitation())

    def step(self, reference):
        """One closed-loop sample, from the last observation to the next one; returns the step's result."""
        result = self.controller.step(reference)
        extra = self.dither * self.rng.uniform(-1, 1, self.m)
        self.apply(np.clip(result.u + extra, self.settings.u_min, self.settings.u_max) if self.dither else result.u)
        self.sense()
        return result

    @property
    def committed(self):
        """Inputs decided after the last observed sample, (s - 1, m)."""
        return np.array(self.u[len(self.y) :]).reshape(-1, self.m)


@pytest.fixture(scope="session")
def truth():
    return Truth


@pytest.fixture(scope="session")
def loop():
    return Loop


@pytest.fixture(scope="session")
def plant_form():
    """Quasi-Weierstrass form of a random plant; s picks one Jordan block of that size (none for s = 1)."""

    def make(seed, m=3, p=2, q=6, s=1, radius=(0.3, 0.9), **how):
        blocks = (s, 1) if s > 1 else ()
        return random_system(m=m, p=p, q=q, blocks=blocks, radius=radius, seed=seed, **how).system.weierstrass()

    return make
