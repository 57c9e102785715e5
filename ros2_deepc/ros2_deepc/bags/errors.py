# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""The one exception of the bag code."""

import os
from pathlib import Path


class BagError(OSError):
    """A bag cannot be written or read; the message is one line that says what, where and what to do."""

    def __init__(self, message: str) -> None:
        super().__init__(message)


def why(error: BaseException) -> str:
    """Returns the plain reason of an operating-system error ("No space left on device") or the error's own text."""
    text = (getattr(error, "strerror", None) or str(error) or type(error).__name__).strip()
    return text.splitlines()[0]


def check_target(path: str | os.PathLike[str]) -> None:
    """Looks, before long work, at whether its result can be written.

    Raises:
        BagError: if there is no such folder, it forbids writing, or the path is a folder.
    """
    path = Path(path)
    if path.is_dir():
        raise BagError(f"cannot write {path}: it is a folder; name a file in it")
    if not path.parent.is_dir():
        raise BagError(f"cannot write {path}: there is no folder {path.parent}; make it first")
    if not os.access(path if path.exists() else path.parent, os.W_OK):
        raise BagError(f"cannot write {path}: Permission denied; choose another place")


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Writes a text file.

    Raises:
        BagError: if it cannot be written.
    """
    try:
        Path(path).write_text(text, encoding="utf-8")
    except OSError as error:
        raise BagError(f"cannot write {path}: {why(error)}") from error
