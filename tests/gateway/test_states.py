# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""From SHADOW to RUN and back: every loss, its time, and what the field gets meanwhile. Time moves by hand."""

import math

import numpy as np
import pytest

from ros2_deepc.gateway.assemble import Quality

TAGS_STALE, TAGS_FALLBACK = 0.35, 1.0


def since(bench, start, state):
    """How long after ``start`` a state was first entered [s]."""
    return next(t for t, s in bench.states if t >= start and s == state) - start


def test_shadow_writes_nothing_and_says_that_its_samples_are_not_for_learning(bench):
    b = bench()
    b.run(3.0)
    assert b.command(0) == "mode"
    b.run(1.0)
    assert b.reached == []
    assert not hasattr(b, "pending_beat")
    assert len(b.samples) == 41  # the first look, then 40 scans
    assert {o.epoch for o in b.samples} == {0}
    assert all((o.vector.quality == Quality.UNCERTAIN).all() for o in b.samples)


def test_auto_starts_a_new_epoch_and_counts_from_the_first_inputs(bench):
    b = bench().start()
    assert b.gateway.epoch == 2
    mine = [o for o in b.samples if o.epoch == 2]
    assert [o.k for o in mine] == list(range(len(mine)))
    assert all(o.held == 0 and o.vector.good for o in mine)
    np.testing.assert_allclose(mine[0].vector.values, [0.62831853, 3.5])
    assert [tuple(u) for _, u in b.reached] == [(0.1, 0.6)] * len(b.reached)


def test_inputs_reach_the_field_between_the_scans_that_they_belong_to(bench):
    b = bench().start()
    before = len(b.reached)
    b.run(1.0)
    assert len(b.reached) - before == 10
    assert np.allclose(np.diff([t for t, _ in b.reached]), 0.1, atol=1e-6)


@pytest.mark.parametrize(
    ("loss", "to_degraded"),
    [
        (lambda b: setattr(b, "up", False), 0.01),
        (lambda b: setattr(b, "scanning", False), TAGS_STALE),
        (lambda b: setattr(b, "controller", False), TAGS_STALE),
        (lambda b: b.raw.__setitem__(0, math.nan), 0.1),
        (lambda b: b.raw.__setitem__(0, 1e30), 0.1),
        (lambda b: b.quality.__setitem__(1, Quality.UNCERTAIN), 0.1),
    ],
    ids=["link", "scan", "controller", "not a number", "out of range", "uncertain"],
)
def test_every_loss_degrades_then_falls_back_and_stays_there(bench, loss, to_degraded):
    b = bench().start()
    start = b.now
    loss(b)
    b.run(0.9)
    held = list(b.reached)
    assert b.gateway.state == "DEGRADED"
    assert since(b, start, "DEGRADED") <= to_degraded + 0.1 + 2e-2
    b.run(0.5)
    assert b.gateway.state == "FALLBACK"
    assert since(b, start, "FALLBACK") <= to_degraded + TAGS_FALLBACK + 0.1 + 2e-2
    assert b.reached[: len(held)] == held
    b.__dict__.update(up=True, scanning=True, controller=True, raw=[100.0, 2.0], quality=[0, 0])
    b.run(5.0)
    assert b.gateway.state == "FALLBACK", "latched"


def test_the_ramp_goes_from_the_last_to_the_safe_inputs_in_its_time(bench):
    b = bench().start()
    b.raw[0] = math.nan
    b.run(1.5)
    entered = b.gateway.supervisor.since
    b.run(2.5)
    ramp = [(t - entered, u) for t, u in b.reached if t > entered]
    for t, u in ramp:
        share = min(1.0, t / 2.0)
        np.testing.assert_allclose(u, [0.1 * (1 - share), 0.6 - 0.1 * share], atol=1e-9)
    np.testing.assert_array_equal(ramp[-1][1], [0.0, 0.5])
    assert ramp[-1][0] < 2.2
    assert b.gateway.settled()


def test_hold_writes_nothing_and_keeps_the_heartbeat(bench, text):
    b = bench(text.replace("policy: ramp, seconds: 2.0", "policy: hold")).start()
    b.raw[0], n = math.nan, len(b.reached)
    b.run(1.5)
    beat = b.beat
    b.run(1.0)
    assert b.gateway.state == "FALLBACK"
    assert len(b.reached) <= n + 1
    assert b.beat > beat


def test_release_stops_the_heartbeat_and_comes_back_by_way_of_it(bench, text):
    b = bench(text.replace("policy: ramp, seconds: 2.0", "policy: release")).start()
    b.raw[0] = math.nan
    b.run(1.5)
    beat = b.beat
    b.run(1.0)
    assert b.beat == beat
    b.raw[0] = 100.0
    b.run(1.0)
    assert b.gateway.acknowledge(b.now).accepted
    assert b.gateway.state == "DEGRADED"
    b.run(1.0)
    assert (b.gateway.state, b.gateway.epoch) == ("RUN", 3)


