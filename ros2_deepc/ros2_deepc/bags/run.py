# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""A recorded run as aligned arrays."""

import hashlib
import os
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .columns import NO_EPOCH, Columns, first_rows, pick
from .errors import BagError
from .progress import Progress, no_progress
from .reader import BagReader
from .writer import RUN_METADATA

Array = NDArray[np.float64]
Clock = Callable[[NDArray[np.int64], NDArray[np.int64]], Array]  # from stamps [ns] and keys to Run.t
PROPERTIES = ("r_controllability", "c_controllability", "r_observability", "c_observability")
VERDICTS = ("UNDECIDED", "PROVED", "NOT_PROVED", "PRIOR_VIOLATED", "REFUTED", "NOT_DECIDABLE")
MODES = ("IDLE", "COLLECTING", "CONTROLLING", "HOLDING", "FALLBACK", "SHADOW")
NO_MODE = 255
STATE_FIELDS = (
    "mode", "status", "solve_time", "prepare_time", "distance", "window", "rank", "rank_need", "gap", "excitation",
    "excitation_need", "slack", "cost", "iterations", "limited", "deadline_misses", "failures", "refused",
)  # fmt: skip
REPORT_FIELDS = (
    "excitation", "excitation_need", "rank", "rank_need", "window", "depth", "estimated_q", "estimated_s",
    "estimated_lag", "data_age", "compute_time",
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reports:
    """The monitor's reports, one row each.

    Attributes:
        epoch, k, t: shape (R,); t in seconds on the clock of ``Run.t``.
        verdict: shape (R, 4), indices into VERDICTS, columns as PROPERTIES.
        lambda_star: shape (R, 4), complex; NaN where none.
        margin: shape (R, 4) [dB].
        reason: of each property, the last one.
        series: scalar fields of the report by name, each of shape (R,).
    """

    epoch: NDArray[np.int64]
    k: NDArray[np.int64]
    t: Array
    verdict: NDArray[np.uint8]
    lambda_star: NDArray[np.complex128]
    margin: Array
    reason: tuple[str, ...] = ("",) * 4
    series: Mapping[str, Array] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True, eq=False)
class Run:
    """One plant's run; row i is the sample with index k[i] of epoch[i], in the order of arrival.

    Attributes:
        plant, variant: names; empty if no PlantInfo was recorded.
        sample_time: Ts [s]; NaN if unknown.
        epoch, k: shape (K,).
        t: shape (K,), seconds since the first sample.
        y: shape (K, p), outputs.
        u: shape (K, m), the input in force (the plant may have held an older one); NaN where not recorded.
        ref: shape (K, p), reference in use; NaN where none.
        mode: shape (K,), index into MODES when the controller had seen this sample; NO_MODE where it said nothing.
        solve_time: shape (K,) [s]; NaN where nothing was solved.
        state: further scalar fields of ControllerState by name, each of shape (K,), NaN where not recorded.
        u_ahead: shape (r, m), inputs already given for samples after the last one.
        reports: what the monitor said.
        input_min, input_max: shape (m,).
        prior: n, q, r, s as the plant gave them; 0 = not given.
        duplicates: outputs or inputs that came more than once for the same sample (the first one counts).
        metadata: the recorder's metadata.
    """

    plant: str
    variant: str
    sample_time: float
    input_names: tuple[str, ...]
    input_units: tuple[str, ...]
    output_names: tuple[str, ...]
    output_units: tuple[str, ...]
    input_min: Array
    input_max: Array
    prior: Mapping[str, Any]
    epoch: NDArray[np.int64]
    k: NDArray[np.int64]
    t: Array
    u: Array
    y: Array
    ref: Array
    mode: NDArray[np.uint8]
    solve_time: Array
    state: Mapping[str, Array]
    u_ahead: Array
    reports: Reports
    duplicates: int
    metadata: Mapping[str, str]

    def __len__(self) -> int:
        return len(self.k)

    @cached_property
    def loop_hash(self) -> str:
        """See ``loop_hash``."""
        return loop_hash(self.u, self.y)


def loop_hash(u: Array, y: Array) -> str:
    """SHA-256 (hex) of u(0) y(0) u(1) y(1) ... as little-endian float64; rows with a NaN in u are left out.

    Args:
        u: shape (K, m).
        y: shape (K, p).
    """
    rows = np.hstack([u, y]).astype("<f8")[~np.isnan(u).any(axis=1)]
    return hashlib.sha256(np.ascontiguousarray(rows).tobytes()).hexdigest()


