# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Quality of service of every topic."""

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from .topics import CLOCK, DISTURBANCES, INPUTS, OUTPUTS, STATE, Topic

_SAMPLES = (OUTPUTS, INPUTS, DISTURBANCES, STATE)


def profile(topic: Topic, *, lockstep: bool = True, sample_time: float = 0.0) -> QoSProfile:
    """The profile of a topic.

    Samples are reliable: one lost sample corrupts as many Hankel columns as there are block rows. In lockstep
    nothing may be overwritten either, however far a reader lags, so the history keeps all.

    Args:
        topic: one row of the topic table.
        lockstep: whether the loop waits for every message.
        sample_time: Ts [s]; outputs and inputs of a real-time loop promise one message every two periods.
    """
    if topic is CLOCK:
        return QoSProfile(depth=topic.depth, reliability=ReliabilityPolicy.BEST_EFFORT)
    if topic.latched:
        return QoSProfile(depth=topic.depth, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    if topic in _SAMPLES and lockstep:
        return QoSProfile(history=HistoryPolicy.KEEP_ALL)
    qos = QoSProfile(depth=topic.depth)
    if topic in (OUTPUTS, INPUTS) and sample_time > 0.0:
        qos.deadline = Duration(seconds=2.0 * sample_time)
    return qos
