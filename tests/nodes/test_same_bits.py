# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""One seed, the same bits: without ROS, with either executor, and with one process a node."""

import numpy as np
import pytest

from ros2_deepc.bags.replay import replay
from ros2_deepc.bags.run import loop_hash
from ros2_deepc.demo import SETTINGS
from ros2_deepc.nodes.config import load
from ros2_deepc.nodes.replaying import cores


def seeds(seed, steps=130):
    return {"plant": {"seed": seed, "steps": steps}, "controller": {"seed": seed}}


@pytest.mark.parametrize(("plant", "seed"), [("wscc9", 0), ("wscc9", 7), ("net3", 0)])
def test_the_loop_is_the_same_to_the_bit(demo, pure_loop, parameters_of, plant, seed):
    pure = pure_loop(parameters_of(plant, seeds(seed)))
    expected = loop_hash(pure.u, pure.y)

    events, recorded, *folders = demo(plant, name="events", changes=seeds(seed))
    single, _, folder = demo(plant, name="single", changes=seeds(seed), executor="single")
    processes, _, other = demo(plant, name="processes", changes=seeds(seed), processes=True)

    assert [events["loop_hash"], single["loop_hash"], processes["loop_hash"]] == [expected] * 3
    np.testing.assert_array_equal(recorded.u, pure.u)
    np.testing.assert_array_equal(recorded.y, pure.y)
    assert [d.mode for d in pure.decisions] == list(recorded.mode)
    for out in (*folders, folder, other):  # every bag gives the same commands, states and reports again
        again = replay(out / "bag", cores(load(out / SETTINGS)))
        assert again.same, (again.differences, again.unmatched)
        assert again.compared == {"inputs": 131, "controller/state": 130, "monitor/report": 13}
        assert again.loop_hash == expected


def test_another_seed_gives_another_loop(pure_loop, parameters_of):
    hashes = set()
    for seed in range(3):
        loop = pure_loop(parameters_of("wscc9", seeds(seed, 20)))
        hashes.add(loop_hash(loop.u, loop.y))
    assert len(hashes) == 3
