# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Build of the ROS package ros2_deepc by colcon; `pip install` uses the pyproject.toml at the top instead."""

from glob import glob

from setuptools import find_packages, setup

setup(
    name="ros2_deepc",
    version="0.1.0",
    packages=find_packages(),
    package_data={"ros2_deepc": ["py.typed", "bags/*.js", "bags/*.css"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/ros2_deepc"]),
        ("share/ros2_deepc", ["package.xml"]),
        ("share/ros2_deepc/launch", glob("../launch_scripts/*.launch.py")),
        ("share/ros2_deepc/config", glob("../launch_scripts/config/*.yaml")),
    ],
    zip_safe=False,
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "ros2-deepc = ros2_deepc.cli:main",
            "controller_node = ros2_deepc.nodes.controller_node:main",
            "monitor_node = ros2_deepc.nodes.monitor_node:main",
            "recorder_node = ros2_deepc.nodes.recorder_node:main",
            "operator_node = ros2_deepc.nodes.operator_node:main",
            "gateway_node = ros2_deepc.gateway.gateway_node:main",
        ],
    },
)
