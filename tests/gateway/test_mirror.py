# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The read-only server shows the zone to whoever may look, and takes nothing from anybody."""

import asyncio
from contextlib import asynccontextmanager
from types import SimpleNamespace

import numpy as np
import pytest

from ros2_deepc.gateway import Gateway, GatewayError, LinkError, loads
from ros2_deepc.gateway import modbus_codec as codec
from ros2_deepc.gateway.assemble import Quality, Vector
from ros2_deepc.gateway.core import Outputs
from ros2_deepc.gateway.link import make_link
from ros2_deepc.gateway.mirror import Mirror

VECTOR = Vector(
    values=np.array([1.5, -2.5]), quality=np.array([0, 1], dtype=np.uint8), stamp_ns=1_700_000_000 * 10**9,
    age=np.zeros(2), reason="y2",
)  # fmt: skip
NAMES = ("r_controllability", "c_controllability", "r_observability", "c_observability")


@asynccontextmanager
async def showing(tags, soon):
    """A mirror that has been told everything."""
    mirror = Mirror(tags)
    running = asyncio.create_task(mirror.run())
    mirror.sample(Outputs(epoch=2, k=7, vector=VECTOR, held=0))
    gateway = Gateway(tags, 0.0)
    gateway.guard.counts.refused["mode"] = 70000
    mirror.gateway(gateway)
    mirror.controller(SimpleNamespace(mode=2))
    mirror.report(SimpleNamespace(**{name: SimpleNamespace(verdict=i) for i, name in enumerate(NAMES)}))
    mirror.reference(SimpleNamespace(values=[3.0, 4.0]))
    mirror.inputs(SimpleNamespace(values=[0.5, 1e300]))
    await soon(lambda: not mirror._news or running.done())
    try:
        yield mirror
    finally:
        running.cancel()
        await running


VIEW = """\
plant: {{name: view, sample_time: 0.1}}
link: {{kind: opcua, url: '{url}', {access}, timeout: 5}}
defaults: {{type: Double}}
outputs:
  - {{name: y, unit: '', count: 2, at: {{node: 'nsu=urn:ros2_deepc:mirror;s=outputs'}}}}
  - {{name: w, unit: '', count: 2, at: {{node: 'nsu=urn:ros2_deepc:mirror;s=reference'}}}}
  - {{name: u, unit: '', count: 2, at: {{node: 'nsu=urn:ros2_deepc:mirror;s=inputs'}}}}
  - {{name: beyond, unit: '', at: {{node: 'nsu=urn:ros2_deepc:mirror;s=outputs', index: 2}}}}
  - {{name: k, unit: '', at: {{node: 'nsu=urn:ros2_deepc:mirror;s=k'}}}}
inputs:
  - {{name: v, unit: '', count: 2, limits: [-9, 9], max_rate: 9, safe: 0,
     at: {{node: 'nsu=urn:ros2_deepc:mirror;s=outputs'}}}}
"""


