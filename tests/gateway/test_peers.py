# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Against implementations that nobody here wrote: libmodbus, mbpoll, node-opcua. `packaging/peers.sh` installs them."""

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

from ros2_deepc.gateway import loads
from ros2_deepc.gateway.assemble import Quality
from ros2_deepc.gateway.field import Device, find_plant
from ros2_deepc.gateway.link import make_link

HERE = Path(__file__).parent / "peers"
MODULES = Path(os.environ.get("PEERS_NODE_MODULES", Path(__file__).parents[2] / "build" / "peers" / "node_modules"))
needs_mbpoll = pytest.mark.skipif(not shutil.which("mbpoll"), reason="packaging/peers.sh installs mbpoll")
needs_libmodbus = pytest.mark.skipif(
    not (shutil.which("gcc") and Path("/usr/include/modbus/modbus.h").exists()),
    reason="packaging/peers.sh installs libmodbus",
)
needs_node = pytest.mark.skipif(
    not (shutil.which("node") and (MODULES / "node-opcua").exists()), reason="packaging/peers.sh installs node-opcua"
)
NODE_ENV = os.environ | {"NODE_PATH": str(MODULES), "NODE_OPTIONS": "--no-warnings"}


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


@contextmanager
def running(field):
    """A field in a thread of its own."""
    from ros2_deepc.gateway.loop_thread import LoopThread

    failures = []
    thread = LoopThread(failures.append)
    thread.start(field.run())
    end = time.monotonic() + 60
    while field.device.count < 3 and not failures and time.monotonic() < end:
        time.sleep(0.01)
    assert not failures
    try:
        yield
    finally:
        thread.stop()


@needs_mbpoll
def test_mbpoll_reads_what_our_modbus_server_says(free_port):
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
    link = make_link(loads(text))

    async def talk():
        await link.connect()
        await link.write(np.array([0.1]))
        await link.read()
        scan = await link.read()
        await link.close()
        await asyncio.sleep(0.05)
        return scan

    with peer(str(binary), str(port)):
        scan = asyncio.run(talk())
    np.testing.assert_array_equal(scan.raw, [3.25, np.float32(-1e-3), 0.1])


@needs_node
def test_our_opcua_client_against_node_opcua(tmp_path, free_port):
    pytest.importorskip("asyncua")
    port = free_port()
    text = f"""\
plant: {{name: n, sample_time: 0.1}}
link: {{kind: opcua, url: 'opc.tcp://127.0.0.1:{port}', allow_insecure_loopback: true, timeout: 5}}
outputs:
  - {{name: y1, unit: '', at: {{node: 'nsu=urn:peer;s=y1'}}}}
  - {{name: y2, unit: '', at: {{node: 'nsu=urn:peer;s=y2'}}}}
  - {{name: a, unit: '', count: 3, at: {{node: 'nsu=urn:peer;s=array'}}}}
  - {{name: back, unit: '', at: {{node: 'nsu=urn:peer;s=u1'}}}}
inputs:
  - {{name: u, unit: '', limits: [-9, 9], max_rate: 99, safe: 0, at: {{node: 'nsu=urn:peer;s=u1'}}}}
"""
    link = make_link(loads(text))

    async def talk():
        await link.connect()
        await link.write(np.array([0.125]))
        scan = await link.read()
        await link.close()
        await asyncio.sleep(0.05)
        return scan

    with peer("node", str(HERE / "server.js"), str(port), str(tmp_path), env=NODE_ENV):
        scan = asyncio.run(talk())
    np.testing.assert_array_equal(scan.raw, [3.25, -1e-3, 1.5, 2.5, 3.5, 0.125])
    assert scan.quality.tolist() == [Quality.GOOD, Quality.UNCERTAIN, *[Quality.GOOD] * 4]
    assert abs(scan.source_ns[0] - time.time_ns()) < 120e9


def node_client(url, user, password, folder, *names):
    out = subprocess.run(
        ["node", HERE / "client.js", url, user, password, folder, *names],
        capture_output=True, text=True, timeout=100, check=True, env=NODE_ENV,
    ).stdout  # fmt: skip
    return json.loads(out.strip().splitlines()[-1])


@needs_node
def test_node_opcua_as_client_of_our_server(tmp_path, free_port):
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
    nodes = [f"{URI};s=out/x1", f"{URI};s=in/P12"]
    with running(field):
        viewer = node_client(url, "viewer", "look", str(tmp_path), *nodes)
        controller = node_client(url, "controller", "secret", str(tmp_path), *nodes)
        stranger = node_client(url, "controller", "guess", str(tmp_path), *nodes)
        anonymous = node_client(url, "", "", str(tmp_path), *nodes)
        taken = field.server.get("in/P12")
    assert viewer["values"][0] == pytest.approx(field.device.y[0])
    assert abs(viewer["times"][0] - time.time() * 1e3) < 120e3
    assert all("BadUserAccessDenied" in status for status in viewer["writes"])
    assert "BadUserAccessDenied" in controller["writes"][0]
    assert controller["writes"][1] == "Good"
    assert taken == 0.5
    assert stranger.get("error")
    assert "values" not in stranger
    assert anonymous.get("error")
    assert "values" not in anonymous
