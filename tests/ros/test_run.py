# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""A context of our own: what would fail deep inside DDS is said before."""

import os

import pytest

from ros2_deepc.ros import run
from ros2_deepc.ros.parameters import ConfigError


@pytest.mark.parametrize("domain", ["233", "300", "-1", "abc", "1.5"])
def test_a_domain_that_does_not_exist_is_refused_in_one_line(monkeypatch, domain):
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
    with pytest.raises(ConfigError, match=f"ROS_DOMAIN_ID = {domain}: give a whole number from 0 to 232"), run.ros([]):
        pass
    assert run.run_node(lambda **_: None, []) == 1


@pytest.mark.parametrize(("room", "transports"), [(0, None), (1 << 62, "UDPv4")])
def test_without_room_in_shared_memory_messages_take_the_network(monkeypatch, capsys, domain_id, room, transports):
    monkeypatch.setenv("FASTDDS_BUILTIN_TRANSPORTS", "")
    monkeypatch.delenv("FASTDDS_BUILTIN_TRANSPORTS")
    monkeypatch.setattr(run, "_ROOM", room)
    with run.ros([], domain_id):
        assert os.environ.get("FASTDDS_BUILTIN_TRANSPORTS") == transports
    assert ("no room in /dev/shm" in capsys.readouterr().err) == bool(transports)
