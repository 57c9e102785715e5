# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""DeePC: predictor, condensed quadratic program, controller. Pure: no ROS."""
