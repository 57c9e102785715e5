# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The paper's Theorems 1 to 4 exactly as printed, so that anyone can check them against the corrected ones."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from .noise import Noise
from .pencil import reduce
from .search import minimum
from .source import Source
from .theorems import threshold
from .verdict import Printed, Prior


class PrintedTheorems(Mapping[int, Printed]):
    """Theorems 1 to 4 by number, each computed when first asked for.

    Theorems 1 and 2 ask for a rank at every complex lambda; here infinity counts as well, since rank that vanishes as
    lambda grows cannot be told from rank lost.

    Args:
        source: the data.
        prior: what is known of the plant.
        L: block rows of the data matrices; Theorems 3 and 4 take at least the L that they ask for.
        noise: on the outputs.
    """

    def __init__(self, source: Source, prior: Prior, L: int, noise: Noise) -> None:
        self._asked = (source, prior, L, noise)
        self._known: dict[int, Printed] = {}

    def __getitem__(self, number: int) -> Printed:
        """The theorem of that number, 1 to 4."""
        if number not in (1, 2, 3, 4):
            raise KeyError(number)
        if number not in self._known:
            self._known[number] = _theorem(number, *self._asked)
        return self._known[number]

    def __iter__(self) -> Iterator[int]:
        return iter((1, 2, 3, 4))

    def __len__(self) -> int:
        return 4


def _theorem(number: int, source: Source, prior: Prior, L: int, noise: Noise) -> Printed:
    """One theorem on the data, or why it cannot be asked."""
    slow = number in (1, 3)
    if not slow and not prior.n:
        return Printed(holds=False, rank=0, required=0, reason="needs the state dimension n")
    if number == 3:
        L = max(L, prior.q)
    elif number == 4:
        L = max(L, prior.q, prior.r)
    pencil = number in (1, 2)
    try:
        data = source.window(L, L + 1) if pencil else source.window(L - 1, L)
        bound = noise.hankel_bound(data, noise.level(data, source.y_scale, prior.q))
    except ValueError as error:
        return Printed(holds=False, rank=0, required=0, reason=str(error))
    inputs = data.m * L
    beyond = data.m * (prior.s - 1) + prior.q if slow else prior.n
    eps = threshold(data, beyond, bound)
    if data.inverse is None:
        reason = f"the inputs are not persistently exciting of order {data.d}"
        return Printed(holds=False, rank=0, required=inputs + beyond, reason=reason)
    seen = int(np.count_nonzero(data.sigma > eps))
    rank, lam = inputs + seen, complex("nan")
    if pencil and 0 < seen <= beyond:
        reduced = reduce(data, seen)
        low = minimum(reduced)
        rank, lam = inputs + int(np.count_nonzero(low.sigma > eps + reduced.floor)), low.lambda_
    holds = rank == inputs + beyond
    reason = "" if holds else f"rank {rank} where {inputs + beyond} is asked for"
    return Printed(holds=holds, rank=rank, required=inputs + beyond, lambda_star=lam, reason=reason)
