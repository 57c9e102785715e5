# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Links against servers: what is read and written, what is refused, what happens to garbage."""

import asyncio

import numpy as np
import pytest

from ros2_deepc.gateway import GatewayError, LinkError, loads
from ros2_deepc.gateway.field import Device, find_plant
from ros2_deepc.gateway.field_tags import modbus_places, tag_map
from ros2_deepc.gateway.link import make_link


@pytest.fixture
def plant():
    return find_plant("wscc9", {})


class TestModbus:
    @pytest.fixture
    def served(self, plant, free_port, soon):
        """A tag map and a running field, as a function of what to do with the link."""
        pytest.importorskip("pymodbus")
        from ros2_deepc.gateway.field_modbus import ModbusField

        port = free_port()
        text = tag_map(plant, f"{{kind: modbus, host: 127.0.0.1, port: {port}}}", modbus_places("float32"),
                       registered="wscc9", options={}, speed=10.0)  # fmt: skip

        def run(use, change=lambda t: t):
            async def both():
                device = Device(plant)
                field = ModbusField(device, "127.0.0.1", port, "float32", 0.01)
                running = asyncio.create_task(field.run())
                await soon(lambda: device.count)
                link = make_link(loads(change(text)))
                try:
                    return await use(link, device, field)
                finally:
                    await link.close()
                    running.cancel()
                    await running

            return asyncio.run(both())

        return run

    def test_reads_in_one_request_and_writes_in_one(self, served, soon):
        async def use(link, device, field):
            writes = []
            field.registers._on_write = lambda *where: writes.append(where)
            await link.connect()
            assert link.atomic
            await link.write(np.array([0.25, -0.5, 0.75, 9.0]))
            await soon(lambda: field.registers.tables["input"][1] == 9)
            scan = await link.read()
            return scan, writes, device

        scan, writes, device = served(use)
        assert writes == [(0, 7)]
        np.testing.assert_array_equal(device.u, [0.25, -0.5, 0.75])
        np.testing.assert_allclose(scan.raw[:2], device.y, rtol=0.2)
        assert scan.raw[3] == 9.0
        assert not scan.quality.any()

    def test_registers_that_are_not_there_are_refused_by_name(self, served):
        async def use(link, device, field):
            await link.connect()
            with pytest.raises(LinkError, match="refused with exception 2"):
                await link.read()
            return field.registers.refused

        assert served(use, lambda t: t.replace("address: 4,", "address: 400,")) == 1

    @pytest.mark.parametrize("code", [1, 2, 5, 15, 22, 23])
    def test_functions_beyond_the_allow_list_are_refused(self, served, code):
        from pymodbus.client import AsyncModbusTcpClient

        async def use(link, device, field):
            client = AsyncModbusTcpClient("127.0.0.1", port=link._link.port, retries=0, timeout=2)
            await client.connect()
            requests = {
                1: lambda: client.read_coils(0), 2: lambda: client.read_discrete_inputs(0),
                5: lambda: client.write_coil(0, True), 15: lambda: client.write_coils(0, [True]),
                22: lambda: client.mask_write_register(address=0, and_mask=0, or_mask=1),
                23: lambda: client.readwrite_registers(read_address=0, read_count=1, address=0, values=[1]),
            }  # fmt: skip
            before = field.registers.tables["holding"].copy()
            answer = await requests[code]()
            client.close()
            assert answer.isError()
            np.testing.assert_array_equal(field.registers.tables["holding"], before)

        served(use)

    def test_nobody_there(self, plant, free_port):
        pytest.importorskip("pymodbus")
        text = tag_map(plant, f"{{kind: modbus, host: 127.0.0.1, port: {free_port()}}}", modbus_places("float32"),
                       registered="wscc9", options={})  # fmt: skip
        link = make_link(loads(text))
        with pytest.raises(LinkError, match="no connection"):
            asyncio.run(link.connect())


class Opcua:
    """One server for all tests here, in a thread of its own, since it takes seconds to start.

    Attributes:
        text: a tag map for the user controller.
        counts: what the server refused so far.
    """

    def __init__(self, folder, port, until):
        from ros2_deepc.gateway.field_opcua import URI, OpcuaField, opcua_places, writable
        from ros2_deepc.gateway.loop_thread import LoopThread
        from ros2_deepc.gateway.opcua_link import URI as CLIENT
        from ros2_deepc.gateway.opcua_pki import Pki
        from ros2_deepc.gateway.opcua_server import Access

        plant, url = find_plant("wscc9", {}), f"opc.tcp://127.0.0.1:{port}"
        link = f"{{kind: opcua, url: '{url}', user: controller, password_env: PASSWORD, timeout: 5}}"
        self.text = tag_map(plant, link, opcua_places(plant), registered="wscc9", options={}, speed=5.0)
        self.folder = folder
        self.ours, self.theirs = Pki(folder / "pki", CLIENT), Pki(folder / "field", URI)
        self.ours.trust(self.theirs.certificate)
        access = Access(
            users={"controller": "secret", "viewer": "look"},
            writes={"controller": writable(plant)}, pki=folder / "field",
        )  # fmt: skip
        self.device = Device(plant, watchdog=1e9)
        self.field = OpcuaField(self.device, url, access, 0.02)
        self.counts = self.field.server.refused
        self.thread = LoopThread(print)
        self.thread.start(self.field.run())
        until(lambda: self.device.count > 2)

    def trusted(self, yes):
        for path in (self.folder / "field" / "trusted").glob("*.der"):
            path.unlink()
        if yes:
            self.theirs.trust(self.ours.certificate)

    def use(self, play, change=lambda t: t):
        """Runs a coroutine function with a link."""

        async def whole():
            link = make_link(loads(change(self.text), str(self.folder / "tags.yaml")))
            try:
                return await play(link)
            finally:
                await link.close()

        return asyncio.run(whole())


