# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Links against servers: what is read and written, what is refused, what happens to garbage."""

import asyncio
import os

import numpy as np
import pytest

from ros2_deepc.gateway import LinkError, loads
from ros2_deepc.gateway.field import Device, find_plant
from ros2_deepc.gateway.field_tags import modbus_places, tag_map
from ros2_deepc.gateway.link import make_link


@pytest.fixture
def plant():
    return find_plant("wscc9", {})


class TestModbus:
    @pytest.fixture
    def served(self, plant, free_port):
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
                await asyncio.sleep(0.05)
                link = make_link(loads(change(text)))
                try:
                    return await use(link, device, field)
                finally:
                    await link.close()
                    running.cancel()
                    await running

            return asyncio.run(both())

        return run

    def test_reads_in_one_request_and_writes_in_one(self, served, plant):
        async def use(link, device, field):
            writes = []
            field.registers._on_write = lambda *where: writes.append(where)
            await link.connect()
            assert link.atomic
            await link.write(np.array([0.25, -0.5, 0.75, 9.0]))
            await asyncio.sleep(0.05)
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

    def test_garbage_from_a_server_is_an_error_not_a_crash(self, plant, free_port):
        pytest.importorskip("pymodbus")
        port = free_port()
        text = tag_map(plant, f"{{kind: modbus, host: 127.0.0.1, port: {port}, timeout: 0.05}}",
                       modbus_places("float32"), registered="wscc9", options={})  # fmt: skip
        rng = np.random.Generator(np.random.PCG64(1))

        async def babble(reader, writer):
            while request := await reader.read(1000):
                head = request[:7] if rng.random() < 0.5 else rng.bytes(7)
                writer.write(head + rng.bytes(int(rng.integers(0, 300))))
                if rng.random() < 0.3:
                    break
            writer.close()

        async def run():
            server = await asyncio.start_server(babble, "127.0.0.1", port)
            link = make_link(loads(text))
            failures = 0
            for _ in range(60):
                try:
                    await link.connect()
                    scan = await link.read()
                    assert len(scan.raw) == len(scan.quality)
                except LinkError:
                    failures += 1
            await link.close()
            server.close()
            await server.wait_closed()
            await asyncio.sleep(0.05)
            return failures

        assert asyncio.run(run()) > 30

    def test_nobody_there(self, plant, free_port):
        pytest.importorskip("pymodbus")
        text = tag_map(plant, f"{{kind: modbus, host: 127.0.0.1, port: {free_port()}}}", modbus_places("float32"),
                       registered="wscc9", options={})  # fmt: skip
        link = make_link(loads(text))
        with pytest.raises(LinkError, match="no connection"):
            asyncio.run(link.connect())


