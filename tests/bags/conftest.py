# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""A recorded run with known content: a stable second-order plant under excitation, then under feedback."""

import sys
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from deepc_msgs.msg import ControllerState, MonitorReport, PlantInfo, Sample, Verdict
from numpy.random import PCG64, Generator

from ros2_deepc import cli
from ros2_deepc.bags import BagWriter
from ros2_deepc.bags.convert import to_cdr
from ros2_deepc.bags.layout import qos_entry

with warnings.catch_warnings():  # the first (de)serialization imports lark, which uses a deprecated module
    warnings.simplefilter("ignore", DeprecationWarning)
    to_cdr(Sample())

T0 = 1_700_000_000
TS = 0.1


def stamp(header, k: int) -> None:
    ns = T0 * 10**9 + round(k * TS * 1e9)
    header.stamp.sec, header.stamp.nanosec = ns // 10**9, ns % 10**9
    header.frame_id = "räume"  # UTF-8 must survive


def sample(k: int, values, epoch: int = 0, held: int = 0) -> Sample:
    message = Sample(epoch=epoch, k=k, values=list(map(float, values)), held=held)
    stamp(message.header, k)
    return message


def plant_info(m: int = 2, p: int = 2) -> PlantInfo:
    info = PlantInfo(name="bench", variant="two", sample_time=TS, lockstep=True, q=2, s=1, n=2)
    info.input_names, info.input_units = [f"valve{i}" for i in range(m)], ["m3/s"] * m
    info.output_names, info.output_units = [f"head{i}" for i in range(p)], ["m"] * p
    info.input_min, info.input_max = [-1.0] * m, [1.0] * m
    stamp(info.header, 0)
    return info


def state(k: int, mode: int, reference, u, epoch: int = 0, solve_time: float = 0.0, failures: int = 0):
    message = ControllerState(epoch=epoch, k=k, mode=mode, reference=list(reference), input=list(u), failures=failures)
    message.status = ControllerState.STATUS_SOLVED if mode == ControllerState.CONTROLLING else 0
    message.solve_time, message.reason, message.gap = solve_time, "weil es geht", float("inf")
    message.window, message.rank, message.rank_need = min(k + 1, 100), min(k, 44), 44
    message.input_plan, message.output_plan = [0.25] * 4, [0.5] * 4
    stamp(message.header, k)
    return message


def report(k: int, epoch: int = 0) -> MonitorReport:
    def verdict(v: int, star: complex, margin: float) -> Verdict:
        reason = "one mode is out of reach" if v == Verdict.NOT_PROVED else "rich data"
        return Verdict(verdict=v, reason=reason, theorem="1*", rank=5, required=6, margin=margin,
                       lambda_star_re=star.real, lambda_star_im=star.imag)  # fmt: skip

    first = Verdict.UNDECIDED if k < 60 else Verdict.NOT_PROVED
    message = MonitorReport(epoch=epoch, k=k, rank=min(k, 27), rank_need=27)
    message.excitation, message.excitation_need = min(k // 3, 30), 20
    message.r_controllability = verdict(first, 1.0 + 0.5j, -1.5)
    message.c_controllability = verdict(Verdict.REFUTED, complex("nan"), float("nan"))
    message.r_observability = verdict(Verdict.UNDECIDED if k < 60 else Verdict.PROVED, 0.9 + 0j, 80.0)
    message.c_observability = verdict(Verdict.NOT_DECIDABLE, complex("nan"), float("nan"))
    stamp(message.header, k)
    return message


@dataclass
class Recorded:
    """What was put into a bag."""

    folder: Path
    u: np.ndarray
    y: np.ndarray
    ref: np.ndarray
    messages: list[tuple[str, Any]] = field(default_factory=list)


def simulate(K: int, seed: int, collect: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """u (K+1, 2), y (K, 2), ref (K, 2) of a plant that first is excited, then steered to two references."""
    rng = Generator(PCG64(seed))
    A, B = np.array([[0.9, 0.1], [0.0, 0.8]]), np.array([[0.3, 0.0], [0.1, 0.5]])
    x, u, y = np.array([2.0, -1.0]), np.zeros((K + 1, 2)), np.zeros((K, 2))
    ref = np.where(np.arange(K)[:, None] < (collect + K) // 2, [1.0, 0.5], [-0.5, 1.0])
    u[0] = rng.uniform(-1, 1, 2)
    for k in range(K):
        y[k] = x
        x = A @ x + B @ u[k]
        wanted = np.linalg.solve(B, ref[k] - A @ x + 0.5 * (x - ref[k]))
        u[k + 1] = rng.uniform(-1, 1, 2) if k < collect else np.clip(wanted, -1, 1)
    return u, y, ref


TOPICS = {
    "plant_info": "PlantInfo", "outputs": "Sample", "inputs": "Sample", "reference": "Sample",
    "controller/state": "ControllerState", "monitor/report": "MonitorReport",
}  # fmt: skip


def run_messages(u, y, ref, collect: int) -> list[tuple[str, Any]]:
    """The messages of a lockstep run in the order in which a recorder would see them."""
    K = len(y)
    out = [("plant_info", plant_info()), ("inputs", sample(0, u[0]))]
    for k in range(K):
        if k == 0 or (ref[k] != ref[k - 1]).any():
            out.append(("reference", sample(k, ref[k])))
        mode = ControllerState.COLLECTING if k < collect else ControllerState.CONTROLLING
        out.append(("outputs", sample(k, y[k])))
        out.append(("inputs", sample(k + 1, u[k + 1])))
        out.append(("controller/state", state(k, mode, ref[k], u[k + 1], solve_time=1e-3 * (1 + k % 7))))
        if k % 10 == 9:
            out.append(("monitor/report", report(k)))
    return out


def write_bag(folder: Path, messages, namespace: str = "/grid", attach=None, **options) -> None:
    """Writes messages one millisecond apart."""
    with BagWriter(folder, **options) as bag:
        for name, kind in TOPICS.items():
            bag.add_topic(f"{namespace}/{name}", f"deepc_msgs/msg/{kind}", [qos_entry()])
        for name, data in (attach or {}).items():
            bag.attach(name, "application/yaml", data)
        for i, (name, message) in enumerate(messages):
            time = T0 * 10**9 + i * 10**6
            bag.write(f"{namespace}/{name}", to_cdr(message), time, time - 1000)


@pytest.fixture(scope="session")
def make():
    """The functions of this file: make.sample(...), make.write_bag(...), ..."""
    return sys.modules[__name__]


@pytest.fixture
def record(tmp_path):
    """Function that records a run and returns what went in."""

    def run(K: int = 200, collect: int = 100, seed: int = 1, name: str = "bag", **options) -> Recorded:
        u, y, ref = simulate(K, seed, collect)
        messages = run_messages(u, y, ref, collect)
        write_bag(tmp_path / name, messages, **options)
        return Recorded(tmp_path / name, u, y, ref, messages)

    return run


@pytest.fixture
def deepc(monkeypatch, capsys):
    """Runs ros2-deepc and returns its exit code, output (240 columns wide) and errors."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["ros2-deepc", *map(str, arguments)])
        monkeypatch.setenv("COLUMNS", "240")
        code = cli.main()
        seen = capsys.readouterr()
        return code, seen.out, seen.err

    return run
