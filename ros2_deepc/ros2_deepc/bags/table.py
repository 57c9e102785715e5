# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Tables that anyone may have: CSV and Parquet, read column by column."""

import csv
import os
from collections.abc import Sequence
from datetime import datetime
from importlib import import_module
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .errors import BagError, why

Array = NDArray[np.float64]
TABLES = (".csv", ".tsv", ".txt", ".parquet")
_DELIMITERS = ",;\t|"
_SNIFFED = 1 << 16  # bytes looked at to tell how a file is separated
_MISSING = {"", "nan", "null", "none", "na", "n/a"}


class Table:
    """A table with named columns.

    Args:
        path: .csv, .tsv or .txt (separator and decimal mark are found out; without a header, columns are called "1",
            "2", ...; lines that start with # are skipped), or .parquet (needs pyarrow).

    Raises:
        BagError: if the file cannot be read or has no rows.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        try:
            self._cells = _parquet(self.path) if self.path.suffix.lower() == ".parquet" else _text(self.path)
        except (OSError, ValueError, csv.Error) as error:
            raise error if isinstance(error, BagError) else BagError(f"cannot read {path}: {why(error)}") from error
        if not self._cells or not len(next(iter(self._cells.values()))):
            raise BagError(f"{path} has no rows")

    @property
    def names(self) -> tuple[str, ...]:
        """The columns, in order."""
        return tuple(self._cells)

    def find(self, name: str) -> str:
        """The column of that name, which may lack its unit: "x1" finds "x1 [rad/s]".

        Raises:
            BagError: if there is none; the message lists what there is.
        """
        if name in self._cells:
            return name
        bare = [each for each in self._cells if each.split(" [")[0] == name]
        if len(bare) == 1:
            return bare[0]
        raise BagError(f"{self.path} has no column {name!r}; it has {', '.join(self._cells)}")

    def numbers(self, name: str) -> Array:
        """A column, shape (rows,); empty cells are NaN.

        Raises:
            BagError: if a cell is not a number; the message names its row.
        """
        cells = self._cells[self.find(name)]
        out = np.empty(len(cells))
        for i, cell in enumerate(cells):
            try:
                out[i] = _number(cell)
            except ValueError:
                raise BagError(f"{self.path}, row {i + 1} of column {name!r}: {cell!r} is no number") from None
        return out

    def seconds(self, name: str) -> Array:
        """A column of times, numbers [s] or ISO 8601, as seconds, shape (rows,).

        Raises:
            BagError: if a cell is neither.
        """
        cells = self._cells[self.find(name)]
        try:
            return np.array([_number(cell) for cell in cells])
        except ValueError:
            pass
        try:
            return np.array([datetime.fromisoformat(str(cell)).timestamp() for cell in cells])
        except ValueError as error:
            raise BagError(f"{self.path}, column {name!r}: neither seconds nor ISO 8601 times ({error})") from None


def _text(path: Path) -> dict[str, Sequence[object]]:
    """Columns of a text file by name."""
    lines = [line for line in path.read_text(encoding="utf-8-sig").splitlines() if line.strip() and line[0] != "#"]
    if not lines:
        return {}
    try:
        delimiter = csv.Sniffer().sniff("\n".join(lines)[:_SNIFFED], _DELIMITERS).delimiter
    except csv.Error:
        delimiter = "," if "," in lines[0] else "\t"  # a single column has no separator
    rows = list(csv.reader(lines, delimiter=delimiter, skipinitialspace=True))
    head = [cell.strip() for cell in rows[0]]
    if all(_is_number(cell) for cell in head):
        head = [str(i + 1) for i in range(len(head))]
    else:
        rows = rows[1:]
    if len(set(head)) < len(head):
        twice = next(name for name in head if head.count(name) > 1)
        raise BagError(f"{path} has two columns called {twice!r}: rename one")
    for i, row in enumerate(rows):
        if len(row) != len(head):
            raise BagError(f"{path}, row {i + 1}: {len(row)} cells, the table has {len(head)} columns")
    return dict(zip(head, zip(*rows, strict=True), strict=True)) if rows else {}


def _parquet(path: Path) -> dict[str, Sequence[object]]:
    try:
        parquet = import_module("pyarrow.parquet")
    except ImportError:
        raise BagError("Parquet needs pyarrow: pip install pyarrow") from None
    table = parquet.read_table(path)
    return {name: table.column(name).to_pylist() for name in table.column_names}


def _number(cell: object) -> float:
    """A cell as a number, NaN where it is empty; a decimal comma is understood."""
    if isinstance(cell, str):
        text = cell.strip()
        return np.nan if text.lower() in _MISSING else float(text.replace(",", ".") if text.count(",") == 1 else text)
    if cell is None:
        return np.nan
    if isinstance(cell, (int, float)):
        return float(cell)
    raise ValueError(f"{cell!r} is no number")


def _is_number(cell: str) -> bool:
    try:
        _number(cell)
    except ValueError:
        return False
    return bool(cell)
