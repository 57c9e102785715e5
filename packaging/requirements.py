# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Prints what building and running needs, one requirement a line, for tools that build without pip (colcon)."""

import tomllib
from pathlib import Path

with (Path(__file__).parents[1] / "pyproject.toml").open("rb") as file:
    project = tomllib.load(file)
build = [text for text in project["build-system"]["requires"] if not text.startswith("scikit-build-core")]
print("\n".join(build + project["project"]["dependencies"]))
