# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Random descriptor systems whose structure is planted, hence known."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from .arrays import Array
from .descriptor import DescriptorSystem
from .errors import PlantError

MARGIN = 1e-3  # what is not planted as lost is kept at least this far from being lost
TRIES = 1000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Planted:
    """A system and what was planted in it; z1 and z2 in the coordinates of A1 and N.

    Attributes:
        system: the descriptor system, mixed by random S and P.
        q: order of the slow part.
        r: order of the fast part.
        s: nilpotency index (1 if r = 0).
        blocks: Jordan block sizes of N, descending.
        uncontrollable_modes: finite eigenvalues that no input reaches (unless a gain was asked for).
        unobservable_modes: finite eigenvalues that no output sees.
        r_controllable: whether every finite eigenvalue is controllable.
        c_controllable: and the infinite ones too.
        r_observable: whether every finite eigenvalue is observable.
        c_observable: and the infinite ones too.
        A1: shape (q, q).
        B1: shape (q, m).
        C1: shape (p, q).
        N: shape (r, r).
        B2: shape (r, m).
        C2: shape (p, r).
        D: shape (p, m).
        S: shape (n, n).
        P: shape (n, n).
    """

    system: DescriptorSystem
    q: int
    r: int
    s: int
    blocks: tuple[int, ...]
    uncontrollable_modes: tuple[complex, ...]
    unobservable_modes: tuple[complex, ...]
    r_controllable: bool
    c_controllable: bool
    r_observable: bool
    c_observable: bool
    A1: Array
    B1: Array
    C1: Array
    N: Array
    B2: Array
    C2: Array
    D: Array
    S: Array
    P: Array


def _orthogonal(n: int, rng: np.random.Generator) -> Array:
    Q, R = np.linalg.qr(rng.standard_normal((n, n)))
    return np.asarray(Q * np.sign(np.diag(R)))