def test_an_encrypted_mirror_shows_its_user_everything_and_takes_nothing(text, free_port, soon, tmp_path, monkeypatch):
    pytest.importorskip("asyncua")
    from ros2_deepc.gateway.mirror_opcua import URI
    from ros2_deepc.gateway.opcua_link import URI as CLIENT
    from ros2_deepc.gateway.opcua_pki import Pki

    url = f"opc.tcp://127.0.0.1:{free_port()}"
    tags = loads(text + f"serve: {{url: '{url}', user: viewer, password_env: VIEW}}\n", str(tmp_path / "tags.yaml"))
    with pytest.raises(GatewayError, match="the environment variable VIEW is not set"):
        Mirror(tags)
    monkeypatch.setenv("VIEW", "look")
    monkeypatch.setenv("GUESS", "guess")
    server, client = Pki(tmp_path / "pki", URI), Pki(tmp_path / "hmi" / "pki", CLIENT)
    server.trust(client.certificate)
    client.trust(server.certificate)

    def link(access):
        return make_link(loads(VIEW.format(url=url, access=access), str(tmp_path / "hmi" / "tags.yaml")))

    async def refused(access):
        other = link(access)
        with pytest.raises(LinkError):
            await other.connect()
        await other.close()

    async def play():
        async with showing(tags, soon) as mirror:
            hmi = link("user: viewer, password_env: VIEW")
            await hmi.connect()
            scan = await hmi.read()
            with pytest.raises(LinkError, match="Bad"):
                await hmi.write(np.array([1.0, 1.0]))
            assert hmi._client.security_policy.URI.endswith("Basic256Sha256")
            await hmi.close()
            await refused("user: viewer, password_env: GUESS")
            await refused("user: controller, password_env: VIEW")
            await refused("allow_insecure_loopback: true")
            window = mirror.window
            assert window.refused["node"] == 1
            assert window.refused["user"] == 2
            shown = {name: window.get(name) for name in ("state", "mode", "outputs", "output_names", "refused", *NAMES)}
        return scan, shown

    scan, shown = asyncio.run(play())
    np.testing.assert_array_equal(scan.raw, [1.5, -2.5, 3, 4, 0.5, 1e300, np.nan, 7])
    assert scan.quality.tolist() == [Quality.UNCERTAIN] * 2 + [0] * 4 + [Quality.UNCERTAIN, 0]
    assert scan.source_ns[0] == VECTOR.stamp_ns
    assert shown == {
        "state": "SHADOW", "mode": "CONTROLLING", "outputs": [1.5, -2.5], "output_names": ["y1", "y2"],
        "refused": 70000, **dict(zip(NAMES, ("UNDECIDED", "PROVED", "NOT_PROVED", "PRIOR_VIOLATED"), strict=True)),
    }  # fmt: skip


def test_a_modbus_mirror_shows_everybody_everything_and_takes_nothing(text, free_port, soon):
    pytest.importorskip("pymodbus")
    from pymodbus.client import AsyncModbusTcpClient

    port = free_port()
    tags = loads(text + f"serve: {{kind: modbus, port: {port}}}\n")

    async def play():
        async with showing(tags, soon) as mirror:
            client = AsyncModbusTcpClient("127.0.0.1", port=port, retries=0, timeout=5)
            await client.connect()
            size = len(mirror.window.registers.tables["input"])
            read = (await client.read_input_registers(0, count=size)).registers
            assert (await client.read_holding_registers(0, count=size)).registers == read
            assert (await client.read_input_registers(0, count=size + 1)).exception_code == 2
            for hostile in (
                client.write_register(0, 1), client.write_registers(16, [0] * 8), client.write_coil(0, True),
                client.mask_write_register(address=0, and_mask=0, or_mask=1),
                client.readwrite_registers(read_address=0, read_count=1, address=0, values=[1]),
            ):  # fmt: skip
                assert (await hostile).exception_code == 1
            assert (await client.read_input_registers(0, count=size)).registers == read
            client.close()
            return read, mirror.window.registers.refused

    read, refused = asyncio.run(play())
    assert read[:7] == [0, 2, 0, 1, 2, 3, 1]
    assert codec.decode(read[8:14], "uint32").tolist() == [2, 7, 70000]
    np.testing.assert_array_equal(codec.decode(read[16:], "float32"), [1.5, -2.5, 3, 4, 0.5, np.nan])
    assert refused >= 3  # by us, beside those that the library refuses before


@pytest.mark.parametrize(
    ("serve", "expected"),
    [
        ("{url: 'opc.tcp://127.0.0.1:4841'}", "give user and password_env"),
        ("{url: 'opc.tcp://0.0.0.0:4841', allow_insecure_loopback: true}", "only encrypted links leave"),
        ("{kind: modbus}", "'port' is missing"),
        ("{kind: modbus, port: 5021, url: x}", "url: unknown key"),
    ],
)
def test_a_mirror_that_cannot_be_is_refused_by_line(text, serve, expected):
    with pytest.raises(GatewayError, match=rf"line 15, column \d+: .*{expected}"):
        loads(text + f"serve: {serve}\n")
