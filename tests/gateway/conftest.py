# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""A tag map, a field in memory that keeps time by hand, real fields in processes of their own, and how to wait."""

import asyncio
import os
import socket
import subprocess
import sys
import time
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from ros2_deepc.gateway import Command, Gateway, loads
from ros2_deepc.gateway.assemble import Quality, Scan

TAGS = """\
plant: {name: tank, sample_time: 0.1, prior: {n: 2, q: 2, s: 1}}
link: {kind: modbus, host: 127.0.0.1, port: 5020}
sampling: {by: scan, counter: {table: input, address: 0, type: uint16}}
supervision: {stale_after: 0.35, fallback_after: 1.0, good_samples: 3}
heartbeat:
  write: {address: 0, type: uint16}
  echo: {table: input, address: 1, type: uint16}
fallback: {policy: ramp, seconds: 2.0}
outputs:
  - {name: y1, unit: rad/s, raw_unit: mHz, scale: 0.0062831853, range: [-10, 10], at: {table: input, address: 2}}
  - {name: y2, unit: m, offset: 1.5, at: {table: input, address: 4}}
inputs:
  - {name: u1, unit: pu, limits: [-1, 1], max_rate: 5, safe: 0, at: {address: 1}}
  - {name: u2, unit: pu, limits: [-2, 2], max_rate: 40, safe: 0.5, on_violation: clamp, at: {address: 3}}
"""
TIMER = TAGS.replace("by: scan", "by: timer").replace(", counter: {table: input, address: 0, type: uint16}", "")


@pytest.fixture(scope="session")
def text():
    return TAGS


@pytest.fixture(scope="session")
def tag_map():
    return loads(TAGS)


@dataclass
class Bench:
    """A gateway and a field in memory: raw numbers, a scan counter, an echo; time moves by hand.

    Attributes:
        reached: every vector of inputs that reached the field.
    """

    gateway: Gateway
    now: float = 100.0
    count: int = 7
    beat: int = 0
    raw: list = field(default_factory=lambda: [100.0, 2.0])
    reached: list = field(default_factory=list)
    samples: list = field(default_factory=list)
    states: list = field(default_factory=list)
    quality: list = field(default_factory=lambda: [Quality.GOOD, Quality.GOOD])
    source: int | None = None
    up: bool = True
    beats: bool = True
    scanning: bool = True
    controller: bool = False
    answered: tuple = (0, -1)

    def look(self):
        """One look of the gateway at the field, and the writes that come of it."""
        g = self.gateway
        if not self.up:
            g.failed("no connection", self.now)
        else:
            counters = {"scan": self.count, "echo": self.beat, "peer": self.count}
            raw = np.array([*self.raw, *(counters[tag.name] for tag in g.tags.counters)], dtype=float)
            quality = np.array([*self.quality, *(0 for _ in g.tags.counters)], dtype=np.uint8)
            source = 0 if self.source is None else self.source
            outputs = g.scan(Scan(raw=raw, quality=quality, source_ns=np.full(len(raw), source)), self.now, 10**18)
            if outputs is not None:
                self.samples.append(outputs)
                if self.controller and outputs.epoch == g.epoch and outputs.vector.good:
                    self.command(outputs.k + 1)
            self.flush()
        if not self.states or self.states[-1][1] is not g.state:
            self.states.append((round(self.now, 6), g.state))

    def flush(self):
        g = self.gateway
        order = g.order(self.now)
        if order is None:
            return
        m = len(g.tags.inputs)
        if not np.isnan(order[:m]).any():
            self.reached.append((self.now, order[:m].copy()))
        if len(order) > m and not np.isnan(order[m]) and self.beats:
            self.pending_beat = int(order[m])
        g.wrote(order, self.now)

    def command(self, k, values=(0.1, 0.6), **changes):
        given = {"zone": "tank", "source": "controller", "epoch": self.gateway.epoch, "k": k, "values": list(values)}
        return self.gateway.command(Command(**(given | changes)), self.now)

    def run(self, seconds, period=0.1):
        """Lets the time pass: the field scans every period, the gateway looks every poll."""
        poll = self.gateway.tags.poll
        for _ in range(round(seconds / poll)):
            self.now += poll
            if self.scanning and round(self.now / poll) % round(period / poll) == 0:
                self.count = (self.count + 1) % self.gateway.tags.modulus.get("scan", 2**16)
                self.beat = getattr(self, "pending_beat", self.beat)
            self.look()

    def start(self):
        """To RUN with the first inputs written and a controller that answers every sample."""
        self.run(0.5)
        assert self.gateway.auto(self.now).accepted
        self.run(1.0)
        assert self.gateway.state == "RUN", self.gateway.supervisor.reason
        self.controller = True
        assert self.command(0) is None
        self.flush()
        self.run(0.5)
        assert self.gateway.state == "RUN"
        return self


