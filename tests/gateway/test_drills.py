# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""A real server that is killed, restarted, cut off or wrong: states, commands, and recovery without a restart."""

import asyncio
import subprocess
import sys
import time

import numpy as np
import pytest

from ros2_deepc.gateway import Command, Gateway, loads
from ros2_deepc.gateway.engine import Engine
from ros2_deepc.gateway.field import Device, find_plant
from ros2_deepc.gateway.field_tags import modbus_places, tag_map
from ros2_deepc.gateway.link import make_link

pytest.importorskip("pymodbus")

PERIOD = 0.05
STALE, FALLBACK, RAMP = 0.4, 0.5, 0.2
U = (0.25, -0.25, 0.5)


class Relay:
    """A TCP relay in front of the field that can be cut without either side being told."""

    def __init__(self, port, target):
        self.port, self.target, self.cut = port, target, False
        self._tasks = set()

    async def start(self):
        self.server = await asyncio.start_server(self._serve, "127.0.0.1", self.port)

    async def _serve(self, reader, writer):
        try:
            there, back = await asyncio.open_connection("127.0.0.1", self.target)
        except OSError:
            writer.close()
            return
        for pair in ((reader, back), (there, writer)):
            task = asyncio.create_task(self._pump(*pair))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _pump(self, reader, writer):
        try:
            while data := await reader.read(4096):
                if not self.cut:  # swallowed, as by a network that drops
                    writer.write(data)
        except OSError:
            pass
        finally:
            writer.close()

    async def stop(self):
        self.server.close()
        for task in list(self._tasks):
            task.cancel()
        await asyncio.sleep(0.02)


class Drill:
    """A field, a relay, a gateway and a controller that always wants the same."""

    def __init__(self, ports):
        from ros2_deepc.gateway.field_modbus import ModbusField

        self.field_port, self.port = ports
        self.plant = find_plant("wscc9", {})
        self.make = lambda device: ModbusField(device, "127.0.0.1", self.field_port, "float64", PERIOD)
        link = f"{{kind: modbus, host: 127.0.0.1, port: {self.port}, timeout: 0.1}}"
        text = tag_map(self.plant, link, modbus_places("float64"), registered="wscc9", options={}, speed=0.1 / PERIOD)
        text = text.replace("seconds: 1}", f"seconds: {RAMP}}}").replace("max_rate: 40", "max_rate: 80")
        text += f"supervision: {{stale_after: {STALE}, fallback_after: {FALLBACK}}}\n"
        self.gateway = Gateway(loads(text), time.monotonic())
        self.engine = Engine(
            self.gateway, make_link(self.gateway.tags), on_outputs=self.on_outputs, on_look=self.on_look
        )
        self.states, self.silent, self.started = [], False, 0

    def on_look(self):
        if not self.states or self.states[-1][1] is not self.gateway.state:
            self.states.append((time.monotonic(), self.gateway.state, self.gateway.supervisor.reason))
        if self.gateway.state == "RUN" and self.started != self.gateway.epoch:
            self.started = self.gateway.epoch
            asyncio.get_running_loop().call_soon(self.command, 0)

    def on_outputs(self, outputs):
        if outputs.epoch and not self.silent and outputs.vector.good:
            asyncio.get_running_loop().call_soon(self.command, outputs.k + 1)

    def command(self, k):
        self.engine.command(Command(zone="wscc9", source="controller", epoch=self.gateway.epoch, k=k, values=U))

    async def start_field(self, device=None):
        self.device = device or Device(self.plant, watchdog=5.0)
        self.field = self.make(self.device)
        self.serving = asyncio.create_task(self.field.run())
        await asyncio.sleep(0.1)

    async def kill_field(self):
        self.serving.cancel()
        await self.serving

    async def until(self, condition, seconds=20.0):
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, (
                self.gateway.state,
                self.gateway.supervisor.reason,
                self.gateway.guard.reason,
            )
            await asyncio.sleep(0.005)

    async def into_run(self):
        self.relay = Relay(self.port, self.field_port)
        await self.relay.start()
        await self.start_field()
        self.running = asyncio.create_task(self.engine.run())
        await self.until(lambda: self.gateway._good > 3)
        assert self.gateway.auto(time.monotonic()).accepted
        await self.until(lambda: tuple(self.device.u) == U and self.gateway.state == "RUN")

    async def acknowledged(self):
        await self.until(lambda: self.gateway.acknowledge(time.monotonic()).accepted)
        await self.until(lambda: self.gateway.state == "RUN" and tuple(self.device.u) == U)

    def since(self, start, state):
        return next(t for t, s, _ in self.states if t >= start and s == state) - start

    async def end(self):
        await self.engine.leave()
        await self.running
        await self.kill_field()
        await self.relay.stop()


