# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

import numpy as np
import pytest

from plant_sim.random_systems import random_planted


@pytest.fixture(scope="session")
def planted_systems():
    """Sixty random systems with planted structure."""
    return [random_planted(np.random.Generator(np.random.PCG64([index, 7]))) for index in range(60)]