def _mixer(n: int, condition: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """A random matrix of 2-norm condition ``condition`` and its inverse, both shape (n, n)."""
    U, V = _orthogonal(n, rng), _orthogonal(n, rng)
    sigma = np.logspace(0.5, -0.5, n, base=condition) if n > 1 else np.ones(n)
    return (U * sigma) @ V, (V.T / sigma) @ U.T


def _modal(modes: Sequence[complex]) -> Array:
    """Real block-diagonal matrix with the eigenvalues ``modes`` (conjugates implied)."""
    blocks = [
        np.array([[z.real]]) if z.imag == 0 else np.array([[z.real, -z.imag], [z.imag, z.real]])
        for z in map(complex, modes)
    ]
    return linalg.block_diag(*blocks) if blocks else np.empty((0, 0))


def order(modes: Sequence[complex]) -> int:
    """States that ``modes`` take: a real one counts once, a complex one twice (its conjugate is implied)."""
    return sum(1 if complex(z).imag == 0 else 2 for z in modes)


def random_modes(q: int, rng: np.random.Generator, radius: tuple[float, float] = (0.3, 0.95)) -> list[complex]:
    """Random eigenvalues for q states, conjugates implied, moduli uniform in ``radius``."""
    modes: list[complex] = []
    while (left := q - order(modes)) > 0:
        size = rng.uniform(*radius)
        if left == 1 or rng.random() < 0.4:
            modes.append(complex(size * rng.choice([-1.0, 1.0])))
        else:
            modes.append(complex(size * np.exp(1j * rng.uniform(0.1, np.pi - 0.1))))
    return modes


def _weakest(A: Array, B: Array) -> float:
    """Smallest singular value of [A - lambda I, B] over the eigenvalues of A; inf if there are none."""
    identity = np.eye(len(A))
    return min(
        (float(linalg.svdvals(np.hstack([A - z * identity, B]))[-1]) for z in linalg.eigvals(A)), default=np.inf
    )  # fmt: skip


def _fast_weakest(N: Array, B: Array) -> float:
    """Smallest singular value of [N, B], shape (r, r + m); inf if r = 0."""
    return float(linalg.svdvals(np.hstack([N, B]))[-1]) if len(N) else np.inf


@dataclass(frozen=True, slots=True, kw_only=True)
class _Plan:
    """What to draw. States come in this order: ``rest``, those cut from the inputs, those cut from the outputs."""

    m: int
    p: int
    modes: tuple[complex, ...] | None
    radius: tuple[float, float]
    uncontrollable: tuple[complex, ...]
    unobservable: tuple[complex, ...]
    blocks: tuple[int, ...]
    rest: int

    @property
    def bad(self) -> int:
        return order(self.uncontrollable)

    @property
    def q(self) -> int:
        return self.rest + self.bad + order(self.unobservable)


Parts = tuple[Array, Array, Array, Array, Array, Array]  # A1, B1, C1, N, B2, C2


def _draw(plan: _Plan, rng: np.random.Generator) -> Parts | None:
    """Parts in modal coordinates, nothing cut yet; None if what shall stay is not clear of being lost."""
    q, rest = plan.q, plan.rest
    free = plan.modes if plan.modes is not None else random_modes(rest, rng, plan.radius)
    A1 = _modal([*free, *plan.uncontrollable, *plan.unobservable])
    B1, C1 = rng.standard_normal((q, plan.m)), rng.standard_normal((plan.p, q))
    N = linalg.block_diag(*(np.eye(b, k=1) for b in plan.blocks)) if plan.blocks else np.empty((0, 0))
    B2, C2 = rng.standard_normal((len(N), plan.m)), rng.standard_normal((plan.p, len(N)))
    seen, reached = slice(0, rest + plan.bad), np.r_[0:rest, rest + plan.bad : q]
    clear = (
        _weakest(A1[np.ix_(reached, reached)], B1[reached]) > MARGIN
        and _weakest(A1[seen, seen].T, C1[:, seen].T) > MARGIN
        and (len(plan.blocks) > plan.m or _fast_weakest(N, B2) > MARGIN)
        and (len(plan.blocks) > plan.p or _fast_weakest(N.T, C2.T) > MARGIN)
    )
    return (A1, B1, C1, N, B2, C2) if clear else None


def _mix(parts: Parts, D: Array, mixers: Sequence[tuple[Array, Array]]) -> DescriptorSystem:
    """The system with S E P = diag(I, N), S A P = diag(A1, I); ``mixers`` are S and P with their inverses."""
    A1, B1, C1, N, B2, C2 = parts
    (_, S_inverse), (_, P_inverse) = mixers
    return DescriptorSystem(
        S_inverse @ linalg.block_diag(np.eye(len(A1)), N) @ P_inverse,
        S_inverse @ linalg.block_diag(A1, np.eye(len(N))) @ P_inverse,
        S_inverse @ np.vstack([B1, B2]),
        np.hstack([C1, C2]) @ P_inverse,
        D,
    )


def random_system(
    *,
    m: int,
    p: int,
    q: int,
    blocks: Sequence[int] = (),
    uncontrollable: Sequence[complex] = (),
    unobservable: Sequence[complex] = (),
    uncontrollable_blocks: int = 0,
    unobservable_blocks: int = 0,
    uncontrollable_gain: float = 0.0,
    unobservable_gain: float = 0.0,
    modes: Sequence[complex] | None = None,
    radius: tuple[float, float] = (0.3, 0.95),
    feedthrough: bool = True,
    conditioning: float = 10.0,
    seed: int | np.random.Generator = 0,
) -> Planted:
    """Draws a regular descriptor system with a prescribed structure.

    Args:
        m: number of inputs.
        p: number of outputs.
        q: order of the slow part.
        blocks: Jordan block sizes of N; r is their sum, s the largest (1 if there are none).
        uncontrollable: finite eigenvalues cut from the inputs; a complex one stands for the pair.
        unobservable: finite eigenvalues cut from the outputs. Both lists must fit into q together.
        uncontrollable_blocks: how many Jordan blocks of N (the smallest first) are cut from the inputs.
        unobservable_blocks: how many are cut from the outputs.
        uncontrollable_gain: instead of cutting, inputs act on those eigenvalues with this relative gain.
        unobservable_gain: instead of cutting, outputs see those eigenvalues with this relative gain.
        modes: the other finite eigenvalues; random ones if None.
        radius: range of the moduli of random eigenvalues.
        feedthrough: whether D is random; otherwise zero.
        conditioning: 2-norm condition of S, P and of the basis of the slow part.
        seed: seed, or the generator to draw from.

    Raises:
        PlantError: if the numbers do not fit, or no draw keeps the rest clear of being lost.
    """
    blocks = tuple(sorted((int(b) for b in blocks), reverse=True))
    rng = seed if isinstance(seed, np.random.Generator) else np.random.Generator(np.random.PCG64(seed))
    bad, blind = order(uncontrollable), order(unobservable)
    rest = q - bad - blind
    if min(m, p, rest) < 0 or (m and p) == 0 or any(b < 1 for b in blocks):
        raise PlantError(f"m = {m}, p = {p}, blocks {blocks} must be positive and q = {q} at least {bad + blind}")
    if max(uncontrollable_blocks, unobservable_blocks) > len(blocks):
        raise PlantError(f"only {len(blocks)} Jordan blocks can be cut")
    if q + sum(blocks) == 0:
        raise PlantError("a system needs at least one state: q or blocks")
    if modes is not None and order(modes) != rest:
        raise PlantError(f"modes take {order(modes)} states, but {rest} are left")
    plan = _Plan(
        m=m, p=p, modes=None if modes is None else tuple(modes), radius=radius, blocks=blocks, rest=rest,
        uncontrollable=tuple(uncontrollable), unobservable=tuple(unobservable),
    )  # fmt: skip
    parts = next(filter(None, (_draw(plan, rng) for _ in range(TRIES))), None)
    if parts is None:
        raise PlantError("no draw is clear of lost modes: ask for fewer equal eigenvalues, or more inputs and outputs")
    A1, B1, C1, N, B2, C2 = parts
    B1[rest : rest + bad] *= uncontrollable_gain
    C1[:, rest + bad :] *= unobservable_gain
    ends = np.cumsum(blocks, dtype=int) - 1  # the last state of a block takes the input, the first is what is seen
    B2[ends[len(blocks) - uncontrollable_blocks :]] = 0.0
    C2[:, (ends - np.array(blocks, dtype=int) + 1)[len(blocks) - unobservable_blocks :]] = 0.0

    T, T_inverse = _mixer(q, conditioning, rng) if q else (np.empty((0, 0)),) * 2
    A1, B1, C1 = T @ A1 @ T_inverse, T @ B1, C1 @ T_inverse
    mixers = [_mixer(q + len(N), conditioning, rng) for _ in "SP"]
    D = rng.standard_normal((p, m)) if feedthrough else np.zeros((p, m))
    cut, hidden = bad > 0 and uncontrollable_gain == 0, blind > 0 and unobservable_gain == 0
    return Planted(
        system=_mix((A1, B1, C1, N, B2, C2), D, mixers),
        q=q, r=len(N), s=max(blocks, default=1), blocks=blocks,
        uncontrollable_modes=tuple(map(complex, uncontrollable)) if cut else (),
        unobservable_modes=tuple(map(complex, unobservable)) if hidden else (),
        r_controllable=not cut, r_observable=not hidden,
        c_controllable=not cut and len(blocks) <= m and uncontrollable_blocks == 0,
        c_observable=not hidden and len(blocks) <= p and unobservable_blocks == 0,
        A1=A1, B1=B1, C1=C1, N=N, B2=B2, C2=C2, D=D, S=mixers[0][0], P=mixers[1][0],
    )  # fmt: skip


LOST = ((), (0.5,), (1.0,), (0.5 + 0.3j,), (1.1, -0.4), (1.0, 1.0))
UNSEEN = ((), (0.7,), (1.0,), (0.2 + 0.8j,))


def random_planted(rng: np.random.Generator, conditioning: float = 10.0) -> Planted:
    """A random system of random size: m, p in 1..4, q in 0..12, s in 1..3, about half of them with something lost.

    What is lost are modes of `LOST` from the inputs, of `UNSEEN` from the outputs, and Jordan blocks of N from either.
    """
    m, p = (int(v) for v in rng.integers(1, 5, 2))
    q, s = int(rng.integers(0, 13)), int(rng.integers(1, 4))
    count = int(rng.integers(0 if q else 1, 4))
    blocks = [s, *(int(b) for b in rng.integers(1, s + 1, count - 1))] if count else []
    lost = LOST[rng.integers(len(LOST))] if rng.random() < 0.5 else ()
    unseen = UNSEEN[rng.integers(len(UNSEEN))] if rng.random() < 0.5 else ()
    # an eigenvalue shared by k modes needs k inputs, or k outputs, to be reached and seen otherwise
    shared = 1.0 in lost and 1.0 in unseen
    if order(lost) + order(unseen) > q or (p == 1 and (lost == (1.0, 1.0) or shared)) or (m == 1 and shared):
        lost, unseen = (), ()
    cut, hidden = (int(rng.integers(0, count + 1)) if rng.random() < 0.3 else 0 for _ in range(2))
    return random_system(
        m=m, p=p, q=q, blocks=blocks, uncontrollable=lost, unobservable=unseen, uncontrollable_blocks=cut,
        unobservable_blocks=hidden, conditioning=conditioning, seed=rng,
    )  # fmt: skip