@pytest.fixture
def bench(make_bench):
    """Makes a bench from a YAML text."""
    return make_bench


@pytest.fixture(scope="session")
def make_bench():
    """As ``bench``, for properties: each example makes its own."""

    def make(text=TAGS, **kwargs):
        return Bench(Gateway(loads(text), 100.0, **kwargs))

    return make


@pytest.fixture(scope="session")
def coarse(make_bench):
    """A bench with fewer looks, for properties."""
    return lambda: make_bench(TAGS.replace("by: scan,", "by: scan, poll: 0.025,"))


DEADLINE = 60.0  # [s] for anything that must happen; only a hung test needs it
_GLANCE = 0.002  # [s]


@pytest.fixture(scope="session")
def until():
    """Waits for a condition and returns what it returned; ``why`` explains a missed deadline."""

    def wait(condition, why=lambda: "", seconds=DEADLINE):
        end = time.monotonic() + seconds
        while not (found := condition()):
            assert time.monotonic() < end, why()
            time.sleep(_GLANCE)
        return found

    return wait


@pytest.fixture(scope="session")
def soon():
    """As ``until``, for coroutines."""

    async def wait(condition, why=lambda: "", seconds=DEADLINE):
        end = time.monotonic() + seconds
        while not (found := condition()):
            assert time.monotonic() < end, why()
            await asyncio.sleep(_GLANCE)
        return found

    return wait


@pytest.fixture(scope="session")
def free_port():
    """Finds a TCP port that nobody listens on."""

    def find():
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            return probe.getsockname()[1]

    return find


@pytest.fixture(scope="session")
def served():
    """`ros2-deepc field` in a process of its own, as a context manager; it writes the tag map ``tags``."""
    command = Path(sys.executable).parent / "ros2-deepc"
    passwords = {"FIELD_CONTROLLER_PASSWORD": "secret", "FIELD_VIEWER_PASSWORD": "look"}

    @contextmanager
    def start(plant, tags, *options, inside=()):
        arguments = [*inside, command, "field", plant, "--tags", tags, *map(str, options)]
        child = subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True, env=os.environ | passwords)
        try:
            assert any("Ctrl-C" in line for line in child.stdout), f"exit code {child.wait()}"
            yield child
        finally:
            child.kill()
            child.wait()
            child.stdout.close()

    return start


class Relay:
    """A TCP relay in front of a server; can be cut without either side being told, and keeps what went by.

    Attributes:
        heard: (from the client?, bytes), in order.
    """

    def __init__(self, port, target):
        self.port, self.target, self.cut, self.heard = port, target, False, []
        self._tasks = set()

    async def start(self):
        self.server = await asyncio.start_server(self._serve, "127.0.0.1", self.port)
        return self

    async def _serve(self, reader, writer):
        try:
            there, back = await asyncio.open_connection("127.0.0.1", self.target)
        except OSError:
            writer.close()
            return
        for asking, pair in ((True, (reader, back)), (False, (there, writer))):
            task = asyncio.create_task(self._pump(asking, *pair))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _pump(self, asking, reader, writer):
        try:
            while data := await reader.read(65536):
                if not self.cut:  # swallowed, as by a network that drops
                    self.heard.append((asking, data))
                    writer.write(data)
        except OSError:
            pass
        finally:
            writer.close()

    async def stop(self):
        self.server.close()
        tasks = list(self._tasks)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        await self.server.wait_closed()


@pytest.fixture(scope="session")
def relay():
    """Makes a relay from its port and that of the server."""
    return Relay
