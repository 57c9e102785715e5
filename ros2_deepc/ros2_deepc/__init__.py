# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Online DeePC and proofs from data for descriptor systems, on ROS 2."""
