# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""Which output answers which input, through a real server: by scan for index 1 and 2, by timer, in time and late."""

import asyncio
import time

import numpy as np
import pytest

from plant_sim.plant_file import load as load_plant
from ros2_deepc.gateway import Command, Gateway, loads
from ros2_deepc.gateway.engine import Engine
from ros2_deepc.gateway.field import Device
from ros2_deepc.gateway.field_tags import modbus_places, tag_map
from ros2_deepc.gateway.link import make_link

pytest.importorskip("pymodbus")
SAMPLES = 40
INDEX_1 = "E: [[1]]\nA: [[0.9]]\nB: [[1.0]]\nC: [[1.0]]\nsample_time: 0.02\n"
INDEX_2 = """\
E: [[1, 0, 0], [0, 0, 1], [0, 0, 0]]
A: [[0.9, 0, 0], [0, 1, 0], [0, 0, 1]]
B: [[1.0], [0.5], [1.0]]
C: [[1, 1, 0]]
sample_time: 0.02
"""


class Loop:
    """A gateway whose controller commands noise; every input that it commanded, and every good output, by sample."""

    def __init__(self, text, lead):
        self.rng = np.random.Generator(np.random.PCG64(5))
        self.gateway = Gateway(loads(text), time.monotonic())
        self.engine = Engine(
            self.gateway, make_link(self.gateway.tags), on_outputs=self.on_outputs, on_look=self.on_look
        )
        self.lead, self.u, self.y, self.begun = lead, {}, {}, 0

    def on_look(self):
        if self.gateway.state == "RUN" and not self.begun:
            self.begun = self.gateway.epoch
            for k in range(self.lead):
                self.send(k)

    def on_outputs(self, outputs):
        if outputs.epoch == self.begun != 0:
            if outputs.held == 0:
                self.y[outputs.k] = outputs.vector.values[0]
            asyncio.get_running_loop().call_soon(self.send, outputs.k + self.lead)

    def send(self, k):
        u = float(self.rng.uniform(-1, 1))
        command = Command(zone=self.gateway.tags.plant.name, source="controller", epoch=self.begun, k=k, values=[u])
        if self.engine.command(command) is None:
            self.u[k] = u


def unbroken(loop, s):
    """The longest run of samples without a gap: inputs k to k+n+s-2, outputs k to k+n-1."""
    runs, start = [], None
    for k in range(max(loop.y) + 2):
        whole = k in loop.y and all(k + i in loop.u for i in range(s))
        if whole and start is None:
            start = k
        elif not whole and start is not None:
            runs.append((k - start, start))
            start = None
    n, k = max(runs)
    n, k = n - (s - 1), k + s - 1  # whether the inputs before the first were in time is told by samples before it
    return np.array([loop.u[k + i] for i in range(n + s - 1)]), np.array([loop.y[k + i] for i in range(n)])


def mismatch(plant, u, y):
    """How far a record is from the plant's own behaviour, whatever its slow state was at the start."""
    system = plant.system
    forced = system.simulate(u[:, None], np.zeros(1)).y[:, 0]
    free = system.simulate(np.zeros((len(u), 1)), np.ones(1)).y[:, 0]
    residual = y - forced
    return np.abs(residual - free * (free @ residual) / (free @ free)).max()


@pytest.mark.parametrize(("s", "yaml"), [(1, INDEX_1), (2, INDEX_2)], ids=["index 1", "index 2"])
def test_by_scan_sample_k_answers_inputs_k_and_no_other(s, yaml, tmp_path, free_port, soon):
    """Checked against the plant's own simulation; one sample to either side, the record is far from it."""
    from ros2_deepc.gateway.field_modbus import ModbusField

    (tmp_path / "own.yaml").write_text("name: own\n" + yaml)
    plant, port = load_plant(tmp_path / "own.yaml"), free_port()
    assert plant.prior.s == s
    text = tag_map(plant, f"{{kind: modbus, host: 127.0.0.1, port: {port}}}", modbus_places("float64"),
                   registered="", options={})  # fmt: skip
    text = text.replace("sampling: {by: scan,", "sampling: {by: scan, poll: 0.002,") + (
        "supervision: {stale_after: 2, fallback_after: 60}\n"
    )

    async def play():
        field = asyncio.create_task(ModbusField(Device(plant, watchdog=60.0), "127.0.0.1", port, "float64", 0.02).run())
        loop = Loop(text, lead=s)
        running = asyncio.create_task(loop.engine.run())
        await soon(lambda: loop.gateway.auto(time.monotonic()).accepted)
        why = lambda: (loop.gateway.state, loop.gateway.supervisor.reason, loop.gateway.guard.reason)  # noqa: E731
        await soon(lambda: loop.begun and len(loop.y) > SAMPLES and len(unbroken(loop, s)[1]) > 15, why)
        await loop.engine.leave()
        await running
        field.cancel()
        await field
        return loop

    u, y = unbroken(asyncio.run(play()), s)
    assert mismatch(plant, u, y) < 1e-9
    assert mismatch(plant, u[1:], y[:-1]) > 0.05
    assert mismatch(plant, u[:-1], y[1:]) > 0.05


TIMER = """\
plant: {{name: own, sample_time: 0.02}}
link: {{kind: modbus, host: 127.0.0.1, port: {port}}}
sampling: {{by: timer}}
supervision: {{stale_after: 2, fallback_after: 60}}
outputs:
  - {{name: y, unit: '', at: {{table: holding, address: 0, type: float64}}}}
inputs:
  - {{name: u, unit: '', limits: [-1, 1], max_rate: 1000, safe: 0, at: {{address: 0, type: float64}}}}
"""


def test_by_timer_a_command_is_written_at_its_tick_after_reading(free_port, soon):
    """The field shows what was written last: sample k+1 is the input of sample k."""
    from ros2_deepc.gateway.modbus_server import ModbusServer, Registers

    port = free_port()

    async def play():
        server = ModbusServer(Registers(holding=4, inputs=0), "127.0.0.1", port)
        await server.start()
        loop = Loop(TIMER.format(port=port), lead=1)
        running = asyncio.create_task(loop.engine.run())
        await soon(lambda: loop.gateway.auto(time.monotonic()).accepted)
        await soon(lambda: len(loop.y) > SAMPLES)
        await loop.engine.leave()
        await running
        await server.stop()
        return loop

    loop = asyncio.run(play())
    pairs = [(k, loop.y[k + 1], loop.u[k]) for k in loop.u if k in loop.y and k + 1 in loop.y]
    assert len(pairs) > 10
    for k, seen, commanded in pairs:
        assert seen == commanded, k