@pytest.fixture(scope="module")
def opcua_server(tmp_path_factory, free_port, until):
    pytest.importorskip("asyncua")
    server = Opcua(tmp_path_factory.mktemp("opcua"), free_port(), until)
    yield server
    server.thread.stop()


@pytest.fixture
def opcua(opcua_server, monkeypatch):
    """The server, trusting the client, with the right password at hand."""
    monkeypatch.setenv("PASSWORD", "secret")
    opcua_server.trusted(True)
    return opcua_server


USER = "user: controller, password_env: PASSWORD"
WANTED = np.array([0.25, -0.5, 0.75, 9.0])


async def connects(link):
    await link.connect()


async def writes(link):
    await link.connect()
    with pytest.raises(LinkError, match="BadUserAccessDenied"):
        await link.write(WANTED)


class TestOpcua:
    def test_nothing_that_is_refused_reaches_the_field(self, opcua, monkeypatch):
        """Wrong password, nobody, no encryption, a viewer, a node off the list, a certificate that nobody trusts."""
        before = opcua.device.echo
        monkeypatch.setenv("PASSWORD", "guess")
        with pytest.raises(LinkError, match=r"BadUserAccessDenied|BadIdentityTokenRejected"):
            opcua.use(connects)
        assert opcua.counts["user"] > 0
        with pytest.raises(LinkError, match=r"Bad|[Ii]dentity|token|policy"):
            opcua.use(connects, lambda t: t.replace(f", {USER}", ""))
        with pytest.raises(LinkError):
            opcua.use(
                connects,
                lambda t: t.replace("user: controller, password_env: PASSWORD", "allow_insecure_loopback: true"),
            )
        monkeypatch.setenv("PASSWORD", "look")
        opcua.use(writes, lambda t: t.replace("user: controller", "user: viewer"))
        monkeypatch.setenv("PASSWORD", "secret")
        opcua.use(writes, lambda t: t.replace("s=in/P12", "s=out/x1"))
        assert opcua.counts["node"] == 2
        opcua.trusted(False)
        with pytest.raises(LinkError, match="Bad"):
            opcua.use(connects)
        assert opcua.counts["certificate"] > 0
        assert len(list((opcua.folder / "field" / "rejected").glob("*.der"))) == 1
        assert opcua.device.echo == before

    def test_reads_and_writes_encrypted(self, opcua, soon):
        async def play(link):
            await link.connect()
            await link.write(WANTED)
            await soon(lambda: opcua.device.echo == 9 and opcua.field.server.get("echo") == 9)
            assert link._client.security_policy.URI.endswith("Basic256Sha256")
            return await link.read()

        scan = opcua.use(play)
        np.testing.assert_array_equal(opcua.device.u, WANTED[:3])
        assert scan.raw[3] == 9.0
        assert (scan.source_ns > 1.7e18).all()

    def test_a_server_that_is_not_trusted_gets_no_password(self, opcua):
        trusted = opcua.folder / "pki" / "trusted"
        before = dict(opcua.counts)
        trusted.rename(opcua.folder / "elsewhere")
        trusted.mkdir()
        try:
            with pytest.raises(LinkError, match="not trusted"):
                opcua.use(connects)
        finally:
            trusted.rmdir()
            (opcua.folder / "elsewhere").rename(trusted)
        assert opcua.counts == before
        assert len(list((opcua.folder / "pki" / "rejected").glob("*.der"))) == 1

    def test_a_node_that_does_not_exist_is_named(self, opcua):
        with pytest.raises(LinkError, match=r"there is no node .*out/nosuch"):
            opcua.use(connects, lambda t: t.replace("s=out/x1", "s=out/nosuch"))

    def test_a_password_that_is_not_set_is_said_before_anything_runs(self, opcua, monkeypatch):
        monkeypatch.delenv("PASSWORD")
        with pytest.raises(GatewayError, match="the environment variable PASSWORD is not set"):
            opcua.use(connects)

    def test_status_codes_become_qualities(self):
        ua = pytest.importorskip("asyncua").ua
        from ros2_deepc.gateway.opcua_link import take

        codes = {0: 0, 0x40900000: 1, 0x80000000: 3, 0x80340000: 3}
        values = [ua.DataValue(ua.Variant(1.0), ua.StatusCode(code)) for code in codes]
        assert [take(value, -1)[:2] for value in values] == [(1.0, quality) for quality in codes.values()]


