# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Recorded inputs and outputs from wherever they are: bags of this stack, bags of others, tables."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .errors import BagError
from .mapping import load_signals
from .progress import Progress, no_progress
from .reader import BagReader
from .recording import find_namespace, load_run
from .table import TABLES, Table

Array = NDArray[np.float64]
_OFF = 0.5  # share of the period by which a time step may differ before it is a gap


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Recorded:
    """What was recorded of one plant.

    Attributes:
        records: unbroken stretches in order, pairs (u, y) of shapes (K or more, m) and (K, p).
        inputs: names.
        outputs: names.
        sample_time: [s]; NaN if unknown.
        plant: its name; empty if unknown.
        n, q, s: the prior that the plant gave; 0 = not given.
        D: feed-through that the plant gave, shape (p, m); None if it gave none.
    """

    records: tuple[tuple[Array, Array], ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    sample_time: float = np.nan
    plant: str = ""
    n: int = 0
    q: int = 0
    s: int = 0
    D: Array | None = None

    @property
    def samples(self) -> int:
        """Outputs in all records."""
        return sum(len(y) for _, y in self.records)

    @property
    def longest(self) -> tuple[Array, Array]:
        """The longest unbroken stretch."""
        return max(self.records, key=lambda record: len(record[1]))


def load_records(
    path: str | os.PathLike[str],
    inputs: Sequence[str] = (),
    outputs: Sequence[str] = (),
    *,
    time: str = "",
    namespace: str | None = None,
    progress: Progress = no_progress,
) -> Recorded:
    """Reads inputs and outputs; a gap starts a new record.

    Args:
        path: a bag of this stack; any other bag, with its channels named; or a table (.csv, .tsv, .txt, .parquet).
        inputs: channels of u: "/topic:field" in a bag, column names in a table. None are needed for our own bags.
        outputs: channels of y, likewise.
        time: for tables, the column that tells the time: steps that differ from the others are gaps. Without it, rows
            are taken to be regular, but for jumps of a column "k" or "epoch".
        namespace: of the plant, if a bag holds several.
        progress: called now and then with messages done and in all.

    Raises:
        BagError: if something is not there, or no row is complete.
    """
    table = Path(path).suffix.lower() in TABLES
    if bool(inputs) != bool(outputs) or (table and not inputs):
        have = f": {path} has the columns {', '.join(Table(path).names)}" if table else ""
        raise BagError(f"give at least one input and one output channel{have}")
    if table:
        found = _from_table(Table(path), tuple(inputs), tuple(outputs), time)
    elif inputs:
        signals = load_signals(path, inputs, outputs)
        whole = np.isfinite(np.hstack([signals.u, signals.y])).all(axis=1)
        found = Recorded(
            records=_unbroken(signals.u, signals.y, whole, np.ones(len(whole), dtype=bool)),
            inputs=tuple(inputs),
            outputs=tuple(outputs),
            sample_time=signals.sample_time,
        )
    else:
        found = _from_run(path, namespace, progress)
    if not found.records:
        raise BagError(f"{path} has no sample with all inputs and outputs")
    return found


def _from_run(path: str | os.PathLike[str], namespace: str | None, progress: Progress) -> Recorded:
    reader = BagReader(path)
    run = load_run(reader, namespace, progress=progress)
    topic = f"{find_namespace(reader, namespace)}/plant_info"
    info = next((message for _, message in reader.decoded([topic])), None)
    m, p = run.u.shape[1], run.y.shape[1]
    known = info is not None and bool(getattr(info, "d_known", False))
    follows = np.append(True, (np.diff(run.k) == 1) & (np.diff(run.epoch) == 0))
    whole = np.isfinite(run.u).all(axis=1) & np.isfinite(run.y).all(axis=1)
    records = _unbroken(run.u, run.y, whole, follows)
    if records and whole[-1]:  # with index s >= 2 the last outputs need inputs given for later
        u, y = records[-1]
        records = (*records[:-1], (np.vstack([u, run.u_ahead]), y))
    return Recorded(
        records=records,
        inputs=run.input_names,
        outputs=run.output_names,
        sample_time=run.sample_time,
        plant=" ".join(filter(None, (run.plant, run.variant))),
        n=int(run.prior["n"]),
        q=int(run.prior["q"]),
        s=int(run.prior["s"]),
        D=np.reshape(np.asarray(info.d, dtype=np.float64), (p, m)) if known and info is not None else None,
    )


def _from_table(table: Table, inputs: tuple[str, ...], outputs: tuple[str, ...], time: str) -> Recorded:
    u, y = (np.stack([table.numbers(name) for name in names], axis=1) for names in (inputs, outputs))
    follows = np.ones(len(u), dtype=bool)
    period = np.nan
    if time:
        steps = np.diff(table.seconds(time))
        period = float(np.median(steps)) if len(steps) else np.nan
        if len(steps) and not period > 0:
            raise BagError(f"{table.path}: the times in {time!r} do not grow")
        follows[1:] &= np.abs(steps - period) <= _OFF * period
    for name, step in (("k", 1), ("epoch", 0)):
        if name in table.names and name not in (*inputs, *outputs):
            follows[1:] &= np.diff(table.numbers(name)) == step
    whole = np.isfinite(u).all(axis=1) & np.isfinite(y).all(axis=1)
    return Recorded(records=_unbroken(u, y, whole, follows), inputs=inputs, outputs=outputs, sample_time=period)


def _unbroken(
    u: Array, y: Array, whole: NDArray[np.bool_], follows: NDArray[np.bool_]
) -> tuple[tuple[Array, Array], ...]:
    """Stretches of complete rows of which each follows the one before."""
    breaks = ~follows[1:] | ~whole[1:] | ~whole[:-1]
    parts = np.split(np.arange(len(whole)), np.flatnonzero(breaks) + 1)
    return tuple((u[rows], y[rows]) for rows in parts if len(rows) and whole[rows[0]])
