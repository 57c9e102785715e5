# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The operator: publishes the references of a run from its parameters."""

from typing import Any

import numpy as np
from deepc_msgs.msg import PlantInfo

from ..ros import topics
from ..ros.convert import nanoseconds, period_ns, sample
from ..ros.lifecycle import ManagedNode
from ..ros.parameters import ConfigError, Param, declare
from ..ros.publisher import PatientPublisher
from ..ros.qos import profile
from ..ros.run import run_node

PARAMETERS = (
    Param("reference_k", [0], "first sample of each reference, shape (i,), increasing", "samples"),
    Param("reference_values", [0.0], "the references, shape (i*p,), row-major (i, p)", "output units"),
    Param("readers", 0, "subscribers of reference to wait for before publishing", low=0),
)


class OperatorNode(ManagedNode):
    """Publishes every reference of the schedule as soon as a plant appears, the one in force last.

    Each carries the first sample k for which it holds, so it may be published long before; the latched one is the first.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("operator", **kwargs)
        self.p = declare(self, PARAMETERS)

    def configure(self) -> None:
        """Checks the schedule and makes the topics."""
        starts, values = self.p["reference_k"], self.p["reference_values"]
        if not starts or len(values) % len(starts) or any(b <= a for a, b in zip(starts, starts[1:], strict=False)):
            raise ConfigError(
                f"operator: reference_k = {starts} must increase, and reference_values must hold p values for each of "
                f"the {len(starts)}, got {len(values)} in all"
            )
        self._schedule = list(zip(starts, np.reshape(values, (len(starts), -1)), strict=True))
        self._publisher = PatientPublisher(self, topics.REFERENCE, lockstep=True, readers=self.p["readers"])
        self._subscription = self.create_subscription(
            PlantInfo, topics.PLANT_INFO.name, self.guarded(self._on_plant), profile(topics.PLANT_INFO)
        )

    def cleanup(self) -> None:
        """Takes the topics off the graph."""
        self._publisher.destroy()
        self.destroy_subscription(self._subscription)

    def _on_plant(self, info: PlantInfo) -> None:
        start, period = nanoseconds(info.header.stamp), period_ns(info.sample_time)
        p = len(info.output_names)
        if self._schedule[0][1].size != p:
            raise ConfigError(
                f"operator: references of {self._schedule[0][1].size} values for the {p} outputs of {info.name}: "
                "correct reference_values"
            )
        for k, values in reversed(self._schedule):
            self._publisher.publish(sample(info.name, info.epoch, k, values, start + k * period))


def main() -> int:
    """Console script: runs the operator node."""
    return run_node(OperatorNode)
