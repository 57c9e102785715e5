# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""What a plant tells about itself, and how to start it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from .arrays import Array, matrix
from .descriptor import DescriptorSystem
from .errors import ShapeError
from .stepper import LinearStepper, Stepper

InitialState = Callable[[np.random.Generator], Array]


class StructurePrior(NamedTuple):
    """What is known of the structure beforehand; 0 means not known."""

    n: int = 0
    q: int = 0
    r: int = 0
    s: int = 0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Plant:
    """A plant, linear or not, with all that a controller and a reader need.

    Attributes:
        name: short name, e.g. "wscc9".
        variant: which reading of the plant.
        description: one or two sentences for people.
        sample_time: seconds.
        system: the linear descriptor system; None for a nonlinear plant.
        input_names: m names.
        input_units: m units.
        output_names: p names.
        output_units: p units.
        input_min: shape (m,).
        input_max: shape (m,).
        prior: (n, q, r, s).
        D: direct feedthrough, shape (p, m); None when unknown.
        references: (k, values of shape (p,)) in order of k: the values hold from sample k on.
        settings: suggested controller settings (N, L, T, Q, R, terminal).
        steps: suggested length of a run.
        begin: makes a running plant from a random generator.
        state_names: n names of the states of ``system``; empty if they have none.
        notes: what was assumed or left out when the plant was made from a file.
    """

    name: str
    variant: str
    description: str
    sample_time: float
    system: DescriptorSystem | None
    input_names: tuple[str, ...]
    input_units: tuple[str, ...]
    output_names: tuple[str, ...]
    output_units: tuple[str, ...]
    input_min: Array
    input_max: Array
    prior: StructurePrior
    D: Array | None
    references: tuple[tuple[int, Array], ...]
    settings: Mapping[str, Any]
    steps: int
    begin: Callable[[np.random.Generator], Stepper]
    state_names: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        put = object.__setattr__
        m, p = len(self.input_names), len(self.output_names)
        if not (self.sample_time > 0 and np.isfinite(self.sample_time)):
            raise ShapeError(f"sample_time must be a positive number of seconds, got {self.sample_time}")
        if len(self.input_units) != m or len(self.output_units) != p:
            raise ShapeError(f"{m} inputs and {p} outputs need as many units")
        if self.system is not None and (self.system.m, self.system.p) != (m, p):
            raise ShapeError(
                f"the system has {self.system.m} inputs and {self.system.p} outputs, the names are for {m} and {p}"
            )
        if self.system is not None and len(self.state_names) not in (0, self.system.n):
            raise ShapeError(f"the system has {self.system.n} states, got {len(self.state_names)} names")
        put(self, "input_min", matrix(self.input_min, "input_min", (m,)))
        put(self, "input_max", matrix(self.input_max, "input_max", (m,)))
        if not (self.input_min < self.input_max).all():
            raise ShapeError("input_min must be below input_max in every channel")
        if self.D is not None:
            put(self, "D", matrix(self.D, "D", (p, m)))
        references = tuple((int(k), matrix(values, "reference", (p,))) for k, values in self.references)
        if list(references) != sorted(references, key=lambda item: item[0]):
            raise ShapeError("references must be in order of k")
        put(self, "references", references)
        put(self, "settings", MappingProxyType(dict(self.settings)))

    def start(self, seed: int) -> Stepper:
        """Starts the plant; everything random about it comes from ``seed``."""
        return self.begin(np.random.Generator(np.random.PCG64([seed, 0])))

    def reference(self, k: int) -> Array | None:
        """The reference that holds at sample ``k``, shape (p,); None before the first."""
        held = None
        for first, values in self.references:
            if first <= k:
                held = values
        return held


def linear_start(system: DescriptorSystem, initial: InitialState) -> Callable[[np.random.Generator], Stepper]:
    """How a linear plant begins: ``initial`` returns x(0), shape (n,), of which only E x(0) matters."""

    def begin(rng: np.random.Generator) -> Stepper:
        return LinearStepper(system.weierstrass(), system.slow_state(initial(rng)))

    return begin


def system_prior(system: DescriptorSystem) -> StructurePrior:
    """The true (n, q, r, s)."""
    form = system.weierstrass()
    return StructurePrior(n=system.n, q=form.q, r=form.r, s=form.s)


def suggested_settings(system: DescriptorSystem, N: int = 0, L: int = 0) -> dict[str, Any]:
    """Controller settings that suit the size of a linear plant.

    Unless N and L are given, N reaches back over the lag that generic outputs need plus two samples, and L looks twice
    as far ahead. T is the least record whose Hankel matrix of depth N + L can have full rank m (N + L) + q, plus a
    tenth.
    """
    q, s = system.weierstrass().q, system.weierstrass().s
    N = N or max(2, -(-q // max(1, system.p)) + 2) + s - 1
    L = L or 2 * N
    T = (system.m + 1) * (N + L) + q + s
    return {
        "N": N,
        "L": L,
        "T": T + -(-T // 10),
        "Q": [1.0] * system.p,
        "R": [1.0] * system.m,
        "terminal": "equilibrium",
    }
