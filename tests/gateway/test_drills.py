# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""A real server that is killed, restarted, cut off, silent or wrong: states and their times, commands, and recovery
without a restart of the gateway."""

import asyncio
import os
import subprocess
import sys
import time
from datetime import UTC, datetime, timedelta

import pytest

from ros2_deepc.gateway import Command, Gateway, loads
from ros2_deepc.gateway.engine import Engine
from ros2_deepc.gateway.field import Device, every, find_plant
from ros2_deepc.gateway.field_tags import modbus_places, tag_map
from ros2_deepc.gateway.link import make_link

pytest.importorskip("pymodbus")
pytest.importorskip("asyncua")

PERIOD, RAMP = 0.05, 0.2
STALE, FALLBACK = 0.4, 0.5
PATIENT = 60.0  # a fallback_after that no drill reaches: what recovers in time must not depend on the machine's load
U = [0.25, -0.25, 0.5]


class Watched(Gateway):
    """Keeps a log of every look at the time: (now, state, seconds without a sample, seconds without a command)."""

    def __init__(self, *args):
        super().__init__(*args)
        self.log = []

    def tick(self, now):
        super().tick(now)
        self.log.append((now, self.state, now - self._sampled_at, now - self._commanded_at))

    def entered(self, state, after=0):
        """Index in the log at which a state was entered."""
        return next(i for i in range(after + 1, len(self.log)) if self.log[i][1] == state != self.log[i - 1][1])

    def fell_back_in_time(self, fallback, after=0):
        """FALLBACK came with the first look in DEGRADED that was late enough after the last one in RUN, not before."""
        i = self.entered("FALLBACK", after)
        degraded = max(j for j in range(i) if self.log[j][1] == "RUN") + 1
        well = self.log[degraded - 1][0]
        soonest = all(now - well <= fallback for now, *_ in self.log[degraded + 1 : i])
        return soonest and self.log[i][0] - well > fallback


class Drill:
    """A gateway and a controller that always wants the same; what the field has been told is read back as outputs."""

    def __init__(self, text, soon, folder="."):
        self.gateway = Watched(loads(text, f"{folder}/tags.yaml"), time.monotonic())
        self.engine = Engine(
            self.gateway, make_link(self.gateway.tags), on_outputs=self.on_outputs, on_look=self.on_look
        )
        self.soon, self.silent, self.started, self.told, self.samples = soon, False, 0, None, []

    def on_look(self):
        if self.gateway.state == "RUN" and self.started != self.gateway.epoch:
            self.started = self.gateway.epoch
            asyncio.get_running_loop().call_soon(self.command, 0)

    def on_outputs(self, outputs):
        self.samples.append(outputs)
        self.told = outputs.vector.values[-3:].tolist()
        if outputs.epoch and not self.silent and outputs.vector.good:
            asyncio.get_running_loop().call_soon(self.command, outputs.k + 1)

    def command(self, k):
        self.engine.command(Command(zone="wscc9", source="controller", epoch=self.gateway.epoch, k=k, values=U))

    async def until(self, condition):
        gateway = self.gateway
        why = lambda: (gateway.state, gateway.supervisor.reason, gateway.guard.reason, self.told)  # noqa: E731
        return await self.soon(condition, why)

    async def state(self, state, reason=""):
        await self.until(lambda: self.gateway.state == state and reason in self.gateway.supervisor.reason)

    async def into_run(self):
        self.running = asyncio.create_task(self.engine.run())
        await self.until(self._in_control)
        self.epoch = self.gateway.epoch

    async def acknowledged(self):
        await self.until(self._in_control)
        assert self.gateway.epoch > self.epoch

    def _in_control(self):
        """Asks for it as often as it takes: a loaded machine may lose it again on the way."""
        if self.gateway.state == "SHADOW":
            self.gateway.auto(time.monotonic())
        elif self.gateway.state == "FALLBACK":
            self.gateway.acknowledge(time.monotonic())
        return self.gateway.state == "RUN" and self.told == U

    async def end(self):
        await self.engine.leave()
        await self.running


def drill_map(text, places, fallback=FALLBACK):
    """The tag map of a served wscc9 for drills: the inputs are read back, a short ramp, the drill's times."""
    back = "".join(f"  - {{name: told{i}, unit: pu, at: {places('input', i)}}}\n" for i in range(3))
    changes = [
        ("inputs:\n", f"{back}inputs:\n"),
        ("max_rate: 40", "max_rate: 80"),
        ("seconds: 1}", f"seconds: {RAMP}}}"),
    ]
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    return text + f"supervision: {{stale_after: {STALE}, fallback_after: {fallback}}}\n"