@pytest.mark.parametrize(("kind", "package"), [("modbus", "pymodbus"), ("opcua", "asyncua")])
def test_a_missing_extra_says_what_to_install(kind, package, text, monkeypatch):
    import sys

    from ros2_deepc.gateway import MissingExtraError

    for name in [name for name in sys.modules if name.startswith(f"ros2_deepc.gateway.{kind}")]:
        monkeypatch.delitem(sys.modules, name)
    for name in [name for name in sys.modules if name.split(".")[0] == package]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, package, None)
    if kind == "opcua":
        text = tag_map_of_opcua(text)
    with pytest.raises(MissingExtraError, match=rf"needs {package}.*pip install 'ros2-deepc\[{kind}\]'"):
        make_link(loads(text))


def tag_map_of_opcua(text):
    import re

    text = text.replace("kind: modbus, host: 127.0.0.1, port: 5020", "kind: opcua, url: 'opc.tcp://localhost'")
    return re.sub(r"\{(table: input, )?address: (\d+)(, type: \w+)?\}", r"{node: 'ns=2;i=\2'}", text)


def test_while_the_counter_stands_still_only_its_block_is_read(free_port):
    pytest.importorskip("pymodbus")
    from ros2_deepc.gateway.modbus_codec import encode
    from ros2_deepc.gateway.modbus_server import ModbusServer, Registers

    port, asked = free_port(), []

    class Counted(Registers):
        async def async_getValues(self, device_id, func_code, address, count=1):
            asked.append(address)
            return await super().async_getValues(device_id, func_code, address, count)

    text = f"""\
plant: {{name: big, sample_time: 0.1}}
link: {{kind: modbus, host: 127.0.0.1, port: {port}}}
sampling: {{by: scan, counter: {{table: input, address: 600, type: uint16}}}}
outputs:
  - {{name: y, unit: '', count: 300, at: {{table: input, address: 0}}}}
inputs:
  - {{name: u, unit: '', limits: [-1, 1], max_rate: 9, safe: 0, at: {{address: 0}}}}
"""

    async def play():
        registers = Counted(holding=10, inputs=601)
        server = ModbusServer(registers, "127.0.0.1", port)
        await server.start()
        link = make_link(loads(text))
        await link.connect()
        values = []
        for count in (1, 1, 2):
            registers.tables["input"][:600] = encode(np.arange(300.0) + count, "float32")
            registers.tables["input"][600] = count
            values.append(((await link.read()).raw, len(asked)))
        await link.close()
        await server.stop()
        return values

    (first, n1), (second, n2), (third, n3) = asyncio.run(play())
    np.testing.assert_array_equal(first, [*np.arange(300.0) + 1, 1])
    np.testing.assert_array_equal(second, first)
    np.testing.assert_array_equal(third, [*np.arange(300.0) + 2, 2])
    assert (n2 - n1, n3 - n2) == (1, n1)
    assert not make_link(loads(text)).atomic


def test_a_field_that_scans_while_it_is_read_is_read_again(free_port, soon):
    """300 numbers take five requests; the field's scans come between the third and the fourth of two of three reads."""
    pytest.importorskip("pymodbus")
    from ros2_deepc.gateway import Gateway
    from ros2_deepc.gateway.engine import Engine
    from ros2_deepc.gateway.modbus_codec import encode
    from ros2_deepc.gateway.modbus_server import ModbusServer, Registers

    class Moving(Registers):
        asked = scans = 0

        async def async_getValues(self, device_id, func_code, address, count=1):
            self.asked += 1
            if self.asked % 15 in (4, 9):
                self.scan()
            return await super().async_getValues(device_id, func_code, address, count)

        def scan(self):
            self.scans += 1
            self.tables["input"][:600] = encode(np.full(300, float(self.scans)), "float32")
            self.tables["input"][600] = self.scans

    port, vectors = free_port(), []
    text = f"""\
plant: {{name: big, sample_time: 0.1}}
link: {{kind: modbus, host: 127.0.0.1, port: {port}, timeout: 5}}
sampling: {{by: scan, poll: 0.001, counter: {{table: input, address: 600, type: uint16}}}}
outputs:
  - {{name: y, unit: '', count: 300, at: {{table: input, address: 0}}}}
inputs:
  - {{name: u, unit: '', limits: [-1, 1], max_rate: 9, safe: 0, at: {{address: 0}}}}
"""

    async def play():
        registers = Moving(holding=10, inputs=601)
        registers.scan()
        server = ModbusServer(registers, "127.0.0.1", port)
        await server.start()
        gateway = Gateway(loads(text), 0.0)

        def take(outputs):
            if gateway._vector.good:
                vectors.append(outputs.vector.values)

        engine = Engine(gateway, make_link(gateway.tags), on_outputs=take)
        running = asyncio.create_task(engine.run())
        await soon(lambda: len(vectors) > 10)
        engine.stop()
        await running
        await server.stop()

    asyncio.run(play())
    assert all((values == values[0]).all() for values in vectors)
