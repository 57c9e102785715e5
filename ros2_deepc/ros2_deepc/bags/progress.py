# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""How long work tells how far it is."""

from collections.abc import Callable

Progress = Callable[[int, int], None]  # done, and in all


def no_progress(done: int, total: int) -> None:
    """Tells nobody."""