def places_of(protocol):
    from ros2_deepc.gateway.field_opcua import opcua_places

    return modbus_places("float64") if protocol == "modbus" else opcua_places(find_plant("wscc9", {}))


@pytest.mark.parametrize("protocol", ["modbus", "opcua"])
def test_a_server_killed_and_started_again_on_its_port(protocol, served, free_port, soon, tmp_path):
    """kill -9 of a process. What comes back gets its heartbeat and the safe inputs; control only when acknowledged."""
    tags = tmp_path / "tags.yaml"
    options = (f"--{protocol}", "--port", free_port(), "--speed", 0.1 / PERIOD)

    async def play(first):
        d = Drill(drill_map(tags.read_text(), places_of(protocol)), soon)
        await d.into_run()
        lost = len(d.gateway.log)
        first.kill()
        await d.state("FALLBACK")
        assert d.gateway.fell_back_in_time(FALLBACK, lost)
        await asyncio.to_thread(again.__enter__)
        try:
            n = len(d.samples)
            await d.until(lambda: d.gateway.settled() and len(d.samples) > n + 3)
            assert d.told == [0.0, 0.0, 0.0]
            assert d.gateway.state == "FALLBACK", "latched"
            await d.acknowledged()
            await d.end()
        finally:
            again.__exit__(None, None, None)

    with served("wscc9", tags, *options) as first:
        again = served("wscc9", tags, *options)
        asyncio.run(play(first))


@pytest.fixture
def drill(free_port, soon, relay):
    """Runs a drill with a field in this process, behind a relay: a coroutine that gets both in RUN."""
    from ros2_deepc.gateway.field_modbus import ModbusField

    class Field:
        def __init__(self, port):
            self.plant, self.port = find_plant("wscc9", {}), port

        def start(self):
            self.device = Device(self.plant, watchdog=PATIENT)
            self.serving = asyncio.create_task(
                ModbusField(self.device, "127.0.0.1", self.port, "float64", PERIOD).run()
            )

        async def stop(self):
            self.serving.cancel()
            await self.serving

    def run(play, fallback=FALLBACK):
        async def whole():
            between = relay(free_port(), free_port())
            field = Field(between.target)
            link = f"{{kind: modbus, host: 127.0.0.1, port: {between.port}, timeout: 0.1}}"
            places = modbus_places("float64")
            text = tag_map(field.plant, link, places, registered="wscc9", options={}, speed=0.1 / PERIOD)
            d = Drill(drill_map(text, places, fallback), soon)
            field.start()
            await between.start()
            await d.into_run()
            await play(d, field, between)
            await d.end()
            await field.stop()
            await between.stop()

        asyncio.run(whole())

    return run


def test_a_server_restarted_quickly_ends_the_record_because_its_counter_jumps(drill):
    async def play(d, field, between):
        await d.until(lambda: field.device.count > 10)
        await field.stop()
        field.start()
        await d.state("FALLBACK", "restarted")
        await d.acknowledged()

    drill(play, PATIENT)


def test_a_short_cut_of_the_network_is_survived_in_the_same_epoch(drill):
    async def play(d, field, between):
        between.cut = True
        await d.state("DEGRADED")
        between.cut = False
        await d.state("RUN")
        assert d.gateway.epoch == d.epoch
        assert field.device.u.tolist() == U  # held all the time

    drill(play, PATIENT)


def test_a_long_cut_of_the_network_falls_back_and_recovers(drill):
    async def play(d, field, between):
        lost = len(d.gateway.log)
        between.cut = True
        await d.state("FALLBACK")
        assert d.gateway.fell_back_in_time(FALLBACK, lost)
        assert field.device.u.tolist() == U
        between.cut = False
        await d.until(lambda: not field.device.u.any())  # the ramp of the fallback arrives late, but it does
        await d.acknowledged()

    drill(play)


def test_a_controller_that_stops_ramps_the_field_down(drill):
    async def play(d, field, between):
        lost = len(d.gateway.log)
        d.silent = True
        await d.state("FALLBACK", "no command")
        log, i = d.gateway.log, d.gateway.entered("DEGRADED", lost)
        assert log[i - 1][3] <= STALE < log[i][3]
        assert d.gateway.fell_back_in_time(FALLBACK, lost)
        await d.until(lambda: not field.device.u.any())
        d.silent = False
        await d.acknowledged()

    drill(play)


