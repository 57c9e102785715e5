# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

import numpy as np
import pytest

from plant_sim.random_systems import random_planted

TOWN = """
[JUNCTIONS]
 J1 10 20
 J2 12 15
 J3 5 8
 J4 0 5
 J5 3 4
[RESERVOIRS]
 R 60
 LOW 15
[TANKS]
 T 62 5 0 10 15 0
[PIPES]
 P0 R J1 500 400 {rough} 0 Open
 P1 J1 J2 800 300 {rough} 2 Open
 P2 J2 J3 700 250 {rough} 0 Open
 P3 J1 J3 1200 250 {rough} 0 Open
 P4 J5 T 300 300 {rough} 0 Open
 P5 J4 LOW 900 150 {rough} 0 Open
[PUMPS]
 U J3 J5 HEAD C SPEED 0.9
[VALVES]
 V J2 J4 200 {valve} 0
[CURVES]
{curve}
 G 0 0
 G 20 1
 G 50 6
 G 100 30
[OPTIONS]
 Units LPS
 Headloss {formula}
[TIMES]
 Duration 2:00
 Hydraulic Timestep 1:00
[END]
"""
CURVES = {
    "one": " C 40 30",
    "three": " C 0 45\n C 40 30\n C 80 5",
    "many": " C 0 45\n C 20 41\n C 40 30\n C 60 18\n C 90 2",
}


@pytest.fixture
def town(tmp_path):
    """Writes a small network with a tank, a pump and a valve; returns its path."""

    def write(*, formula="H-W", rough=110, valve="TCV 5", curve="three"):
        path = tmp_path / "town.inp"
        path.write_text(TOWN.format(formula=formula, rough=rough, valve=valve, curve=CURVES[curve]))
        return path

    return write


@pytest.fixture(scope="session")
def planted_systems():
    """Sixty random systems with planted structure."""
    return [random_planted(np.random.Generator(np.random.PCG64([index, 7]))) for index in range(60)]