class TestOpcua:
    @pytest.fixture
    def served(self, plant, free_port, tmp_path, monkeypatch):
        """As for Modbus; both sides trust each other's certificates unless told otherwise."""
        pytest.importorskip("asyncua")
        from ros2_deepc.gateway.field_opcua import URI, OpcuaField, opcua_places, writable
        from ros2_deepc.gateway.opcua_link import URI as CLIENT
        from ros2_deepc.gateway.opcua_pki import Pki
        from ros2_deepc.gateway.opcua_server import Access

        monkeypatch.setenv("PASSWORD", "secret")
        url = f"opc.tcp://127.0.0.1:{free_port()}"
        link = f"{{kind: opcua, url: '{url}', user: controller, password_env: PASSWORD, timeout: 2}}"
        text = tag_map(plant, link, opcua_places(plant), registered="wscc9", options={}, speed=10.0)
        server, client = Pki(tmp_path / "field", URI), Pki(tmp_path / "pki", CLIENT)
        access = Access(
            users={"controller": "secret", "viewer": "look"},
            writes={"controller": writable(plant)}, pki=tmp_path / "field",
        )  # fmt: skip

        def run(use, change=lambda t: t, trust=True):
            if trust:
                server.trust(client.certificate)
            client.trust(server.certificate)

            async def both():
                device = Device(plant)
                field = OpcuaField(device, url, access, 0.02)
                running = asyncio.create_task(field.run())
                while field.server._server is None:
                    await asyncio.sleep(0.02)
                made = make_link(loads(change(text), str(tmp_path / "tags.yaml")))
                try:
                    return await use(made, device, field)
                finally:
                    await made.close()
                    running.cancel()
                    await running
                    await asyncio.sleep(0.05)

            return asyncio.run(both())

        return run

    def test_reads_and_writes_encrypted(self, served):
        async def use(link, device, field):
            await link.connect()
            await link.write(np.array([0.25, -0.5, 0.75, 9.0]))
            await asyncio.sleep(0.1)
            scan = await link.read()
            assert link._client.security_policy.URI.endswith("Basic256Sha256")
            return scan, device, field.server.refused

        scan, device, refused = served(use)
        np.testing.assert_array_equal(device.u, [0.25, -0.5, 0.75])
        assert scan.raw[3] == 9.0
        assert (scan.source_ns > 1.7e18).all()
        assert refused == {"user": 0, "certificate": 0, "node": 0}

    def refused(self, served, change=lambda t: t, *, match, trust=True, write=False):
        async def use(link, device, field):
            if write:
                await link.connect()
            with pytest.raises(LinkError, match=match):
                await (link.write(np.array([0.25, -0.5, 0.75, 9.0])) if write else link.connect())
            return device, field.server.refused

        device, counts = served(use, change, trust)
        assert device.local
        assert device.echo == 0
        return counts

    def test_a_wrong_password_is_refused(self, served, monkeypatch):
        monkeypatch.setitem(os.environ, "PASSWORD", "guess")
        assert self.refused(served, match="BadUserAccessDenied|BadIdentityTokenRejected")["user"] > 0

    def test_nobody_is_refused(self, served):
        def anonymous(text):
            return text.replace(", user: controller, password_env: PASSWORD", "")

        self.refused(served, anonymous, match="Bad|[Ii]dentity|token|policy")

    def test_a_viewer_may_not_write(self, served, monkeypatch):
        monkeypatch.setitem(os.environ, "PASSWORD", "look")
        counts = self.refused(
            served, lambda t: t.replace("user: controller", "user: viewer"), match="BadUserAccessDenied", write=True
        )
        assert counts["node"] == 1

    def test_a_node_that_is_not_on_the_list_is_refused(self, served):
        def forbidden(text):
            return text.replace("s=in/P12", "s=out/x1")

        assert self.refused(served, forbidden, match="BadUserAccessDenied", write=True)["node"] == 1

    def test_a_certificate_that_nobody_trusts_is_refused_and_kept(self, served, tmp_path):
        counts = self.refused(served, match="Bad", trust=False)
        assert counts["certificate"] > 0
        assert len(list((tmp_path / "field" / "rejected").glob("*.der"))) == 1

    def test_a_server_that_is_not_trusted_gets_no_password(self, served, tmp_path):
        async def use(link, device, field):
            for path in (tmp_path / "pki" / "trusted").glob("*.der"):
                path.unlink()
            with pytest.raises(LinkError, match="not trusted"):
                await link.connect()
            return field.server.refused

        assert served(use) == {"user": 0, "certificate": 0, "node": 0}
        assert len(list((tmp_path / "pki" / "rejected").glob("*.der"))) == 1

    def test_without_encryption_there_is_no_way_in(self, served):
        def plain(text):
            return text.replace("user: controller, password_env: PASSWORD", "allow_insecure_loopback: true")

        self.refused(served, plain, match=".")

    def test_a_node_that_does_not_exist_is_named(self, served):
        async def use(link, device, field):
            with pytest.raises(LinkError, match=r"there is no node .*out/nosuch"):
                await link.connect()

        served(use, lambda t: t.replace("s=out/x1", "s=out/nosuch"))

    def test_status_codes_become_qualities(self, served):
        async def use(link, device, field):
            await link.connect()
            found = []
            for status in (0, 0x40900000, 0x80000000):
                await field.server.put("out/x1", 1.0, status=status)
                found.append(int((await link.read()).quality[0]))
            return found

        assert served(use) == [0, 1, 3]


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
