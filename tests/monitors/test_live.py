# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The monitors on a stream: pairing, gaps, hysteresis, the age of the last proof."""

from dataclasses import replace

import numpy as np
import pytest

from ros2_deepc.monitors import Prior, Verdict, analyze, indicate
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


def test_in_lockstep_outputs_wait_for_their_inputs_however_long_those_are_on_their_way():
    inputs = excitation(100)
    outputs = stream(inputs)
    live = LiveMonitor(PRIOR, window=200, period=20, lockstep=True)
    for k in range(50):  # somebody who joined late: input 0 has gone by
        live.output(k, outputs[k])
    for k in range(1, 50):
        live.input(k, [inputs[k]])
    for k in range(50, 100):
        assert not live.output(k, outputs[k])
    jobs = [job for k in range(50, 100) for job in live.input(k, [inputs[k]])]
    assert [job.k for job in jobs] == [59, 79, 99]
    ((u, y),) = live.records()
    np.testing.assert_array_equal(u[:, 0], inputs[1:])
    np.testing.assert_array_equal(y, outputs[1:])


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
        return live._settle(50, replace(made.report, r_controllability=finding), ENTER).r_controllability.verdict

    assert settled(ENTER - 0.1) is Verdict.UNDECIDED
    assert settled(ENTER + 0.1) is Verdict.PROVED
    assert settled(0.1) is Verdict.PROVED
    lost = replace(made.report.r_controllability, verdict=Verdict.NOT_PROVED, margin=-1.0)
    live._settle(51, replace(made.report, r_controllability=lost), ENTER)
    assert settled(ENTER - 0.1) is Verdict.UNDECIDED


def test_the_indicator_is_never_below_the_margin_of_the_report():
    inputs = excitation(60)
    live = LiveMonitor(PRIOR, window=200, period=60)
    assert live.indicator() is None
    (made,) = feed(live, inputs, stream(inputs))
    seen = live.indicator()
    assert seen.controllability >= made.report.r_controllability.margin - 1e-6
    assert seen.observability >= made.report.r_observability.margin - 1e-6


@pytest.mark.parametrize(("s", "noise", "lost"), [(1, 0.0, ()), (2, 0.0, ()), (1, 1e-3, ()), (2, 1e-3, (90, 91, 130))])
def test_the_indicator_follows_the_window_as_if_it_were_factored_anew(s, noise, lost):
    inputs = excitation(200)
    rng = np.random.Generator(np.random.PCG64(2))
    outputs = [y + noise * rng.standard_normal(1) for y in stream(inputs)]
    live, compared = LiveMonitor(Prior(q=2, s=s), window=60, period=25, noise=noise), 0
    for k in range(200):
        jobs = live.input(k, inputs[k : k + 1])
        if k not in lost:
            jobs += live.output(k, outputs[k])
        for job in jobs:
            live.analyse(job)
        seen = live.indicator()
        records = live.records()
        if seen is None or len(records) > 1:
            continue
        u, y = records[0]
        window = slice(s - 1, None)  # the first column starts with the newest input of the first outputs
        fresh = indicate(u[window], y[window], prior=live.prior, L=live._stream.L, noise=noise)
        assert (seen.rank, seen.rank_need, seen.reason) == (fresh.rank, fresh.rank_need, fresh.reason)
        assert seen.observability == pytest.approx(fresh.observability, abs=1)  # [dB]; scaled by columns, not samples
        compared += 1
    assert compared > 30
    assert live._stream.L >= 2


def test_the_indicator_after_a_gap_is_that_of_records_side_by_side():
    inputs = excitation(120)
    live = LiveMonitor(PRIOR, window=200, period=20)
    feed(live, inputs[:60], stream(inputs)[:60])
    assert live.indicator().rank == live.indicator().rank_need
    for k in range(62, 120):
        live.input(k, [inputs[k]])
        live.output(k, stream(inputs)[k])
        seen = live.indicator()
        assert (seen.rank, seen.controllability > 0) == (seen.rank_need, True)  # a column across the gap would raise it
    assert live._stream._factor.held == 60 + 58 - 2 * live._stream.L
    assert seen.controllability == pytest.approx(
        analyze(*live.records()[0], prior=PRIOR, L=2).r_controllability.margin, abs=12
    )


def test_the_indicator_warns_before_the_next_report():
    inputs = np.concatenate([excitation(60), np.full(40, 0.5)])
    outputs = stream(inputs)
    live = LiveMonitor(PRIOR, window=40, period=50)
    feed(live, inputs[:60], outputs[:60])
    first = live.indicator().controllability
    assert first > 100
    for k in range(60, 99):
        live.input(k, [inputs[k]])
        live.output(k, outputs[k])
    assert "persistently exciting" in live.indicator().reason


def test_the_indicator_weighs_outputs_by_their_noise_as_the_report_does():
    inputs, rng = excitation(150), np.random.Generator(np.random.PCG64(3))
    clean = np.array(stream(inputs))
    std = np.array([1e-4, 0.3])
    outputs = np.hstack([clean, clean]) + std * rng.standard_normal((150, 2))
    live = LiveMonitor(Prior(q=2), window=100, period=50, noise=std)
    reports = feed(live, inputs, outputs)
    seen = live.indicator()
    fresh = live.records()[0]
    alone = indicate(fresh[0], fresh[1][:, :1], prior=Prior(q=2), L=live._stream.L, noise=1e-4)
    assert reports[-1].report.r_controllability.verdict is Verdict.PROVED
    assert seen.controllability > alone.controllability - 6  # the second sensor is of no use, and no harm
