# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Every worker has a DDS domain of its own on this machine only, one BLAS thread, and logs in a temporary folder."""

import json
import os
import shutil
import subprocess
import tempfile
from pathlib import Path

import pytest
from threadpoolctl import threadpool_limits

_WORKER = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
_RUN = int(os.environ.get("PYTEST_XDIST_TESTRUNUID", f"{os.getpid():x}")[-6:], 16)
DOMAIN = (_RUN % 24) * 4 + _WORKER % 4

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_DOMAIN_ID"] = str(DOMAIN)
os.environ["ROS_LOG_DIR"] = tempfile.mkdtemp(prefix="ros_log_")
os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"


JAVASCRIPT = Path(__file__).parent / "bags" / "js"
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


@pytest.fixture
def in_browser(tmp_path):
    """Opens a page in Chromium, light, dark and narrow; what was seen of each, see bags/js/open.mjs."""

    def opened(page):
        if not (CHROMIUM and shutil.which("node") and (JAVASCRIPT / "node_modules" / "playwright-core").is_dir()):
            missing = "no Chromium, no node, or no npm install in tests/bags/js"
            (pytest.fail if os.environ.get("PEERS") == "required" else pytest.skip)(missing)
        command = ["node", "open.mjs", CHROMIUM, str(page), str(tmp_path)]
        out = subprocess.run(command, cwd=JAVASCRIPT, check=True, capture_output=True, text=True).stdout
        return [json.loads(line) for line in out.splitlines()]

    return opened


@pytest.fixture(autouse=True, scope="session")
def _one_blas_thread():
    with threadpool_limits(limits=1):
        yield


@pytest.fixture(scope="session")
def domain_id():
    """The DDS domain of this worker."""
    return DOMAIN