@pytest.fixture
def drill(free_port):
    """Runs a drill: a coroutine that gets a gateway in RUN."""

    def run(play):
        async def whole():
            d = Drill((free_port(), free_port()))
            await d.into_run()
            await play(d)
            await d.end()

        asyncio.run(whole())

    return run


def test_a_server_killed_for_long_and_restarted(drill):
    async def play(d):
        start = time.monotonic()
        await d.kill_field()
        await d.until(lambda: d.gateway.state == "FALLBACK")
        assert d.since(start, "DEGRADED") < STALE + PERIOD
        assert d.since(start, "FALLBACK") >= FALLBACK
        await d.start_field()
        await d.until(lambda: (d.device.u == 0).all() and d.device.echo)  # the ramp ends at the safe inputs
        assert d.gateway.state == "FALLBACK"
        await d.acknowledged()
        assert d.gateway.epoch == 3

    drill(play)


def test_a_server_restarted_quickly_ends_the_record_because_its_counter_jumps(drill):
    async def play(d):
        await d.until(lambda: d.device.count > 40)
        await d.kill_field()
        await d.start_field()
        await d.until(lambda: d.gateway.state == "FALLBACK")
        assert "restarted" in d.gateway.supervisor.reason
        await d.acknowledged()

    drill(play)


def test_a_short_cut_of_the_network_is_survived_in_the_same_epoch(drill):
    async def play(d):
        d.relay.cut = True
        await d.until(lambda: d.gateway.state == "DEGRADED")
        d.relay.cut = False
        await d.until(lambda: d.gateway.state == "RUN")
        assert d.gateway.epoch == 2
        assert tuple(d.device.u) == U  # held all the time

    drill(play)


def test_a_controller_that_stops_ramps_the_field_down(drill):
    async def play(d):
        start = time.monotonic()
        d.silent = True
        await d.until(lambda: d.gateway.state == "FALLBACK")
        assert d.since(start, "DEGRADED") >= STALE - PERIOD
        await d.until(lambda: (d.device.u == 0).all())
        d.silent = False
        await d.acknowledged()

    drill(play)


def test_garbage_in_one_register_degrades_and_never_reaches_a_good_sample(drill):
    async def play(d):
        normal = d.device._stepper.push
        d.device._stepper.push = lambda u: np.array([np.nan, 1e300]) if normal(u) is not None else None
        await d.until(lambda: d.gateway.state == "DEGRADED")
        assert "BAD" in d.gateway.supervisor.reason
        d.device._stepper.push = normal
        await d.until(lambda: d.gateway.state in ("RUN", "FALLBACK"))

    drill(play)


def test_the_field_takes_over_when_the_gateway_dies(free_port, tmp_path):
    """The gateway is killed without a word; the watchdog of the field brings its inputs to 0."""

    async def play():
        d = Drill((free_port(), free_port()))
        d.relay = Relay(d.port, d.field_port)
        await d.relay.start()
        await d.start_field(Device(d.plant, watchdog=0.5))
        tags = tmp_path / "tags.yaml"
        link = f"{{kind: modbus, host: 127.0.0.1, port: {d.port}}}"
        tags.write_text(tag_map(d.plant, link, modbus_places("float64"), registered="wscc9", options={}, speed=2.0))
        child = subprocess.Popen([sys.executable, "-c", CHILD, str(tags)])
        try:
            await d.until(lambda: tuple(d.device.u) == U, 60.0)
            child.kill()
            start = time.monotonic()
            await d.until(lambda: (d.device.u == 0).all())
            assert d.device.local
            assert time.monotonic() - start > 0.3
        finally:
            child.kill()
            child.wait()
        await d.kill_field()
        await d.relay.stop()

    asyncio.run(play())


CHILD = """
import sys, time
from pymodbus.client import ModbusTcpClient
from ros2_deepc.gateway import load
from ros2_deepc.gateway.modbus_codec import encode
from pathlib import Path
link = load(Path(sys.argv[1])).link
client = ModbusTcpClient(link.host, port=link.port)
client.connect()
for beat in range(1, 10000):
    client.write_registers(0, [beat, *encode([0.25, -0.25, 0.5], "float64")])
    time.sleep(0.05)
"""
