# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Numbers that do not fit in memory: in a temporary file that is gone when it is closed, or when the process ends."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from .errors import BagError, why

IN_MEMORY = 16_000_000  # bytes that need no file


class Spill:
    """Arrays, written one behind the other and read back in any order; in memory as long as they are few."""

    def __init__(self) -> None:
        self._file: IO[bytes] = tempfile.SpooledTemporaryFile(IN_MEMORY)  # noqa: SIM115  # closed by close
        self._end = 0

    def write(self, values: NDArray[Any]) -> int:
        """Keeps an array; returns where it is.

        Raises:
            BagError: if there is no room, or no folder for temporary files.
        """
        at = self._end
        with _told():
            self._file.seek(at)
            self._end += self._file.write(np.ascontiguousarray(values).tobytes())
        return at

    def read(self, at: int, kind: Any, shape: tuple[int, ...]) -> NDArray[Any]:
        """The array that was written there, or a part of it."""
        out = np.empty(shape, dtype=kind)
        with _told():
            self._file.seek(at)
            if self._file.readinto(memoryview(out).cast("B")) != out.nbytes:  # type: ignore[attr-defined]
                raise OSError("the file is shorter than what was written")
        return out

    def close(self) -> None:
        """Gives the room back."""
        with suppress(OSError):  # what could not be written is of no use any more
            self._file.close()

    def __del__(self) -> None:
        self.close()


@contextmanager
def _told() -> Iterator[None]:
    """Errors of the file as one line that says where it is, and what to do."""
    try:
        yield
    except OSError as error:
        folder = os.environ.get("TMPDIR") or tempfile.gettempdir()
        raise BagError(
            f"cannot keep samples in the temporary folder {folder}: {why(error)}; "
            "make room there, or name another folder in TMPDIR"
        ) from error
