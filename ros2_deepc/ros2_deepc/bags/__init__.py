# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""MCAP bags in the layout of rosbag2: write, read, replay."""