def load_run(
    bag: str | os.PathLike[str] | BagReader, namespace: str | None = None, *, progress: Progress = no_progress
) -> Run:
    """Reads one plant's run out of a bag.

    Args:
        bag: folder, file or open reader.
        namespace: of the plant, e.g. "/grid"; default: the only one in the bag.
        progress: called now and then with messages done and in all.

    Returns:
        The run; time and memory are linear in the number of samples.

    Raises:
        BagError: if there are no outputs, several plants and no namespace, or a sample of another size than the rest.
    """
    reader = bag if isinstance(bag, BagReader) else BagReader(bag)
    prefix = find_namespace(reader, namespace)
    tables = {
        "outputs": Columns(("held",), "values"),
        "inputs": Columns((), "values"),
        "reference": Columns((), "values"),
        "controller/state": Columns(STATE_FIELDS, "reference"),
        "monitor/report": Columns((*REPORT_FIELDS, *_VERDICT_FIELDS)),
    }
    done = 0
    for topic, block in reader.blocks([f"{prefix}/{name}" for name in tables]):
        tables[topic[len(prefix) + 1 :]].add(block)
        done += len(block)
        progress(done, reader.message_count)
    info = next((message for _, message in reader.decoded([f"{prefix}/plant_info"])), None)
    last_report = _last(reader, f"{prefix}/monitor/report")
    if not len(tables["outputs"]):
        raise BagError(f"bag {reader.path} has no message on {prefix}/outputs")
    return _align(tables, info, last_report, reader.metadata.get(RUN_METADATA, {}))


def find_namespace(reader: BagReader, namespace: str | None = None) -> str:
    """The namespace of the only plant in a bag, or the given one if it is there ("" = the root).

    Raises:
        BagError: if there is no such plant, or more than one and none was named.
    """
    found = [t.name.removesuffix("/outputs") for t in reader.topics.values()
             if t.name.endswith("/outputs") and t.type == "deepc_msgs/msg/Sample"]  # fmt: skip
    if namespace is not None:
        wanted = "/" + namespace.strip("/") if namespace.strip("/") else ""
        if wanted in found:
            return wanted
        raise BagError(f"bag {reader.path} has no plant {namespace!r}; it has {', '.join(found) or 'none'}")
    if len(found) != 1:
        advice = f": name one of {', '.join(found)}" if found else ""
        raise BagError(f"bag {reader.path} has {len(found)} plants{advice}")
    return found[0]


_VERDICT_NUMBERS = ("verdict", "lambda_star_re", "lambda_star_im", "margin")
_VERDICT_FIELDS = tuple(f"{p}.{number}" for p in PROPERTIES for number in _VERDICT_NUMBERS)


def _last(reader: BagReader, topic: str) -> Any:
    """The last message of a topic, or None."""
    raw = deque(reader.messages([topic]), maxlen=1)
    return reader.topics[topic].decoder()(raw[0].data) if raw else None


def _align(tables: Mapping[str, Columns], info: Any, last_report: Any, metadata: Mapping[str, str]) -> Run:
    outputs, inputs, state = tables["outputs"], tables["inputs"], tables["controller/state"]
    _, firsts = np.unique(outputs.epoch, return_index=True)
    epochs = outputs.epoch[np.sort(firsts)].tolist()  # in the order of arrival
    y_keys, u_keys, state_keys = outputs.keys(epochs), inputs.keys(epochs), state.keys(epochs)
    keys, rows = first_rows(y_keys)
    y, u_all = outputs.vectors()[rows], inputs.vectors()
    held = np.nan_to_num(outputs.column("held"))[rows]
    acted = _acted(keys, outputs.k[rows].astype(np.int64), held, max(int(getattr(info, "s", 1)), 1))
    ahead, _ = first_rows(u_keys[u_keys > keys[-1]])
    ahead = ahead[np.cumprod(ahead == keys[-1] + 1 + np.arange(len(ahead))).astype(bool)]
    t, clock = _time(outputs.stamp[rows], keys, getattr(info, "sample_time", np.nan))
    mode = pick(state.column("mode"), state_keys, keys, float(NO_MODE))
    p, m = y.shape[1], u_all.shape[1]
    return Run(
        plant=getattr(info, "name", ""),
        variant=getattr(info, "variant", ""),
        sample_time=float(getattr(info, "sample_time", np.nan)),
        input_names=_names(info, "input_names", "u", m),
        input_units=_names(info, "input_units", "", m),
        output_names=_names(info, "output_names", "y", p),
        output_units=_names(info, "output_units", "", p),
        input_min=_limits(info, "input_min", m),
        input_max=_limits(info, "input_max", m),
        prior={name: getattr(info, name, 0) for name in ("n", "q", "r", "s")},
        epoch=outputs.epoch[rows],
        k=outputs.k[rows].astype(np.int64),
        t=t,
        u=pick(u_all, u_keys, acted),
        y=y,
        ref=_references(tables["reference"], state, epochs, keys, p),
        mode=mode.astype(np.uint8),
        solve_time=_solved(state, state_keys, keys),
        state={name: pick(state.column(name), state_keys, keys) for name in STATE_FIELDS},
        u_ahead=pick(u_all, u_keys, ahead),
        reports=_reports(tables["monitor/report"], last_report, epochs, clock),
        duplicates=len(y_keys) - len(keys) + len(u_keys) - len(np.unique(u_keys)),
        metadata=metadata,
    )


