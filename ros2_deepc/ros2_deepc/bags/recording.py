# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Reads one plant's run out of a bag, at once or in stretches, however long it is.

A recorder sees topics in an order of its own, so that what belongs to one sample may lie far apart in the bag. The bag
is therefore read once, its numbers go to a temporary file, and samples are put together from there.
"""

import os
from collections.abc import Iterator
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from .columns import K_BITS, NO_KEY, Columns, Found, Keys
from .errors import BagError
from .progress import Progress, no_progress
from .reader import BagReader
from .run import NO_MODE, PROPERTIES, REPORT_FIELDS, STATE_FIELDS, Array, Reports, Run
from .spill import Spill
from .writer import RUN_METADATA

SAMPLES = 8192  # of a stretch, or fewer where there are many channels
_VERDICT_NUMBERS = ("verdict", "lambda_star_re", "lambda_star_im", "margin")
_VERDICT_FIELDS = tuple(f"{p}.{number}" for p in PROPERTIES for number in _VERDICT_NUMBERS)


class Recording:
    """One plant's run in a bag. Close it: it keeps a temporary file, of some 300 bytes a sample.

    Args:
        bag: folder, file or open reader.
        namespace: of the plant, e.g. "/grid"; default: the only one in the bag.
        progress: called now and then with messages done and in all.

    Attributes:
        total: number of samples.

    Raises:
        BagError: if there are no outputs, several plants and no namespace, a sample of another size than the rest, or
            no room for the temporary file.
    """

    def __init__(
        self,
        bag: str | os.PathLike[str] | BagReader,
        namespace: str | None = None,
        *,
        progress: Progress = no_progress,
    ) -> None:
        reader = bag if isinstance(bag, BagReader) else BagReader(bag)
        prefix = find_namespace(reader, namespace)
        self._spill = Spill()
        try:
            self._read(reader, prefix, progress)
            if not self._outputs.count:
                raise BagError(f"bag {reader.path} has no message on {prefix}/outputs")
            self._survey()
        except BaseException:
            self.close()
            raise
        self._metadata = reader.metadata.get(RUN_METADATA, {})

    def __len__(self) -> int:
        return self.total

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Removes the temporary file."""
        self._spill.close()

    def stretches(self, samples: int = 0) -> Iterator[Run]:
        """Yields the run in stretches, the last one of what is left; may be asked for repeatedly.

        Args:
            samples: of a stretch; 0 = as many as fit in a few megabytes.

        Raises:
            BagError: if the temporary file cannot be read.
        """
        about = self._about()
        samples = samples or max(min(SAMPLES, 400_000 // max(self._outputs.width + self._inputs.width, 1)), 1)
        first, reported, after, asked = 0, 0, 0, np.full(self._outputs.width, np.nan)
        for keys, following in self._outputs.stretches(samples):
            references = self._references.within(after, following)
            reports = self._reports.within(after, following)
            samples_part = self._samples(keys, first, references, asked)
            yield Run(
                **about,
                **samples_part,
                first=first,
                reports=self._said(reports, keys, samples_part["t"], first, reported),
            )
            first, reported, after = first + len(keys), reported + len(reports.keys), following
            if len(references.keys) and self._references.width == len(asked):
                asked = references.vectors()[-1]

    def _read(self, reader: BagReader, prefix: str, progress: Progress) -> None:
        self._outputs = Columns(self._spill, ("held",), "values")
        self._inputs = Columns(self._spill, (), "values")
        self._references = Columns(self._spill, (), "values")
        self._states = Columns(self._spill, STATE_FIELDS, "reference")
        self._reports = Columns(self._spill, (*REPORT_FIELDS, *_VERDICT_FIELDS))
        tables = {
            f"{prefix}/outputs": self._outputs,
            f"{prefix}/inputs": self._inputs,
            f"{prefix}/reference": self._references,
            f"{prefix}/controller/state": self._states,
            f"{prefix}/monitor/report": self._reports,
        }
        done, last = 0, b""
        for topic, block in reader.blocks(tables):
            tables[topic].add(block)
            last = block.last if tables[topic] is self._reports else last
            done += len(block)
            progress(done, reader.message_count)
        said = reader.topics[f"{prefix}/monitor/report"].decoder()(last) if last else None
        self._reason = tuple(getattr(said, p).reason if said else "" for p in PROPERTIES)
        self._info = next((message for _, message in reader.decoded([f"{prefix}/plant_info"])), None)

    def _survey(self) -> None:
        """What must be known of all samples before the first one can be put together."""
        epochs = self._outputs.epochs()
        for table in (self._outputs, self._inputs, self._references, self._states, self._reports):
            table.rank(epochs)
        self._epochs = np.array(epochs, dtype=np.int64)
        self.total, self._start, self._by_stamps = 0, 0, True
        last = key = 0
        for keys, _ in self._outputs.stretches(SAMPLES):
            stamp = self._outputs.find(keys).stamps()
            self._start = self._start if self.total else int(stamp[0])
            grown = np.diff(stamp, prepend=last if self.total else stamp[0] - 1) > 0
            self._by_stamps = self._by_stamps and bool(grown.all())
            self.total, last, key = self.total + len(keys), int(stamp[-1]), int(keys[-1])
        given = sum(len(keys) for keys, _ in self._inputs.stretches(SAMPLES))
        self._duplicates = self._outputs.count - self.total + self._inputs.count - given
        ahead = self._inputs.find(key + 1 + np.arange(SAMPLES))
        self._ahead = ahead.vectors()[np.cumprod(ahead.known).astype(bool)]

    def _about(self) -> dict[str, Any]:
        """What is said of the run as a whole."""
        info, p, m = self._info, self._outputs.width, self._inputs.width
        return {
            "plant": getattr(info, "name", ""),
            "variant": getattr(info, "variant", ""),
            "sample_time": float(getattr(info, "sample_time", np.nan)),
            "input_names": _names(info, "input_names", "u", m),
            "input_units": _names(info, "input_units", "", m),
            "output_names": _names(info, "output_names", "y", p),
            "output_units": _names(info, "output_units", "", p),
            "input_min": _limits(info, "input_min", m),
            "input_max": _limits(info, "input_max", m),
            "prior": {name: getattr(info, name, 0) for name in ("n", "q", "r", "s")},
            "total": self.total,
            "epochs": len(self._epochs),
            "u_ahead": self._ahead,
            "duplicates": self._duplicates,
            "metadata": self._metadata,
        }

    def _samples(self, keys: Keys, first: int, references: Found, asked: Array) -> dict[str, Any]:
        """The samples with these keys, of which there are ``first`` before them."""
        outputs, state = self._outputs.find(keys), self._states.find(keys)
        y, k = outputs.vectors(), keys & ((1 << K_BITS) - 1)
        used = state.vectors() if self._states.width == y.shape[1] else np.full_like(y, np.nan)
        mode = state.column("mode")
        return {
            "epoch": self._epochs[keys >> K_BITS],
            "k": k,
            "t": self._time(outputs.stamps(), first + np.arange(len(keys))),
            "y": y,
            "u": self._acted(keys, k),
            "ref": _asked_for(used, keys, references, asked),
            "mode": np.where(np.isnan(mode), NO_MODE, mode).astype(np.uint8),
            "solve_time": np.where(state.column("status") > 0, state.column("solve_time"), np.nan),
            "state": {name: state.column(name) for name in STATE_FIELDS},
        }

    def _acted(self, keys: Keys, k: NDArray[np.int64]) -> Array:
        """The commands in force at k: outputs k-s+1 tell how old they were; before outputs 0 nothing is held."""
        s = max(int(getattr(self._info, "s", 1)), 1)
        told = self._outputs.find(keys - (s - 1))
        held = np.nan_to_num(told.column("held")).astype(np.int64)
        which = np.where(k < s - 1, keys, np.where(told.known, keys - held, NO_KEY))
        wanted, place = np.unique(which, return_inverse=True)
        return self._inputs.find(wanted).vectors()[place]

    def _time(self, stamp: NDArray[np.int64], row: NDArray[np.intp]) -> Array:
        """Seconds since the first sample: by the stamps where they grow all along, else by counting sample times."""
        if self._by_stamps:
            return np.asarray(1e-9 * (stamp - self._start), dtype=np.float64)
        period = float(getattr(self._info, "sample_time", np.nan))
        return np.asarray(row * np.float64(1.0 if np.isnan(period) else period), dtype=np.float64)

    def _said(self, found: Found, keys: Keys, t: Array, first: int, before: int) -> Reports:
        """The monitor's reports on samples with these keys, and on those that are missing behind them."""
        at = np.maximum(np.searchsorted(keys, found.keys, side="right") - 1, 0)

        def columns(number: str) -> Array:
            return np.stack([found.column(f"{p}.{number}") for p in PROPERTIES], axis=1)

        return Reports(
            epoch=self._epochs[found.keys >> K_BITS],
            k=found.keys & ((1 << K_BITS) - 1),
            t=self._time(found.stamps(), at) if self._by_stamps else t[at],
            row=first + at,
            first=before,
            total=self._reports.count,
            verdict=columns("verdict").astype(np.uint8),
            lambda_star=columns("lambda_star_re") + 1j * columns("lambda_star_im"),
            margin=columns("margin"),
            reason=self._reason,
            series={name: found.column(name) for name in REPORT_FIELDS},
        )


def load_run(
    bag: str | os.PathLike[str] | BagReader, namespace: str | None = None, *, progress: Progress = no_progress
) -> Run:
    """Reads one plant's run out of a bag, as arrays in memory; ``Recording`` reads what is too long for that.

    Args:
        bag: folder, file or open reader.
        namespace: of the plant, e.g. "/grid"; default: the only one in the bag.
        progress: called now and then with messages done and in all.

    Returns:
        The run; time and memory are linear in the number of samples.

    Raises:
        BagError: see ``Recording``.
    """
    with Recording(bag, namespace, progress=progress) as recording:
        return next(recording.stretches(recording.total))


def find_namespace(reader: BagReader, namespace: str | None = None) -> str:
    """The namespace of the only plant in a bag, or the given one if it is there ("" = the root).

    Raises:
        BagError: if there is no such plant, or more than one and none was named.
    """
    reader.must_hold_something()
    found = [t.name.removesuffix("/outputs") for t in reader.topics.values()
             if t.name.endswith("/outputs") and t.type == "deepc_msgs/msg/Sample"]  # fmt: skip
    if namespace is not None:
        wanted = "/" + namespace.strip("/") if namespace.strip("/") else ""
        if wanted in found:
            return wanted
        raise BagError(f"bag {reader.path} has no plant {namespace!r}; it has {', '.join(found) or 'none'}")
    if len(found) > 1:
        raise BagError(f"bag {reader.path} has {len(found)} plants: name one of {', '.join(found)} as --namespace")
    if not found:
        raise BagError(_no_plant(reader))
    return found[0]


def _no_plant(reader: BagReader) -> str:
    names = sorted(reader.topics)
    more = f" and {len(names) - 8} more" if len(names) > 8 else ""
    return (
        f"bag {reader.path} has no plant, that is no topic .../outputs of deepc_msgs/msg/Sample; it has "
        f"{', '.join(names[:8])}{more}; `analyze` and `tune` take any field of any topic as --input and --output"
    )


def _asked_for(used: Array, keys: Keys, references: Found, before: Array) -> Array:
    """The reference the controller says it used; where it is silent, what was asked for on the topic, from its k on."""
    asked = references.vectors()
    if asked.shape[1] == used.shape[1]:
        asked = np.vstack([before, asked])
        held = asked[np.searchsorted(references.keys, keys, side="right")]
        gap = np.isnan(used).any(axis=1) & ~np.isnan(held).all(axis=1)
        used[gap] = held[gap]
    return used


def _names(info: Any, attribute: str, stem: str, size: int) -> tuple[str, ...]:
    given = tuple(getattr(info, attribute, ()))
    return given if len(given) == size else tuple(f"{stem}{i + 1}" if stem else "" for i in range(size))


def _limits(info: Any, attribute: str, size: int) -> Array:
    given = np.asarray(getattr(info, attribute, ()), dtype=np.float64)
    return given if len(given) == size else np.full(size, np.nan)
