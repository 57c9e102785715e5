# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The WSCC 9-bus grid: zone.launch.py with plant:=wscc9.

ros2 launch ros2_deepc wscc9.launch.py seed:=1 record:=true
"""

from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription
from launch.substitutions import PathJoinSubstitution, ThisLaunchFileDir


def generate_launch_description():
    zone = PathJoinSubstitution([ThisLaunchFileDir(), "zone.launch.py"])
    return LaunchDescription([IncludeLaunchDescription(zone, launch_arguments={"plant": "wscc9"}.items())])
