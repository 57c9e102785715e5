# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The one place that knows rclpy idioms."""

import os
import sys

# The ROS wheels live in sys.prefix but do not say so; a sourced ROS environment does, and then it counts.
os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)
