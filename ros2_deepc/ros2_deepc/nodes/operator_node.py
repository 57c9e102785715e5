# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The operator: publishes the references of a run from its parameters."""

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
from deepc_msgs.msg import PlantInfo
from numpy.typing import NDArray

from ..ros import topics
from ..ros.convert import nanoseconds, period_ns, sample
from ..ros.lifecycle import ManagedNode
from ..ros.parameters import ConfigError, Param
from ..ros.run import run_node

PARAMETERS = (
    Param("reference_k", [0], "first sample of each reference, shape (i,), increasing", "samples"),
    Param("reference_values", [0.0], "the references, shape (i*p,), row-major (i, p)", "output units"),
    Param("readers", 0, "subscribers of reference to wait for before publishing", low=0),
)


Schedule = list[tuple[int, NDArray[np.float64]]]


def schedule(parameters: Mapping[str, Any], p: int) -> Schedule:
    """The references of a run, (k, shape (p,)) in order of k.

    Raises:
        ConfigError: if the parameters do not hold p values for each reference.
    """
    given = {row.name: row.default for row in PARAMETERS} | dict(parameters)
    starts, values = given["reference_k"], given["reference_values"]
    if any(b <= a for a, b in pairwise(starts)):
        raise ConfigError(f"operator: reference_k = {starts} must increase")
    if len(values) != len(starts) * p:
        raise ConfigError(
            f"operator: reference_values has {len(values)} entries, needs {len(starts)} references of {p} outputs each"
        )
    return list(zip(starts, np.reshape(values, (len(starts), p)), strict=True))


class OperatorNode(ManagedNode):
    """Publishes every reference of the schedule as soon as a plant appears, the one in force last.

    Each carries the first sample k for which it holds, so it may be published long before.
    """

    parameters = PARAMETERS

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("operator", **kwargs)

    @classmethod
    def check(cls, parameters: Mapping[str, Any], info: PlantInfo) -> None:
        """Whether the references fit the plant's outputs."""
        schedule(parameters, len(info.output_names))

    def configure(self) -> None:
        """Makes the topics."""
        self._publisher = self.advertise(topics.REFERENCE, readers=self.p["readers"])
        self.subscribe(topics.PLANT_INFO, self._on_plant)

    def _on_plant(self, info: PlantInfo) -> None:
        start, period = nanoseconds(info.header.stamp), period_ns(info.sample_time)
        for k, values in reversed(schedule(self.p, len(info.output_names))):
            self._publisher.publish(sample(info.name, info.epoch, k, values, start + k * period))


def main() -> int:
    """Console script: runs the operator node."""
    return run_node(OperatorNode)


if __name__ == "__main__":
    raise SystemExit(main())
