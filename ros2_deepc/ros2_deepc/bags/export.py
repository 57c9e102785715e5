# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""A run as a table: CSV, Parquet, or a picture."""

import csv
import os
from importlib import import_module
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .errors import BagError, why
from .run import MODES, NO_MODE, PROPERTIES, VERDICTS, Run


def columns(run: Run) -> dict[str, list[object] | NDArray[np.generic]]:
    """The run column by column, each of length K: epoch, k, t, outputs, references, inputs, mode, solve time, verdicts.

    Names carry the unit: "x1 [rad/s]". A verdict is the last one reported up to the sample; empty before the first.
    """
    table: dict[str, list[object] | NDArray[np.generic]] = {"epoch": run.epoch, "k": run.k, "t [s]": run.t}
    for i, (name, unit) in enumerate(zip(run.output_names, run.output_units, strict=True)):
        table[_titled(name, unit)] = run.y[:, i]
        table[_titled(f"{name} reference", unit)] = run.ref[:, i]
    for i, (name, unit) in enumerate(zip(run.input_names, run.input_units, strict=True)):
        table[_titled(name if _titled(name, unit) not in table else f"{name} input", unit)] = run.u[:, i]
    table["mode"] = [MODES[m] if m != NO_MODE else "" for m in run.mode]
    table["solve_time [s]"] = run.solve_time
    last = np.searchsorted(run.reports.t, run.t, side="right") - 1
    for j, name in enumerate(PROPERTIES):
        table[name] = [VERDICTS[run.reports.verdict[row, j]] if row >= 0 else "" for row in last]
    return table


def export(run: Run, path: str | os.PathLike[str]) -> None:
    """Writes a run as a table or picture.

    Args:
        run: the run.
        path: its ending says the format: .csv (floats that read back to the same bits), .parquet (needs pyarrow), .png,
            .svg or .pdf.

    Raises:
        BagError: for another ending, a missing pyarrow, or a file that cannot be written.
    """
    ending = Path(path).suffix.lower()
    try:
        if ending == ".csv":
            _csv(run, Path(path))
        elif ending == ".parquet":
            _parquet(run, Path(path))
        elif ending in (".png", ".svg", ".pdf"):
            from .figure import draw

            draw(run, path)
        else:
            raise BagError(
                f"cannot export to {Path(path).name}: the name must end in .csv, .parquet, .png, .svg or .pdf"
            )
    except OSError as error:
        raise error if isinstance(error, BagError) else BagError(f"cannot write {path}: {why(error)}") from error


def _csv(run: Run, path: Path) -> None:
    table = columns(run)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(table)
        for row in zip(*(_plain(column) for column in table.values()), strict=True):
            writer.writerow(row)


def _plain(column: list[object] | NDArray[np.generic]) -> list[object]:
    """Python values, empty for NaN; repr of a float reads back to the same bits."""
    values = column.tolist() if isinstance(column, np.ndarray) else column
    return ["" if isinstance(v, float) and v != v else v for v in values]


def _parquet(run: Run, path: Path) -> None:
    try:
        pa, pq = import_module("pyarrow"), import_module("pyarrow.parquet")
    except ImportError:
        raise BagError("Parquet needs pyarrow: pip install pyarrow") from None
    facts = {
        "plant": run.plant,
        "variant": run.variant,
        "sample_time": repr(run.sample_time),
        "loop_hash": run.loop_hash,
    }
    table = pa.table(columns(run))
    pq.write_table(table.replace_schema_metadata({**facts, **run.metadata}), path)


def _titled(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name
