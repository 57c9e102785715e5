# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The revision that a bag names is that of the code which ran, or none."""

import re
import shutil
import subprocess

import pytest

from ros2_deepc.bags.provenance import facts, revision


@pytest.fixture
def git(tmp_path):
    """Runs git in a fresh repository."""
    if shutil.which("git") is None:
        pytest.skip("no git on this machine")

    def run(*arguments):
        who = ["-c", "user.name=a", "-c", "user.email=a@b"]
        command = ["git", "-C", str(tmp_path), *who, *arguments]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()

    run("init", "-q")
    return run


def test_revision_of_a_checkout(git, tmp_path):
    source = tmp_path / "source.py"
    source.write_text("a = 1\n")
    assert revision(source) == ""  # not under version control
    git("add", "source.py")
    git("commit", "-q", "-m", "first")
    assert revision(source) == git("rev-parse", "HEAD")
    (tmp_path / "notes.txt").write_text("not part of it")
    assert revision(source) == git("rev-parse", "HEAD")
    source.write_text("a = 2\n")
    assert revision(source) == git("rev-parse", "HEAD") + "-dirty"


def test_no_repository_no_revision(tmp_path):
    assert revision(tmp_path / "source.py") == ""
    assert revision(tmp_path / "none" / "source.py") == ""


def test_facts_are_of_the_software_alone():
    found = facts()
    assert {"version_ros2-deepc", "version_numpy", "version_python"} <= set(found)
    assert all(re.fullmatch(r"[0-9][\w.+!-]*", text) for name, text in found.items() if name != "git_revision")
    assert re.fullmatch(r"([0-9a-f]{40}(-dirty)?)?", found.get("git_revision", ""))
