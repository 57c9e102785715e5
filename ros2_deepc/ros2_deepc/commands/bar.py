# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""A bar that shows how far a long command is."""

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import Progress as Bar

from ..bags.progress import Progress


@contextmanager
def bar(console: Console, words: str) -> Iterator[Progress]:
    """Shows a bar until the end of the block; what it gives takes what is done and all there is."""
    with Bar(console=console, transient=True, disable=not console.is_terminal) as shown:
        task = shown.add_task(words)
        yield lambda done, total: shown.update(task, completed=done, total=total)