def test_acknowledging_needs_good_samples_and_starts_a_new_epoch(bench):
    b = bench().start()
    b.raw[0] = math.nan
    b.run(4.0)
    assert not b.gateway.acknowledge(b.now).accepted
    assert not b.gateway.auto(b.now).accepted
    b.raw[0] = 100.0
    b.run(0.5)
    assert b.gateway.acknowledge(b.now).accepted
    assert (b.gateway.state, b.gateway.epoch) == ("RUN", 3)
    assert b.command(0, (0.0, 0.5)) is None
    b.flush()
    b.run(1.0)
    mine = [o for o in b.samples if o.epoch == 3]
    assert [o.k for o in mine] == list(range(10))


def test_a_short_gap_keeps_the_epoch_and_the_numbers_of_the_samples(bench):
    b = bench().start()
    last = b.samples[-1].k
    b.up = False
    b.run(0.4)
    assert b.gateway.state == "DEGRADED"
    b.up = True
    b.run(0.5)
    assert b.gateway.state == "RUN"
    assert b.gateway.epoch == 2
    later = [o for o in b.samples if o.epoch == 2 and o.k > last]
    assert [o.k for o in later] == list(range(last + 4, last + 10))  # four scans went by unseen
    assert later[0].held > 0
    assert later[-1].held == 0


def test_a_restarted_field_ends_the_record(bench):
    b = bench().start()
    b.count = 30000
    b.run(0.2)
    assert b.gateway.state == "FALLBACK"
    assert "restarted" in b.gateway.supervisor.reason


def test_the_counter_may_start_again(bench):
    b = bench()
    b.count = 65520
    b.start()
    b.run(2.0)
    assert b.gateway.state == "RUN"
    mine = [o.k for o in b.samples if o.epoch == 2]
    assert mine == list(range(len(mine)))


def test_auto_is_given_up_when_the_heartbeat_does_not_come_back(bench):
    b = bench()
    b.beats = False
    b.run(0.5)
    assert b.gateway.auto(b.now).accepted
    b.run(5.0)
    assert b.gateway.state == "SHADOW"
    assert b.reached == []


def test_auto_is_refused_while_a_tag_is_bad(bench):
    b = bench()
    b.raw[1] = math.inf
    b.run(0.5)
    answer = b.gateway.auto(b.now)
    assert not answer.accepted
    assert "y2 is BAD" in answer.message


@pytest.mark.parametrize(("reference", "goes"), [(0.1, True), (0.051, True), (0.03, False), (0.2, False)])
def test_auto_is_refused_when_the_round_trip_moved_by_half_a_sample(bench, reference, goes):
    b = bench(reference=reference)  # here the echo takes one period, 0.1 s
    b.run(0.5)
    b.gateway.auto(b.now)
    b.run(1.5)
    assert (b.gateway.state == "RUN") is goes
    if not goes:
        assert "round trip" in b.gateway.supervisor.reason
        assert b.reached == []


def test_the_round_trip_of_the_data_is_learnt_in_control(bench):
    b = bench().start()
    b.run(5.0)
    assert b.gateway.round_trip.reference == pytest.approx(0.1, abs=0.02)


def test_asking_for_shadow_stops_all_writes(bench):
    b = bench().start()
    assert b.gateway.shadow(b.now).accepted
    n, beat = len(b.reached), b.beat
    b.run(2.0)
    assert (len(b.reached), b.gateway.state) == (n, "SHADOW")
    assert b.beat <= beat + 1


def test_leaving_ramps_to_the_safe_inputs(bench):
    b = bench().start()
    b.gateway.leave(b.now)
    assert not b.gateway.settled()
    b.run(2.3)
    assert b.gateway.settled()
    np.testing.assert_array_equal(b.reached[-1][1], [0.0, 0.5])


def test_inputs_that_came_after_their_scan_are_told_by_the_echo(bench):
    """Written in time as far as the gateway can tell, but the field was faster: the sample says which inputs acted."""
    b = bench().start()
    b.run(0.1)
    k = b.samples[-1].k
    b.controller, b.pending_beat = False, b.beat  # what was just written for k+1 arrives after the next scan
    b.run(0.1)
    assert [(o.k, o.held) for o in b.samples[-2:]] == [(k, 0), (k + 1, 1)]


def test_the_first_sample_of_an_epoch_is_the_one_that_used_the_first_inputs(bench):
    b = bench()
    b.run(0.5)
    b.gateway.auto(b.now)
    b.run(1.0)
    b.command(0)
    b.flush()
    late, b.pending_beat = b.pending_beat, b.beat
    b.run(0.1)
    assert b.samples[-1].epoch == 0
    b.pending_beat = late
    b.run(0.1)
    assert (b.samples[-1].epoch, b.samples[-1].k, b.samples[-1].held) == (2, 0, 0)
