# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Every worker has a DDS domain of its own on this machine only, one BLAS thread, and logs in a temporary folder."""

import os
import tempfile

import pytest
from threadpoolctl import threadpool_limits

_WORKER = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
_RUN = int(os.environ.get("PYTEST_XDIST_TESTRUNUID", f"{os.getpid():x}")[-6:], 16)
DOMAIN = (_RUN % 24) * 4 + _WORKER % 4

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_DOMAIN_ID"] = str(DOMAIN)
os.environ["ROS_LOG_DIR"] = tempfile.mkdtemp(prefix="ros_log_")
os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"


@pytest.fixture(autouse=True, scope="session")
def _one_blas_thread():
    with threadpool_limits(limits=1):
        yield


@pytest.fixture(scope="session")
def domain_id():
    """The DDS domain of this worker."""
    return DOMAIN
