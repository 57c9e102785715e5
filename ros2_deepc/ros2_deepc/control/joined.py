# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Outputs and the disturbances measured at the same instant, which come on topics of their own."""

from typing import Generic, TypeVar

from .disturbances import DisturbanceRecord

Outputs = TypeVar("Outputs")


class Joined(Generic[Outputs]):
    """Keeps outputs back until the disturbances of the same sample are known.

    Args:
        record: of the disturbances.
        needed: whether there are any; if not, outputs pass at once.
    """

    def __init__(self, record: DisturbanceRecord, needed: bool) -> None:
        self._record, self._needed = record, needed
        self._waiting: tuple[int, Outputs] | None = None

    def outputs(self, k: int, outputs: Outputs) -> list[tuple[int, Outputs]]:
        """Takes outputs k; returns what can go on, in order of k.

        Outputs that still wait when later ones come go on without disturbances: those were lost.
        """
        late = [] if self._waiting is None else [self._waiting]
        self._waiting = (k, outputs)
        return late + self.told()

    def told(self) -> list[tuple[int, Outputs]]:
        """What can go on after disturbances became known."""
        if self._waiting is None or (self._needed and self._record.at(self._waiting[0]) is None):
            return []
        ready, self._waiting = self._waiting, None
        return [ready]