def test_a_field_that_stops_scanning_is_noticed_after_the_configured_time(drill):
    async def play(d, field, between):
        lost = len(d.gateway.log)
        scan, field.device.scan = field.device.scan, lambda *_: None
        await d.state("DEGRADED", "no sample")
        log, i = d.gateway.log, d.gateway.entered("DEGRADED", lost)
        assert log[i - 1][2] <= STALE < log[i][2]
        field.device.scan = scan
        await d.state("RUN")
        assert d.gateway.epoch == d.epoch

    drill(play, PATIENT)


class Puppet:
    """An OPC UA server that scans like a field, and lies on request."""

    def __init__(self, port):
        from ros2_deepc.gateway.opcua_server import Access, OpcuaServer

        self.server = OpcuaServer("puppet", "urn:puppet", f"opc.tcp://127.0.0.1:{port}", Access())
        self.clock, self.stuck, self.y1, self.status, self.count = timedelta(0), False, None, 0, 0

    async def run(self):
        start = {"count": 0, "echo": 0, "beat": 0} | dict.fromkeys(("y1", "y2", "u0", "u1", "u2"), 0.0)
        await self.server.start(start, ["beat", "u0", "u1", "u2"])
        try:
            await every(PERIOD, self._scan)
        finally:
            await self.server.stop()

    async def _scan(self, _now):
        self.count += 1
        when = datetime.now(tz=UTC).replace(tzinfo=None) + self.clock
        if not self.stuck:
            y1 = float(self.count) if self.y1 is None else self.y1
            await self.server.put("y1", y1, status=self.status, time=when)
        for name, value in {"y2": 2.0, "echo": self.server.get("beat"), "count": self.count}.items():
            await self.server.put(name, value, time=when)
        for i in range(3):
            await self.server.put(f"u{i}", self.server.get(f"u{i}"), time=when)

    @staticmethod
    def tags(port):
        at = "{{node: 'nsu=urn:puppet;s={}'}}".format
        inputs = "".join(
            f"  - {{name: u{i}, unit: '', limits: [-1, 1], max_rate: 99, safe: 0, at: {at(f'u{i}')}}}\n"
            for i in range(3)
        )
        return f"""\
plant: {{name: wscc9, sample_time: {PERIOD}}}
link: {{kind: opcua, url: 'opc.tcp://127.0.0.1:{port}', allow_insecure_loopback: true, timeout: 5}}
sampling: {{by: scan, counter: {at("count")}}}
heartbeat: {{write: {{node: 'nsu=urn:puppet;s=beat', type: UInt32}}, echo: {at("echo")}}}
supervision: {{stale_after: {STALE}, fallback_after: {PATIENT}}}
outputs:
  - {{name: y1, unit: '', range: [-1000000, 1000000], frozen_after: 0.5, at: {at("y1")}}}
  - {{name: y2, unit: '', at: {at("y2")}}}
{"".join(f"  - {{name: told{i}, unit: '', at: {at(f'u{i}')}}}" + chr(10) for i in range(3))}inputs:
{inputs}"""


LIES = [  # what the server does; what the gateway says of it; quality of y1
    ({"stuck": True}, "y1 is STALE: no news for 0.4 s", 2),
    ({"y1": 7.0}, "y1 is UNCERTAIN", 1),
    ({"y1": float("nan")}, "y1 is BAD: not a number", 3),
    ({"y1": 1e300}, "y1 is BAD: outside", 3),
    ({"status": 0x40920000}, "y1 is UNCERTAIN", 1),  # UncertainSubNormal
    ({"status": 0x808B0000}, "y1 is BAD", 3),  # BadDeviceFailure
]


def test_an_opcua_server_that_lies(soon, free_port):
    """One tag stale, frozen, garbage or flagged: DEGRADED, no such value in a GOOD entry. A wrong clock: no change."""
    port = free_port()

    async def play():
        puppet = Puppet(port)
        serving = asyncio.create_task(puppet.run())
        d = Drill(Puppet.tags(port), soon)
        await d.into_run()
        for lie, reason, quality in LIES:
            n = len(d.samples)
            vars(puppet).update(lie)
            await d.state("DEGRADED", reason)
            assert d.samples[-1].vector.quality[:2].tolist() == [quality, 0]
            assert not any(x.vector.quality[0] == 0 and abs(x.vector.values[0]) > 1e6 for x in d.samples[n:])
            vars(puppet).update(stuck=False, y1=None, status=0)
            await d.state("RUN")
        for hours in (1, -24 * 365 * 40):
            puppet.clock = timedelta(hours=hours)
            n = len(d.samples)
            await d.until(lambda n=n: len(d.samples) > n + 3)
            assert abs(d.gateway.assembler.clock_error) > 3000
            assert all(abs(x.vector.stamp_ns - time.time_ns()) < 60e9 for x in d.samples[n:])
            assert all(x.vector.good for x in d.samples[n:])
        puppet.stuck = True  # a clock that is wrong does not hide a tag without news
        await d.state("DEGRADED", "y1 is STALE")
        puppet.stuck, puppet.clock = False, timedelta(0)
        await d.state("RUN")
        assert d.gateway.epoch == d.epoch
        await d.end()
        serving.cancel()
        await asyncio.gather(serving, return_exceptions=True)

    asyncio.run(play())


