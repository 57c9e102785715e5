# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Against implementations that nobody here wrote: libmodbus, mbpoll, node-opcua, and tshark as the witness.

`packaging/peers.sh` installs them; with PEERS=required in the environment none of these tests may be skipped.
"""

import asyncio
import json
import os
import re
import shutil
import subprocess
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from ros2_deepc.gateway import LinkError, loads
from ros2_deepc.gateway.assemble import Quality
from ros2_deepc.gateway.field import Device, find_plant
from ros2_deepc.gateway.link import make_link

pytestmark = pytest.mark.peers
HERE = Path(__file__).parent / "peers"
MODULES = Path(os.environ.get("PEERS_NODE_MODULES", Path(__file__).parents[2] / "build" / "peers" / "node_modules"))
NODE_ENV = os.environ | {"NODE_PATH": str(MODULES), "NODE_OPTIONS": "--no-warnings"}


def needs(there, name):
    missing = not there and os.environ.get("PEERS") != "required"
    return pytest.mark.skipif(missing, reason=f"{name} is not here: run packaging/peers.sh")


needs_mbpoll = needs(shutil.which("mbpoll"), "mbpoll")
needs_libmodbus = needs(shutil.which("gcc") and Path("/usr/include/modbus/modbus.h").exists(), "libmodbus")
needs_node = needs(shutil.which("node") and (MODULES / "node-opcua").exists(), "node-opcua")
needs_tshark = needs(shutil.which("tshark") and shutil.which("text2pcap"), "tshark")


@contextmanager
def peer(*command, **kwargs):
    """A peer that says 'ready' when it is."""
    child = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, **kwargs)
    try:
        assert any(line.strip() == "ready" for line in child.stdout)
        yield child
    finally:
        child.kill()
        child.wait()
        child.stdout.close()


@pytest.fixture
def running(until):
    """A field in a thread of its own, as a context manager."""
    from ros2_deepc.gateway.loop_thread import LoopThread

    @contextmanager
    def run(field):
        failures = []
        thread = LoopThread(failures.append)
        thread.start(field.run())
        until(lambda: field.device.count > 2 or failures)
        assert not failures
        try:
            yield
        finally:
            thread.stop()

    return run


def visit(text, order, relay=None, folder="."):
    """What a link reads after writing an order."""

    async def talk():
        if relay is not None:
            await relay.start()
        link = make_link(loads(text, f"{folder}/tags.yaml"))
        try:
            await link.connect()
            await link.write(np.array(order))
            await link.read()  # a device that works between two requests has copied what was written by now
            return await link.read()
        finally:
            await link.close()
            if relay is not None:
                await relay.stop()

    return asyncio.run(talk())


@needs_mbpoll
def test_mbpoll_reads_what_our_modbus_server_says(free_port, running):
    pytest.importorskip("pymodbus")
    from ros2_deepc.gateway.field_modbus import ModbusField

    port, plant = free_port(), find_plant("wscc9", {})
    field = ModbusField(Device(plant), "127.0.0.1", port, "float32", 0.01)
    with running(field):

        def mbpoll(*arguments):
            command = ["mbpoll", "-m", "tcp", "-p", str(port), "-a", "1", "-B", "-1", *arguments]
            return subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)

        out = mbpoll("-t", "3:float", "-r", "3", "-c", "2", "127.0.0.1").stdout
        assert mbpoll("-t", "4:float", "-r", "2", "127.0.0.1", "0.25").returncode == 0
        assert mbpoll("-t", "0", "-r", "1", "127.0.0.1").returncode != 0  # a coil
    read = [float(text) for text in re.findall(r"\[\d+\]:\s+(\S+)", out)]
    np.testing.assert_allclose(read, field.device.y, rtol=2e-5)  # mbpoll prints six digits
    assert list(field.registers.tables["holding"][1:3]) == [0x3E80, 0x0000]


@needs_libmodbus
def test_our_modbus_client_against_libmodbus(tmp_path, free_port):
    pytest.importorskip("pymodbus")
    binary, port = tmp_path / "server", free_port()
    subprocess.run(
        ["gcc", "-o", binary, HERE / "server.c", "-I/usr/include/modbus", "-lmodbus"], check=True, capture_output=True
    )
    text = f"""\
plant: {{name: c, sample_time: 0.1}}
link: {{kind: modbus, host: 127.0.0.1, port: {port}}}
outputs:
  - {{name: y1, unit: '', at: {{table: input, address: 2}}}}
  - {{name: y2, unit: '', at: {{table: input, address: 4, words: CDAB}}}}
  - {{name: back, unit: '', at: {{table: input, address: 23, type: float64}}}}
