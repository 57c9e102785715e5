# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Decodes CDR messages from the definition text that a bag carries: no ROS, no installed message package needed."""

import re
import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import groupby
from types import SimpleNamespace
from typing import Any

import numpy as np

from .errors import BagError, why
from .schema import NUMBERS, PRIMITIVES, SEPARATOR

_FIELD = re.compile(r"^([A-Za-z][\w/]*)(?:<=\d+)?(?:\[(<=)?(\d*)\])?\s+([A-Za-z]\w*)", re.ASCII)
_CONSTANT = re.compile(r"^[A-Za-z][\w/]*(?:<=\d+)?\s+[A-Z][A-Z0-9_]*\s*=", re.ASCII)

_Read = Callable[[memoryview, int], tuple[Any, int]]


@dataclass(frozen=True, slots=True)
class Field:
    """One field of a message: ``length`` None = single value, 0 = sequence, n = array of n."""

    name: str
    type: str
    length: int | None


def parse_definition(name: str, text: str) -> dict[str, tuple[Field, ...]]:
    """Fields of a type and of its dependencies, by ``package/Type``, from concatenated ros2msg text.

    Raises:
        BagError: if a line is not a field, constant or comment.
    """
    package, *_, kind = name.split("/")
    types = {}
    current = f"{package}/{kind}"
    for part in re.split(rf"^{SEPARATOR}\s*$", text, flags=re.MULTILINE):
        lines = part.strip("\n").splitlines()
        if lines and lines[0].startswith("MSG: "):
            head = lines.pop(0)[5:].strip().split("/")
            current = f"{head[0]}/{head[-1]}"
        types[current] = tuple(_fields(current, lines))
    return types


def _fields(owner: str, lines: list[str]) -> list[Field]:
    fields = []
    for line in lines:
        code = line.partition("#")[0].strip()
        if not code or _CONSTANT.match(code):
            continue
        match = _FIELD.match(code)
        if not match:
            raise BagError(f"definition of {owner}: cannot read the line {code!r}")
        base, bounded, size, field = match.groups()
        if base not in PRIMITIVES:
            parts = base.split("/") if "/" in base else [owner.split("/")[0], base]
            base = f"{parts[0]}/{parts[-1]}"
        length = None if size is None else int(size) if size and not bounded else 0
        fields.append(Field(field, base, length))
    return fields


class Decoder:
    """Turns the CDR bytes of one message type into namespaces with the message's fields.

    Numbers become Python numbers, number arrays numpy arrays, nested messages namespaces.

    Args:
        name: type name, e.g. ``deepc_msgs/msg/Sample``.
        text: its concatenated ros2msg definition.

    Raises:
        BagError: if the definition cannot be read.
    """

    def __init__(self, name: str, text: str) -> None:
        self.name = name
        types = parse_definition(name, text)
        package, *_, kind = name.split("/")
        self._readers = {order: _message(f"{package}/{kind}", types, order, {}) for order in "<>"}

    def __call__(self, data: bytes) -> Any:
        """Decodes one message.

        Raises:
            BagError: if the bytes do not fit the type.
        """
        return self._read(data)[0]

    def size(self, data: bytes) -> int:
        """Bytes that the message at the start of ``data`` takes, its 4-byte header included."""
        return 4 + self._read(data)[1]

    def _read(self, data: bytes) -> tuple[Any, int]:
        try:
            return self._readers["<" if data[1] & 1 else ">"](memoryview(data)[4:], 0)
        except (struct.error, IndexError, ValueError) as error:
            raise BagError(f"{len(data)} bytes are no {self.name}: {why(error)}") from error


@lru_cache(maxsize=256)
def decoder(name: str, text: str) -> Decoder:
    """The one decoder of a type, see ``Decoder``."""
    return Decoder(name, text)