@pytest.fixture
def island():
    """A network namespace with one cable to here: (command prefix, its address, a function that plugs and unplugs)."""
    name, near, far = (f"{kind}{os.getpid() % 100000}" for kind in ("dpc", "dpa", "dpb"))
    net = f"10.213.{os.getpid() % 250}"

    def ip(*arguments):
        subprocess.run(["ip", *arguments], check=True, capture_output=True)

    try:
        ip("netns", "add", name)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("network namespaces cannot be made here: needs iproute2 and CAP_SYS_ADMIN")
    try:
        ip("link", "add", near, "type", "veth", "peer", "name", far, "netns", name)
        ip("addr", "add", f"{net}.1/24", "dev", near)
        ip("link", "set", near, "up")
        inside = ("ip", "netns", "exec", name)
        ip("-n", name, "addr", "add", f"{net}.2/24", "dev", far)
        ip("-n", name, "link", "set", far, "up")
        yield inside, f"{net}.2", lambda plugged: ip("link", "set", near, "up" if plugged else "down")
    finally:
        ip("netns", "del", name)


@pytest.mark.parametrize("protocol", ["modbus", "opcua"])
def test_a_cable_that_is_pulled(protocol, island, served, free_port, soon, tmp_path, monkeypatch):
    """Half-open connections: nothing is refused, nothing answers. OPC UA is encrypted here, as beyond any loopback."""
    inside, address, plug = island
    tags, options = tmp_path / "tags.yaml", (f"--{protocol}", "--host", address, "--speed", 0.1 / PERIOD)
    if protocol == "opcua":
        from ros2_deepc.gateway.field_opcua import URI as FIELD_URI
        from ros2_deepc.gateway.opcua_link import URI
        from ros2_deepc.gateway.opcua_pki import Pki

        monkeypatch.setenv("FIELD_CONTROLLER_PASSWORD", "secret")
        server, client = Pki(tmp_path / "field", FIELD_URI), Pki(tmp_path / "pki", URI)
        server.trust(client.certificate)
        client.trust(server.certificate)
        options = (*options, "--pki", tmp_path / "field")

    async def play():
        text = tags.read_text().replace("link: {", "link: {timeout: 0.2, ")
        d = Drill(drill_map(text, places_of(protocol)), soon, tmp_path)
        await d.into_run()
        lost = len(d.gateway.log)
        plug(False)
        await d.state("FALLBACK")
        assert d.gateway.fell_back_in_time(FALLBACK, lost)
        plug(True)
        await d.until(lambda: d.told == [0.0, 0.0, 0.0])
        await d.acknowledged()
        await d.end()

    with served("wscc9", tags, *options, inside=inside):
        asyncio.run(play())


def test_the_field_takes_over_when_the_gateway_dies(free_port, tmp_path, soon):
    """The gateway is killed without a word; the watchdog of the field brings its inputs to 0."""
    from ros2_deepc.gateway.field_modbus import ModbusField

    async def play():
        port, device = free_port(), Device(find_plant("wscc9", {}), watchdog=0.5)
        serving = asyncio.create_task(ModbusField(device, "127.0.0.1", port, "float64", PERIOD).run())
        child = subprocess.Popen([sys.executable, "-c", WRITER, str(port)])
        try:
            await soon(lambda: device.u.tolist() == U)
            child.kill()
            child.wait()
            beat = device._beat_at
            await soon(lambda: not device.u.any())
            assert device.local
            assert time.monotonic() - beat > 0.5
        finally:
            child.kill()
            child.wait()
        serving.cancel()
        await serving

    asyncio.run(play())


WRITER = """
import sys, time
from pymodbus.client import ModbusTcpClient
from ros2_deepc.gateway.modbus_codec import encode
client = ModbusTcpClient("127.0.0.1", port=int(sys.argv[1]))
while not client.connect():
    pass
for beat in range(1, 65536):
    client.write_registers(0, [beat, *encode([0.25, -0.25, 0.5], "float64")])
    time.sleep(0.05)
"""