inputs:
  - {{name: u, unit: '', limits: [-9, 9], max_rate: 99, safe: 0, at: {{address: 3, type: float64}}}}
"""
    with peer(str(binary), str(port)):
        scan = visit(text, [0.1])
    np.testing.assert_array_equal(scan.raw, [3.25, np.float32(-1e-3), 0.1])


NODE_TAGS = """\
plant: {{name: n, sample_time: 0.1}}
link: {{kind: opcua, url: 'opc.tcp://127.0.0.1:{port}', {access}, timeout: 5}}
outputs:
  - {{name: y1, unit: '', at: {{node: 'nsu=urn:peer;s=y1'}}}}
  - {{name: y2, unit: '', at: {{node: 'nsu=urn:peer;s=y2'}}}}
  - {{name: a, unit: '', count: 3, at: {{node: 'nsu=urn:peer;s=array'}}}}
  - {{name: back, unit: '', at: {{node: 'nsu=urn:peer;s=u1'}}}}
  - {{name: set, unit: '', count: 2, at: {{node: 'nsu=urn:peer;s=setpoints'}}}}
inputs:
  - {{name: u, unit: '', limits: [-9, 9], max_rate: 99, safe: 0, at: {{node: 'nsu=urn:peer;s=u1'}}}}
  - {{name: v, unit: '', count: 2, limits: [-9, 9], max_rate: 99, safe: 0, at: {{node: 'nsu=urn:peer;s=setpoints'}}}}
"""


@needs_node
def test_our_opcua_client_against_node_opcua(tmp_path, free_port, monkeypatch):
    """Without encryption; then with it, as a user, after somebody trusted the server's certificate."""
    pytest.importorskip("asyncua")
    port = free_port()
    order = [0.125, 7.0, -8.0]
    read = [3.25, -1e-3, 1.5, 2.5, 3.5, *order]
    user = NODE_TAGS.format(port=port, access="user: plc, password_env: PEER_PASSWORD")
    with peer("node", str(HERE / "server.js"), str(port), str(tmp_path), env=NODE_ENV):
        scan = visit(NODE_TAGS.format(port=port, access="allow_insecure_loopback: true"), order)
        np.testing.assert_array_equal(scan.raw, read)
        assert scan.quality.tolist() == [Quality.GOOD, Quality.UNCERTAIN, *[Quality.GOOD] * 6]
        assert abs(scan.source_ns[0] - time.time_ns()) < 120e9

        monkeypatch.setenv("PEER_PASSWORD", "open-sesame")
        with pytest.raises(LinkError, match="not trusted"):
            visit(user, order, folder=tmp_path / "site")
        for certificate in (tmp_path / "site" / "pki" / "rejected").glob("*.der"):
            certificate.rename(certificate.parents[1] / "trusted" / certificate.name)
        np.testing.assert_array_equal(visit(user, -np.array(order), folder=tmp_path / "site").raw[-3:], [-0.125, -7, 8])
        monkeypatch.setenv("PEER_PASSWORD", "guess")
        with pytest.raises(LinkError, match=r"BadUserAccessDenied|BadIdentityTokenRejected"):
            visit(user, order, folder=tmp_path / "site")


@needs_node
def test_node_opcua_as_client_of_our_server(tmp_path, free_port, running):
    pytest.importorskip("asyncua")
    from cryptography import x509
    from cryptography.hazmat.primitives.serialization import Encoding

    from ros2_deepc.gateway.field_opcua import URI, OpcuaField, writable
    from ros2_deepc.gateway.opcua_pki import Pki
    from ros2_deepc.gateway.opcua_server import Access

    plant = find_plant("wscc9", {})
    theirs, ours = Pki(tmp_path / "theirs", "urn:peer:node-opcua"), Pki(tmp_path / "ours", URI)
    ours.trust(theirs.certificate)
    pem = x509.load_der_x509_certificate(theirs.certificate.read_bytes()).public_bytes(Encoding.PEM)
    (tmp_path / "cert.pem").write_bytes(pem)
    shutil.copy(theirs.key, tmp_path / "key.pem")
    access = Access(
        users={"controller": "secret", "viewer": "look"}, writes={"controller": writable(plant)}, pki=ours.folder
    )
    url = f"opc.tcp://127.0.0.1:{free_port()}"
    field = OpcuaField(Device(plant), url, access, 0.1)
    users = [("viewer", "look"), ("controller", "secret"), ("controller", "guess"), ("", "")]
    nodes = [f"{URI};s=out/x1", f"{URI};s=in/P12"]
    with running(field):
        out = subprocess.run(
            ["node", HERE / "client.js", url, tmp_path, json.dumps(users), *nodes],
            capture_output=True, text=True, timeout=100, check=True, env=NODE_ENV,
        ).stdout  # fmt: skip
        taken = field.server.get("in/P12")
    viewer, controller, stranger, anonymous = json.loads(out.strip().splitlines()[-1])
    assert viewer["values"][0] == pytest.approx(field.device.y[0])
    assert abs(viewer["times"][0] - time.time() * 1e3) < 120e3
    assert all("BadUserAccessDenied" in status for status in viewer["writes"])
    assert "BadUserAccessDenied" in controller["writes"][0]
    assert controller["writes"][1] == "Good"
    assert taken == 0.5
    for refused in (stranger, anonymous):
        assert refused.get("error")
        assert "values" not in refused


