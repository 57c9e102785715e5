# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Build of the ROS package plant_sim by colcon; `pip install` uses the pyproject.toml at the top instead."""

from setuptools import find_packages, setup

setup(
    name="plant_sim",
    version="0.1.0",
    packages=find_packages(),
    package_data={"plant_sim": ["data/*", "py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/plant_sim"]),
        ("share/plant_sim", ["package.xml"]),
    ],
    zip_safe=False,
    license="Apache-2.0",
    entry_points={
        "console_scripts": ["plant_node = plant_sim.plant_node:main"],
        "ros2_deepc.plants": [
            "wscc9 = plant_sim:wscc9",
            "net3 = plant_sim:net3",
            "wscc9_swing = plant_sim.swing_plant:wscc9_swing",
            "net3_epanet = plant_sim.epanet_plant:net3_epanet",
        ],
        "ros2_deepc.plant_node": ["plant = plant_sim.plant_node:PlantNode"],
    },
)
