# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""A run as a table (CSV, Parquet), a picture, or its numbers (JSON)."""

import csv
import json
import os
from collections.abc import Iterator
from contextlib import ExitStack
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .errors import BagError, why, write_text
from .figure import draw
from .progress import Progress, no_progress
from .recording import Recording
from .run import MODES, NO_MODE, PROPERTIES, VERDICTS, Run
from .summary import Summary
from .trends import Trends

Column = list[str] | NDArray[np.generic]
_PICTURES = (".png", ".svg", ".pdf")
_FORMATS = (".csv", ".parquet", *_PICTURES, ".json")


def columns(run: Run | Recording) -> Iterator[dict[str, Column]]:
    """The run by columns, stretch by stretch: epoch, k, t, outputs, references, inputs, mode, solve time, verdicts.

    Names carry the unit: "x1 [rad/s]". A verdict is the last one reported up to the sample; empty before the first.
    """
    said = [""] * len(PROPERTIES)  # at the end of the stretch before
    for stretch in run.stretches():
        table, reports = _samples(stretch), stretch.reports
        last = np.searchsorted(reports.row, stretch.first + np.arange(len(stretch)), side="right")
        for j, name in enumerate(PROPERTIES):
            words = [said[j], *(VERDICTS[verdict] for verdict in reports.verdict[:, j])]
            said[j], table[name] = words[-1], [words[row] for row in last]
        yield table


def _samples(run: Run) -> dict[str, Column]:
    table: dict[str, Column] = {"epoch": run.epoch, "k": run.k, "t [s]": run.t}
    for i, (name, unit) in enumerate(zip(run.output_names, run.output_units, strict=True)):
        table[_titled(name, unit)] = run.y[:, i]
        table[_titled(f"{name} reference", unit)] = run.ref[:, i]
    for i, (name, unit) in enumerate(zip(run.input_names, run.input_units, strict=True)):
        table[_titled(name if _titled(name, unit) not in table else f"{name} input", unit)] = run.u[:, i]
    table["mode"] = [MODES[m] if m != NO_MODE else "" for m in run.mode]
    table["solve_time [s]"] = run.solve_time
    return table


def export(run: Run | Recording, path: str | os.PathLike[str], *, progress: Progress = no_progress) -> None:
    """Writes a run as a table, a picture, or its summary; for a ``Recording``, memory does not grow with its length.

    Args:
        run: the run.
        path: its ending says the format: .csv (floats that read back to the same bits), .parquet (needs pyarrow), .png,
            .svg or .pdf, .json.
        progress: called now and then with samples done and in all.

    Raises:
        BagError: for another ending, a missing pyarrow, or a file that cannot be written.
    """
    ending = check_format(path)
    try:
        if ending == ".csv":
            _csv(run, Path(path), progress)
        elif ending == ".parquet":
            _parquet(run, Path(path), progress)
        elif ending in _PICTURES:
            draw(Trends.of(run, progress), path)
        else:
            write_text(path, json.dumps(_summed(run, progress), indent=2) + "\n")
    except OSError as error:
        raise error if isinstance(error, BagError) else BagError(f"cannot write {path}: {why(error)}") from error


def check_format(path: str | os.PathLike[str]) -> str:
    """The ending of a file's name, if it says a format that can be written; Parquet only where pyarrow is.

    Raises:
        BagError: see ``export``.
    """
    ending = Path(path).suffix.lower()
    if ending not in _FORMATS:
        known = f"{', '.join(_FORMATS[:-1])} or {_FORMATS[-1]}"
        raise BagError(f"cannot export to {Path(path).name}: the name must end in {known}")
    if ending == ".parquet" and not find_spec("pyarrow"):
        raise BagError("Parquet needs pyarrow: pip install pyarrow")
    return ending


def _csv(run: Run | Recording, path: Path, progress: Progress) -> None:
    done = 0
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        for table in columns(run):
            if not done:
                writer.writerow(table)
            writer.writerows(zip(*(_plain(column) for column in table.values()), strict=True))
            done += len(table["k"])
            progress(done, len(run))


def _plain(column: Column) -> list[object]:
    """Python values, empty for NaN; repr of a float reads back to the same bits."""
    values = column.tolist() if isinstance(column, np.ndarray) else column
    return ["" if isinstance(v, float) and v != v else v for v in values]


def _parquet(run: Run | Recording, path: Path, progress: Progress) -> None:
    pa, pq = import_module("pyarrow"), import_module("pyarrow.parquet")
    first = next(iter(run.stretches()))
    facts = {"plant": first.plant, "variant": first.variant, "sample_time": repr(first.sample_time)}
    facts |= {"loop_hash": str(_summed(run, no_progress)["loop_hash"]), **first.metadata}
    done, file = 0, None
    with ExitStack() as opened:
        for table in columns(run):
            block = pa.table(table).replace_schema_metadata(facts)
            file = file or opened.enter_context(pq.ParquetWriter(path, block.schema))
            file.write_table(block)
            done += len(block)
            progress(done, len(run))


def _summed(run: Run | Recording, progress: Progress) -> dict[str, object]:
    summary = Summary()
    for stretch in run.stretches():
        summary.add(stretch)
        progress(stretch.first + len(stretch), len(run))
    return summary.result()


def _titled(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name