def _acted(keys: NDArray[np.int64], k: NDArray[np.int64], held: Array, s: int) -> NDArray[np.int64]:
    """Keys of the commands in force at k: outputs k-s+1 tell how old they were; before outputs 0 nothing is held."""
    told = np.where(k < s - 1, 0.0, pick(held, keys, keys - (s - 1)))
    return np.where(np.isnan(told), NO_EPOCH, keys - np.nan_to_num(told).astype(np.int64))


def _time(stamp: NDArray[np.int64], keys: NDArray[np.int64], sample_time: float) -> tuple[Array, Clock]:
    """Seconds since the first sample: by the stamps where they grow, else by counting sample times."""
    if len(stamp) == 1 or np.all(np.diff(stamp) > 0):
        return _seconds(stamp - stamp[0]), lambda stamps, _: _seconds(stamps - stamp[0])
    t: Array = np.arange(len(keys), dtype=np.float64) * np.float64(1.0 if np.isnan(sample_time) else sample_time)
    return t, lambda _, wanted: np.asarray(pick(t, keys, wanted), dtype=np.float64)


def _seconds(nanoseconds: NDArray[np.int64]) -> Array:
    return np.asarray(1e-9 * nanoseconds, dtype=np.float64)


def _references(topic: Columns, state: Columns, epochs: list[int], keys: NDArray[np.int64], p: int) -> Array:
    """The reference the controller says it used; where it is silent, what was asked for on the topic, from its k on."""
    used = state.vectors()
    ref = np.full((len(keys), p), np.nan)
    if used.shape[1] == p:
        ref[:] = pick(used, state.keys(epochs), keys)
    asked, asked_keys = topic.vectors(), topic.keys(epochs)
    if asked.shape[1] == p and (asked_keys >= 0).any():
        order = np.argsort(asked_keys, kind="stable")
        order = order[asked_keys[order] >= 0]
        last = np.searchsorted(asked_keys[order], keys, side="right") - 1
        gap = np.isnan(ref).any(axis=1) & (last >= 0)
        ref[gap] = asked[order][last[gap]]
    return ref


def _solved(state: Columns, state_keys: NDArray[np.int64], keys: NDArray[np.int64]) -> Array:
    """Solve times where the controller optimised (status other than NONE)."""
    seconds = pick(state.column("solve_time"), state_keys, keys)
    status = pick(state.column("status"), state_keys, keys)
    return np.where(status > 0, seconds, np.nan)


def _reports(table: Columns, last: Any, epochs: list[int], clock: Clock) -> Reports:
    keys = table.keys(epochs)
    known = keys >= 0

    def columns(number: str) -> Array:
        return np.stack([table.column(f"{p}.{number}") for p in PROPERTIES], axis=1)[known]

    return Reports(
        epoch=table.epoch[known],
        k=table.k[known].astype(np.int64),
        t=clock(table.stamp, keys)[known],
        verdict=columns("verdict").astype(np.uint8),
        lambda_star=columns("lambda_star_re") + 1j * columns("lambda_star_im"),
        margin=columns("margin"),
        reason=tuple(getattr(last, p).reason if last else "" for p in PROPERTIES),
        series={name: table.column(name)[known] for name in REPORT_FIELDS},
    )


def _names(info: Any, attribute: str, stem: str, size: int) -> tuple[str, ...]:
    given = tuple(getattr(info, attribute, ()))
    return given if len(given) == size else tuple(f"{stem}{i + 1}" if stem else "" for i in range(size))


def _limits(info: Any, attribute: str, size: int) -> Array:
    given = np.asarray(getattr(info, attribute, ()), dtype=np.float64)
    return given if len(given) == size else np.full(size, np.nan)