def witnessed(heard, port, folder, *fields):
    """What tshark makes of a session, one row a packet; columns: whether it is malformed, then ``fields``."""
    dump = folder / "session.txt"
    with dump.open("w") as file:
        for asking, data in heard:
            rows = (f"{i:06x} {data[i : i + 16].hex(' ')}" for i in range(0, len(data), 16))
            file.write("\n".join(["I" if asking else "O", *rows]) + "\n")
    pcap = folder / "session.pcap"
    subprocess.run(["text2pcap", "-q", "-D", "-T", f"40000,{port}", dump, pcap], check=True, capture_output=True)
    columns = [item for name in ("_ws.malformed", *fields) for item in ("-e", name)]
    command = ["tshark", "-r", pcap, "-T", "fields", *columns]
    if port != 502:
        command += ["-d", f"tcp.port=={port},opcua"]
    out = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return [line.split("\t") for line in out.splitlines()]


@needs_tshark
def test_tshark_reads_our_modbus_session(tmp_path, free_port, running, relay):
    pytest.importorskip("pymodbus")
    from ros2_deepc.gateway.field_modbus import ModbusField
    from ros2_deepc.gateway.field_tags import modbus_places, tag_map

    server, port, plant = free_port(), free_port(), find_plant("wscc9", {})
    between = relay(port, server)
    text = tag_map(plant, f"{{kind: modbus, host: 127.0.0.1, port: {port}}}", modbus_places("float32"),
                   registered="wscc9", options={})  # fmt: skip
    with running(ModbusField(Device(plant), "127.0.0.1", server, "float32", 0.01)):
        visit(text, [0.25, -0.5, 1.0, 9.0], between)
    rows = witnessed(
        between.heard, 502, tmp_path, "modbus.func_code", "modbus.exception_code", "modbus.regval_uint16",
        "mbtcp.prot_id", "modbus.reference_num", "modbus.word_cnt",
    )  # fmt: skip
    assert [row[1] for row in rows] == ["16", "16", "4", "4", "4", "4"]
    assert not any(row[0] or row[2] for row in rows)
    floats = [word for x in (0.25, -0.5, 1.0) for word in (np.float32(x).view(np.uint32) >> 16, 0)]
    assert rows[0][3].split(",") == [str(int(word)) for word in (9, *floats)]
    assert (rows[0][5], rows[0][6]) == ("0", "7")
    assert all(row[4] == "0" for row in rows)


@needs_tshark
def test_tshark_reads_our_opcua_session(tmp_path, free_port, running, relay):
    pytest.importorskip("asyncua")
    from ros2_deepc.gateway.field_opcua import OpcuaField, opcua_places
    from ros2_deepc.gateway.field_tags import tag_map
    from ros2_deepc.gateway.opcua_server import Access

    server, port, plant = free_port(), free_port(), find_plant("wscc9", {})
    between = relay(port, server)
    text = tag_map(plant, f"{{kind: opcua, url: 'opc.tcp://127.0.0.1:{port}', allow_insecure_loopback: true}}",
                   opcua_places(plant), registered="wscc9", options={})  # fmt: skip
    with running(OpcuaField(Device(plant), f"opc.tcp://127.0.0.1:{server}", Access(), 0.05)):
        visit(text, [0.25, -0.5, 1.0, 9.0], between)
    rows = witnessed(
        between.heard, port, tmp_path, "opcua.servicenodeid.numeric", "opcua.Double", "opcua.nodeid.string"
    )
    services = [int(row[1]) for row in rows if row[1]]
    assert not any(row[0] for row in rows)
    write, read = 673, 631  # numeric ids of WriteRequest and ReadRequest, OPC 10000-6, Annex A
    assert services.count(write) == 1
    assert services.count(read) >= 3
    values, nodes = next((row[2], row[3]) for row in rows if row[1] == str(write))
    assert values == "0.25,-0.5,1"
    assert nodes == "in/P12,in/P13,in/P23,beat"
