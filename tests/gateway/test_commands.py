# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""`--check` reads and writes nothing; a served plant comes with a tag map; the read-only server shows the zone."""

import asyncio
import subprocess
import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest

from ros2_deepc.gateway import Gateway, GatewayError, loads
from ros2_deepc.gateway.assemble import Vector
from ros2_deepc.gateway.commands import HEADER, FieldOptions, check, run_field
from ros2_deepc.gateway.core import Outputs


def test_check_reads_every_tag_of_a_served_plant_and_writes_nothing(tmp_path, free_port):
    pytest.importorskip("pymodbus")
    tags = tmp_path / "tags.yaml"
    code = (
        "import sys; from pathlib import Path; from ros2_deepc.gateway.commands import *;"
        "tags, port = Path(sys.argv[1]), int(sys.argv[2]);"
        "run_field('net3', FieldOptions(protocol='modbus', port=port, speed=86400.0, tags=tags))"
    )
    child = subprocess.Popen([sys.executable, "-c", code, tags, str(free_port())], stdout=subprocess.DEVNULL)
    rows, end = [], time.monotonic() + 60
    try:
        while not rows and time.monotonic() < end:
            try:
                rows = check(tags)
            except GatewayError:
                time.sleep(0.05)
        again = check(tags)
    finally:
        child.terminate()
        child.wait()
    assert [row[0] for row in rows] == ["R1", "T3", "scan", "echo", *[row[0] for row in rows[4:7]], "beat"]
    assert all(len(row) == len(HEADER) for row in rows)
    assert [row[-1] for row in rows[:4]] == ["GOOD"] * 4
    assert [float(row[6]) for row in rows[:2]] == [4.0, 2.0]
    assert rows[3][6] == again[3][6] == "0"  # no heartbeat was written
    with pytest.raises(GatewayError, match="no connection"):
        check(tags)


def test_a_field_that_cannot_be_served_says_why(tmp_path):
    with pytest.raises(GatewayError, match="unknown plant 'nosuch'; there are: "):
        run_field("nosuch", FieldOptions(protocol="modbus"))
    pytest.importorskip("asyncua")
    with pytest.raises(GatewayError, match=r"listen on 127\.0\.0\.1 only"):
        run_field("wscc9", FieldOptions(protocol="opcua", host="0.0.0.0"), lambda _: None)
    with pytest.raises(GatewayError, match="FIELD_CONTROLLER_PASSWORD"):
        run_field("wscc9", FieldOptions(protocol="opcua", pki=tmp_path), lambda _: None)


def test_the_mirror_shows_the_zone_and_takes_nothing(text, free_port):
    asyncua = pytest.importorskip("asyncua")
    from ros2_deepc.gateway.mirror import URI, Mirror

    url = f"opc.tcp://127.0.0.1:{free_port()}"
    tags = loads(text + f"serve: {{url: '{url}', allow_insecure_loopback: true}}\n")
    gateway = Gateway(tags, 0.0)
    vector = Vector(
        values=np.array([1.5, -2.5]), quality=np.array([0, 1], dtype=np.uint8), stamp_ns=1_700_000_000 * 10**9,
        age=np.zeros(2), reason="y2",
    )  # fmt: skip
    verdict = SimpleNamespace(verdict=1)
    names = ("r_controllability", "c_controllability", "r_observability", "c_observability")

    async def play():
        mirror = Mirror(tags)
        running = asyncio.create_task(mirror.run())
        while mirror.server._server is None:
            await asyncio.sleep(0.02)
        mirror.sample(Outputs(epoch=2, k=7, vector=vector, held=0))
        mirror.gateway(gateway)
        mirror.controller(SimpleNamespace(mode=2))
        mirror.report(SimpleNamespace(**dict.fromkeys(names, verdict)))
        mirror.reference(SimpleNamespace(values=[3.0, 4.0]))
        await asyncio.sleep(0.1)
        async with asyncua.Client(url) as client:
            index = await client.get_namespace_index(URI)
            node = {name: client.get_node(f"ns={index};s={name}") for name in ("outputs", "state", "k", "mode", *names)}
            data = await node["outputs"].read_data_value(raise_on_bad_status=False)
            shown = {name: await each.read_value() for name, each in node.items() if name != "outputs"}
            with pytest.raises(asyncua.ua.UaStatusCodeError):
                await node["state"].write_value("RUN")
        running.cancel()
        await running
        await asyncio.sleep(0.05)
        return data, shown

    data, shown = asyncio.run(play())
    assert data.Value.Value == [1.5, -2.5]
    assert data.StatusCode.name.startswith("Uncertain")
    assert shown == {"state": "SHADOW", "k": 7, "mode": "CONTROLLING", **dict.fromkeys(names, "PROVED")}
