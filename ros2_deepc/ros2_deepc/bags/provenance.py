# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Where a recording comes from: versions and revision of the software, nothing of the machine."""

import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

_PACKAGES = ("ros2-deepc", "numpy", "scipy", "osqp", "daqp", "mcap", "ros-rclpy")
_SECONDS = 5.0


def facts() -> dict[str, str]:
    """What somebody needs to know of the software a year later: ``version_<package>`` of each, and ``git_revision``.

    A package that is not installed and a revision that is not known are left out.
    """
    found = {"version_python": platform.python_version()}
    for name in _PACKAGES:
        try:
            found[f"version_{name}"] = version(name)
        except PackageNotFoundError:  # on an installed ROS, rclpy is no Python distribution
            continue
    if known := revision(Path(__file__)):
        found["git_revision"] = known
    return found


def revision(source: Path) -> str:
    """The commit from which a source file comes, with "-dirty" behind it if the checkout was changed since.

    Returns:
        40 hexadecimal digits and maybe "-dirty"; "" if the file is not under version control, or there is no git.
    """
    if not _git(source.parent, "ls-files", "--", source.name):  # a checkout of something else, e.g. around a venv
        return ""
    commit = _git(source.parent, "rev-parse", "HEAD")
    changed = _git(source.parent, "status", "--porcelain", "--untracked-files=no")
    return f"{commit}-dirty" if commit and changed else commit


def _git(folder: Path, *arguments: str) -> str:
    try:
        done = subprocess.run(
            ["git", "-C", str(folder), *arguments], capture_output=True, text=True, timeout=_SECONDS, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""
