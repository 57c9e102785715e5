# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""MCAP bags in the layout of rosbag2: write, read, replay."""

from .errors import BagError
from .reader import BagReader
from .recording import Recording, load_run
from .replay import replay
from .run import Run
from .summary import summarize
from .writer import BagWriter

__all__ = ["BagError", "BagReader", "BagWriter", "Recording", "Run", "load_run", "replay", "summarize"]
