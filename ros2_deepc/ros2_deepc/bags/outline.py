# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Many CDR messages of one type as columns, decoded together.

Where the fields of a message lie depends on the lengths of its strings and sequences alone. Messages of one topic
mostly agree in those, so that one walk through the first message serves for all that have the same length words in the
same places: their fields are columns of one matrix of bytes.
"""

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .decode import Field, parse_definition
from .errors import BagError, why
from .messages import Messages
from .schema import NUMBERS

_KNOWN = 64  # outlines kept for each size of message


@dataclass(frozen=True, slots=True, eq=False)
class Outline:
    """Where the fields of a message lie.

    Attributes:
        words: positions of the bytes that decide on that: its header and all lengths.
        values: those bytes.
        fields: by path such as "header.stamp.sec": position, type, and number of values (-1 for a single one).
    """

    words: NDArray[np.intp]
    values: NDArray[np.uint8]
    fields: Mapping[str, tuple[int, np.dtype[Any], int]]

    def fits(self, matrix: NDArray[np.uint8]) -> NDArray[np.bool_]:
        """Which rows of a matrix (n, size) of messages have this outline."""
        return np.asarray((matrix[:, self.words] == self.values).all(axis=1))


class Outliner:
    """Finds the outlines of the messages of one type.

    Args:
        name: type name, e.g. ``deepc_msgs/msg/Sample``.
        text: its concatenated ros2msg definition.

    Raises:
        BagError: if the definition cannot be read.
    """

    def __init__(self, name: str, text: str) -> None:
        package, *_, kind = name.split("/")
        self.name, self._root = name, f"{package}/{kind}"
        self._types = parse_definition(name, text)
        self._known: dict[int, list[Outline]] = {}

    def __call__(self, message: NDArray[np.uint8]) -> Outline:
        """The outline of one message, shape (size,).

        Raises:
            BagError: if the bytes do not fit the type.
        """
        known = self._known.setdefault(len(message), [])
        for outline in known:
            if outline.fits(message[None])[0]:
                return outline
        if len(known) >= _KNOWN:
            known.clear()
        known.append(self._walked(message))
        return known[-1]

    def _walked(self, message: NDArray[np.uint8]) -> Outline:
        walk = _Walk(message.tobytes(), self._types)
        try:
            walk.message(self._root, "")
            if walk.at > len(message):
                raise ValueError("the last field runs over the end")
        except (struct.error, IndexError, ValueError) as error:
            raise BagError(f"{len(message)} bytes are no {self.name}: {why(error)}") from error
        words = np.array([*range(4), *(at + i for at in walk.words for i in range(4))], dtype=np.intp)
        return Outline(words, message[words], walk.fields)


@lru_cache(maxsize=256)
def outliner(name: str, text: str) -> Outliner:
    """The one outliner of a type, see ``Outliner``."""
    return Outliner(name, text)


class _Walk:
    """Goes through one message and notes where what is; positions are those in the message with its 4-byte header."""

    def __init__(self, data: bytes, types: Mapping[str, tuple[Field, ...]]) -> None:
        self._data, self._types = data, types
        self._order = "<" if data[1] & 1 else ">"
        self._word = struct.Struct(f"{self._order}I").unpack_from
        self.at = 4
        self.words: list[int] = []
        self.fields: dict[str, tuple[int, np.dtype[Any], int]] = {}

    def message(self, name: str, path: str) -> None:
        if name not in self._types:
            raise BagError(f"the definition of {name} is missing")
        if not self._types[name]:
            self.at += 1  # an empty struct travels as one byte
        for field in self._types[name]:
            self._field(field, f"{path}{field.name}")

    def _field(self, field: Field, path: str) -> None:
        if field.type == "wstring":
            raise BagError(f"field {field.name}: wstring is not supported")
        if field.type in NUMBERS:
            self._numbers(field, path)
        elif field.length is None:
            self._one(field, path)
        else:
            count = field.length or self._length()
            if count > len(self._data):  # each element takes a byte at least: do not loop over a corrupt length
                raise ValueError(f"a sequence of {count} elements runs over the end")
            for i in range(count):
                self._one(field, f"{path}[{i}]")

    def _one(self, field: Field, path: str) -> None:
        if field.type == "string":
            length = self._length()  # moves on, too
            self.at += length
        else:
            self.message(field.type, f"{path}.")

    def _numbers(self, field: Field, path: str) -> None:
        kind = np.dtype(self._order + NUMBERS[field.type])
        count = 1 if field.length is None else field.length or self._length()
        if count:
            self._align(kind.itemsize)
        self.fields[path] = (self.at, kind, -1 if field.length is None else count)
        self.at += count * kind.itemsize

    def _length(self) -> int:
        self._align(4)
        self.words.append(self.at)
        (length,) = self._word(self._data, self.at)
        self.at += 4
        return int(length)

    def _align(self, size: int) -> None:
        self.at += -(self.at - 4) % size


class Block:
    """Messages of one topic, decoded column by column.

    Args:
        messages: all of one topic.
        outlines: of its type.

    Attributes:
        log_time: [ns], shape (n,).
        last: bytes of the last message.
        bad: row and reason of each message that cannot be decoded; such rows are missing in every column.
    """

    def __init__(self, messages: Messages, outlines: Outliner) -> None:
        self._n = len(messages)
        self.log_time = messages.log_time
        self.last = messages.last
        self.bad: list[tuple[int, str]] = []
        self._groups = list(self._grouped(messages, outlines))

    def __len__(self) -> int:
        return self._n

    def column(self, path: str, kind: Any = np.float64, missing: Any = np.nan) -> NDArray[Any]:
        """A field with a single number, shape (n,); ``missing`` where a message has no such field."""
        out = np.full(self._n, missing, dtype=kind)
        for rows, matrix, outline in self._groups:
            at, dtype, count = outline.fields.get(path, (0, np.dtype(np.uint8), 0))
            if count == -1:
                out[rows] = _field(matrix, at, dtype, 1)[:, 0]
        return out

    def vectors(self, path: str) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
        """A field with many numbers: shape (n, widest), filled up with NaN, and the number of values, shape (n,)."""
        widths = np.zeros(self._n, dtype=np.intp)
        for rows, _, outline in self._groups:
            widths[rows] = max(outline.fields.get(path, (0, None, 0))[2], 0)
        out = np.full((self._n, widths.max(initial=0)), np.nan)
        for rows, matrix, outline in self._groups:
            at, dtype, count = outline.fields.get(path, (0, np.dtype(np.uint8), 0))
            if count > 0:
                out[rows, :count] = _field(matrix, at, dtype, count)
        return out, widths

    def _grouped(
        self, messages: Messages, outlines: Outliner
    ) -> Iterator[tuple[NDArray[np.intp], NDArray[np.uint8], Outline]]:
        """Messages of one outline together: their rows, their bytes (n, size), and the outline."""
        data = np.frombuffer(messages.data, np.uint8)
        for size in np.unique(messages.size).tolist():
            rows = np.flatnonzero(messages.size == size)
            matrix = data[messages.start[rows][:, None] + np.arange(size)]
            while len(rows):
                try:
                    outline = outlines(matrix[0])
                except BagError as error:
                    self.bad.append((int(rows[0]), str(error)))
                    rows, matrix = rows[1:], matrix[1:]
                    continue
                fits = outline.fits(matrix)
                yield rows[fits], matrix[fits], outline
                rows, matrix = rows[~fits], matrix[~fits]


def _field(matrix: NDArray[np.uint8], at: int, kind: np.dtype[Any], count: int) -> NDArray[Any]:
    return np.ascontiguousarray(matrix[:, at : at + count * kind.itemsize]).view(kind)
