# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The monitors on a stream: pairing, gaps, hysteresis, the age of the last proof."""

from dataclasses import replace

import numpy as np
import pytest

from ros2_deepc.monitors import Prior, Verdict, analyze
from ros2_deepc.monitors.live import ENTER, LiveMonitor

A, B, C = np.array([[0.9, 0.2], [-0.1, 0.8]]), np.array([0.3, 1.0]), np.array([1.0, 0.0])
PRIOR = Prior(q=2, s=1, n=2, D=[[0.0]])


def stream(inputs):
    """Outputs of a controllable and observable plant of order 2, with direct access to none of its states."""
    x, outputs = np.array([1.0, -1.0]), []
    for u in inputs:
        outputs.append(np.array([C @ x]))
        x = A @ x + B * u
    return outputs


def excitation(count, seed=0):
    return np.random.Generator(np.random.PCG64(seed)).uniform(-1, 1, count)


def feed(live, inputs, outputs, lost=(), order=("input", "output")):
    """Reports of a run in which some outputs never come."""
    reports = []
    for k, (u, y) in enumerate(zip(inputs, outputs, strict=True)):
        for kind in order:
            if kind == "input":
                reports += live.input(k, [u])
            elif k not in lost:
                reports += live.output(k, y)
    return [live.analyse(job) for job in reports]


@pytest.mark.parametrize("order", [("input", "output"), ("output", "input")])
def test_the_stream_says_what_the_batch_says(order):
    inputs = excitation(60)
    outputs = stream(inputs)
    reports = feed(LiveMonitor(PRIOR, window=200, period=20), inputs, outputs, order=order)
    assert [live.k for live in reports] == [19, 39, 59]
    batch = analyze(inputs[:, None], np.array(outputs), prior=PRIOR)
    last = reports[-1].report
    assert last.r_controllability == batch.r_controllability
    assert last.r_observability.verdict is Verdict.PROVED


def test_a_gap_costs_columns_and_no_more():
    inputs = excitation(80)
    live = LiveMonitor(PRIOR, window=200, period=80)
    (report,) = feed(live, inputs, stream(inputs), lost={30, 50})
    assert [len(y) for _, y in live.records()] == [30, 19, 29]
    assert report.report.r_controllability.verdict is Verdict.PROVED
    assert report.report.rank == report.report.rank_need  # a column across a gap would raise it


def test_held_inputs_are_taken_as_they_acted():
    commanded = excitation(60)
    acted = commanded.copy()
    acted[25] = acted[24]
    outputs = stream(acted)
    live = LiveMonitor(PRIOR, window=200, period=60)
    due = []
    for k in range(60):
        due += live.input(k, [commanded[k]])
        due += live.output(k, outputs[k], held=1 if k == 25 else 0)
    (job,) = due
    report = live.analyse(job).report
    assert report.rank == report.rank_need
    assert report.r_controllability.verdict is Verdict.PROVED


@pytest.mark.parametrize("seed", range(5))
def test_a_late_command_is_taken_as_it_acted(seed):
    rng = np.random.Generator(np.random.PCG64(seed))
    commanded = excitation(120, seed)
    due = np.arange(120) + rng.choice(4, 120, p=[0.7, 0.1, 0.1, 0.1]) * (np.arange(120) > 0)
    used = [max(i for i in range(k + 1) if due[i] <= k) for k in range(120)]
    outputs = stream(commanded[used])
    live = LiveMonitor(PRIOR, window=200, period=120)
    jobs = []
    for k in range(120):  # the monitor hears a command when the plant does
        for i in np.flatnonzero(due == k):
            jobs += live.input(int(i), [commanded[i]])
        jobs += live.output(k, outputs[k], held=k - used[k])
    (job,) = jobs
    ((u, _),) = job.records
    assert u[:, 0].tolist() == commanded[used].tolist()
    report = live.analyse(job).report
    assert report.rank == report.rank_need
    assert report.r_controllability.verdict is Verdict.PROVED


def test_lost_excitation_is_never_a_stale_proof():
    inputs = np.concatenate([excitation(40), np.full(80, 0.5)])
    reports = feed(LiveMonitor(PRIOR, window=40, period=20), inputs, stream(inputs))
    findings = [live.report.r_controllability for live in reports]
    assert findings[1].verdict is Verdict.PROVED
    assert findings[-1].verdict is Verdict.UNDECIDED
    assert "last proved at k = " in findings[-1].reason


def test_a_proof_is_entered_at_three_decibels_and_left_at_zero():
    live = LiveMonitor(PRIOR, window=100, period=50)
    inputs = excitation(50)
    (made,) = feed(live, inputs, stream(inputs))
    live = LiveMonitor(PRIOR, window=100, period=50)

    def settled(margin):
        finding = replace(made.report.r_controllability, verdict=Verdict.PROVED, margin=margin)
        return live._settle(50, replace(made.report, r_controllability=finding)).r_controllability.verdict

    assert settled(ENTER - 0.1) is Verdict.UNDECIDED
    assert settled(ENTER + 0.1) is Verdict.PROVED
    assert settled(0.1) is Verdict.PROVED
    lost = replace(made.report.r_controllability, verdict=Verdict.NOT_PROVED, margin=-1.0)
    live._settle(51, replace(made.report, r_controllability=lost))
    assert settled(ENTER - 0.1) is Verdict.UNDECIDED


def test_the_indicator_is_never_below_the_margin_of_the_report():
    inputs = excitation(60)
    live = LiveMonitor(PRIOR, window=200, period=60)
    assert live.indicator() is None
    (made,) = feed(live, inputs, stream(inputs))
    seen = live.indicator()
    assert seen.controllability >= made.report.r_controllability.margin - 1e-6
    assert seen.observability >= made.report.r_observability.margin - 1e-6
