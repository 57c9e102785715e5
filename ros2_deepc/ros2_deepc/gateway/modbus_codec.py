# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Numbers in Modbus registers: types, word orders, blocks."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import LinkError

Registers = Sequence[int] | NDArray[np.integer[Any]]

TYPES: dict[str, np.dtype[Any]] = {
    "int16": np.dtype(">i2"),
    "uint16": np.dtype(">u2"),
    "int32": np.dtype(">i4"),
    "uint32": np.dtype(">u4"),
    "float32": np.dtype(">f4"),
    "float64": np.dtype(">f8"),
}
WORD_ORDERS = ("ABCD", "CDAB", "BADC", "DCBA")
LARGEST_READ, LARGEST_WRITE = 125, 123  # registers in one request, Modbus Application Protocol V1.1b3, 6.3 and 6.12


def size(kind: str) -> int:
    """Registers that one number of a type takes."""
    return TYPES[kind].itemsize // 2


def whole(kind: str) -> bool:
    """Whether a type holds whole numbers only."""
    return bool(TYPES[kind].kind in "iu")


def bounds(kind: str) -> tuple[float, float]:
    """Smallest and largest number of a type."""
    dtype = TYPES[kind]
    if whole(kind):
        integers = np.iinfo(dtype)
        return float(integers.min), float(integers.max)
    return float(np.finfo(dtype).min), float(np.finfo(dtype).max)


def _as_sent(words: NDArray[np.uint16], order: str) -> NDArray[np.uint16]:
    """Words ABCD.. to another order, or back: every order is its own inverse. Shape (count, words each)."""
    if order in ("CDAB", "DCBA"):
        words = words[:, ::-1]
    if order in ("BADC", "DCBA"):
        words = words.byteswap()
    return words


def decode(registers: Registers, kind: str, order: str = "ABCD") -> NDArray[np.float64]:
    """Numbers from registers, one after the other.

    Args:
        registers: shape (count * size(kind),), each 0 to 65535.
        kind: one of TYPES.
        order: one of WORD_ORDERS.

    Returns:
        Shape (count,). Whatever bits came: NaN and infinities too.

    Raises:
        LinkError: if the registers are not that many, or not registers.
    """
    given = np.asarray(registers)
    each = size(kind)
    if given.ndim != 1 or len(given) % each or (given.size and not np.issubdtype(given.dtype, np.integer)):
        raise LinkError(f"{given.size} registers do not make {kind} numbers of {each} registers")
    if given.size and (given.min() < 0 or given.max() > 0xFFFF):
        raise LinkError("a register is outside 0 to 65535")
    words = np.ascontiguousarray(_as_sent(given.astype(np.uint16).reshape(-1, each), order))
    numbers = words.astype(">u2").view(TYPES[kind])[:, 0]
    with np.errstate(invalid="ignore"):  # a signalling NaN is a NaN
        return numbers.astype(np.float64)


def encode(values: Iterable[float], kind: str, order: str = "ABCD") -> list[int]:
    """Registers of numbers; whole types round to the nearest, the others have NaN and infinities, too.

    Raises:
        ValueError: for a number that the type cannot hold.
    """
    given = np.asarray(list(values), dtype=np.float64)
    low, high = bounds(kind)
    rounded = np.rint(given) if whole(kind) else given
    fits = (rounded >= low) & (rounded <= high)
    if not whole(kind):
        fits |= ~np.isfinite(rounded)
    if not fits.all():
        raise ValueError(f"{given[~fits][0]} does not fit {kind}")
    words = rounded.astype(TYPES[kind]).view(">u2").astype(np.uint16).reshape(len(given), -1)
    return [int(word) for word in _as_sent(words, order).ravel()]


def held(value: float, kind: str) -> float:
    """What a register of this type makes of a number."""
    return float(np.rint(value)) if whole(kind) else float(TYPES[kind].type(value))


@dataclass(frozen=True, slots=True)
class Block:
    """A run of registers that one request reads or writes.

    Attributes:
        table: "holding" or "input".
        unit_id: device behind the address.
        address: first register.
        count: registers.
    """

    table: str
    unit_id: int
    address: int
    count: int

    def covers(self, other: "Block") -> bool:
        """Whether all registers of another block are in this one."""
        same = (self.table, self.unit_id) == (other.table, other.unit_id)
        return same and self.address <= other.address and other.address + other.count <= self.address + self.count


def blocks(spans: Iterable[Block], largest: int, *, bridge: int = 0) -> list[Block]:
    """The fewest requests, in order of address, that cover all spans; no span is torn.

    Args:
        spans: one for each tag.
        largest: registers allowed in one request.
        bridge: registers between two spans that may be carried along; 0 for writes, where they would be changed.
    """
    found: list[Block] = []
    for span in sorted(spans, key=lambda s: (s.table, s.unit_id, s.address, s.count)):
        last = found[-1] if found else None
        if last is not None and (last.table, last.unit_id) == (span.table, span.unit_id):
            end = max(last.address + last.count, span.address + span.count)
            if span.address <= last.address + last.count + bridge and end - last.address <= largest:
                found[-1] = Block(last.table, last.unit_id, last.address, end - last.address)
                continue
        found.append(span)
    return found