def _message(name: str, types: Mapping[str, tuple[Field, ...]], order: str, done: dict[str, _Read]) -> _Read:
    if name in done:
        return done[name]
    if name not in types:
        raise BagError(f"the definition of {name} is missing")
    parts = [
        (
            tuple(f.name for f in run),
            _group([f.type for f in run], order) if plain else _field(run[0], types, order, done),
        )
        for plain, run in _runs(types[name])
    ]
    if not parts:  # an empty struct travels as one byte
        parts = [(("structure_needs_at_least_one_member",), _group(["uint8"], order))]

    def read(data: memoryview, at: int) -> tuple[Any, int]:
        values: dict[str, Any] = {}
        for names, reader in parts:
            value, at = reader(data, at)
            if isinstance(value, tuple):
                values.update(zip(names, value, strict=True))
            else:
                values[names[0]] = value
        return SimpleNamespace(**values), at

    done[name] = read
    return read


def _runs(fields: tuple[Field, ...]) -> Iterator[tuple[bool, list[Field]]]:
    """Fields in order, neighbouring single numbers together: (True, numbers) or (False, [one other field])."""
    for plain, run in groupby(fields, key=lambda f: f.type in NUMBERS and f.length is None):
        if plain:
            yield True, list(run)
        else:
            yield from ((False, [field]) for field in run)


def _group(kinds: list[str], order: str) -> _Read:
    """Reads neighbouring numbers with one call: one format, its padding written out, for each place it may start at."""
    formats = []
    for start in range(8):
        code, at = order, start
        for kind in kinds:
            size = struct.calcsize(order + NUMBERS[kind])
            padding = -at % size
            code += "x" * padding + NUMBERS[kind]
            at += padding + size
        formats.append((struct.Struct(code).unpack_from, at - start))

    def read(data: memoryview, at: int) -> tuple[Any, int]:
        unpack, size = formats[at & 7]
        return unpack(data, at), at + size

    return read


def _field(field: Field, types: Mapping[str, tuple[Field, ...]], order: str, done: dict[str, _Read]) -> _Read:
    if field.type == "wstring":
        raise BagError(f"field {field.name}: wstring is not supported")
    if field.type in NUMBERS and field.length is not None:
        return _numbers(field.type, field.length, order)
    single = _string(order) if field.type == "string" else _message(field.type, types, order, done)
    return single if field.length is None else _sequence(single, field.length, order)


def _number(kind: str, order: str) -> _Read:
    number = struct.Struct(order + NUMBERS[kind])
    unpack, size = number.unpack_from, number.size
    mask = size - 1

    def read(data: memoryview, at: int) -> tuple[Any, int]:
        at = (at + mask) & ~mask
        return unpack(data, at)[0], at + size

    return read


def _numbers(kind: str, length: int, order: str) -> _Read:
    dtype = np.dtype(order + NUMBERS[kind])
    native, size = dtype.newbyteorder("="), dtype.itemsize
    count = _number("uint32", order)
    mask = size - 1

    def read(data: memoryview, at: int) -> tuple[Any, int]:
        n = length
        if not length:
            n, at = count(data, at)
        if not n:
            return np.empty(0, native), at
        at = (at + mask) & ~mask
        return np.frombuffer(data, dtype, n, at).astype(native), at + n * size

    return read


def _string(order: str) -> _Read:
    count = _number("uint32", order)

    def read(data: memoryview, at: int) -> tuple[str, int]:
        n, at = count(data, at)
        if at + n > len(data):
            raise ValueError(f"a string of {n} bytes runs over the end")
        return bytes(data[at : at + n]).rstrip(b"\0").decode("utf-8", "replace"), at + n

    return read


def _sequence(single: _Read, length: int, order: str) -> _Read:
    count = _number("uint32", order)

    def read(data: memoryview, at: int) -> tuple[list[Any], int]:
        n = length
        if not length:
            n, at = count(data, at)
        if n > len(data):  # each element takes a byte at least: do not loop over a corrupt length
            raise ValueError(f"a sequence of {n} elements runs over the end")
        values = []
        for _ in range(n):
            value, at = single(data, at)
            values.append(value)
        return values, at

    return read
