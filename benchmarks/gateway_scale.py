# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""A thousand tags at 10 Hz: age of the values when the gateway publishes them, and processor time, server included.

Exits with 1 if the 99th percentile of the age is one period or more, or if a vector was put together from two scans of
the field. Needs the extras modbus and opcua.
"""

import asyncio
import contextlib
import sys
import time
from collections.abc import Awaitable, Callable
from typing import Any

import numpy as np

from ros2_deepc.gateway import Gateway, Outputs, loads
from ros2_deepc.gateway.engine import Engine
from ros2_deepc.gateway.field import every
from ros2_deepc.gateway.link import make_link
from ros2_deepc.gateway.modbus_codec import encode
from ros2_deepc.gateway.modbus_server import ModbusServer, Registers
from ros2_deepc.gateway.opcua_server import Access, OpcuaServer

TAGS, PERIOD, SECONDS = 1000, 0.1, 10.0
PORTS = {"modbus": 15502, "opcua": 15840}

HEAD = f"plant: {{name: big, sample_time: {PERIOD}}}\n"
INPUT = "inputs:\n  - {{name: u, unit: '', limits: [-1, 1], max_rate: 99, safe: 0, at: {at}}}\n"


def modbus() -> tuple[str, Any]:
    """Floats in holding registers, in blocks."""
    registers = Registers(holding=10, inputs=1 + 2 * TAGS)
    server = ModbusServer(registers, "127.0.0.1", PORTS["modbus"])

    async def put(count: int) -> None:
        registers.tables["input"][1:] = encode(np.full(TAGS, float(count)), "float32")
        registers.tables["input"][0] = count

    text = (
        HEAD + f"link: {{kind: modbus, host: 127.0.0.1, port: {PORTS['modbus']}}}\n"
        "sampling: {by: scan, counter: {table: input, address: 0, type: uint16}}\n"
        f"outputs:\n  - {{name: y, unit: '', count: {TAGS}, at: {{table: input, address: 1}}}}\n"
    ) + INPUT.format(at="{address: 0}")
    return text, (server.start, put, server.stop)


def opcua(array: bool) -> tuple[str, Any]:
    """Doubles in one array node, or in a node each."""
    server = OpcuaServer("big", "urn:big", f"opc.tcp://127.0.0.1:{PORTS['opcua']}", Access())
    names = ["y"] if array else [f"y{i}" for i in range(TAGS)]
    start: dict[str, Any] = {"count": 0, "u": 0.0} | dict.fromkeys(names, [0.0] * TAGS if array else 0.0)

    async def put(count: int) -> None:
        for name in names:
            await server.put(name, [float(count)] * TAGS if array else float(count))
        await server.put("count", count)

    if array:
        outputs = f"  - {{name: y, unit: '', count: {TAGS}, at: {{node: 'nsu=urn:big;s=y'}}}}\n"
    else:
        outputs = "".join(f"  - {{name: y{i}, unit: '', at: {{node: 'nsu=urn:big;s=y{i}'}}}}\n" for i in range(TAGS))
    text = (
        HEAD + f"link: {{kind: opcua, url: 'opc.tcp://127.0.0.1:{PORTS['opcua']}', allow_insecure_loopback: true, "
        "timeout: 5}\n"
        f"sampling: {{by: scan, poll: {PERIOD / 4}, counter: {{node: 'nsu=urn:big;s=count'}}}}\noutputs:\n{outputs}"
    ) + INPUT.format(at="{node: 'nsu=urn:big;s=u'}")
    return text, (lambda: server.start(start), put, server.stop)


async def measure(
    text: str, start: Callable[[], Awaitable[None]], put: Callable[[int], Awaitable[None]], stop: Any,
    seconds: float = SECONDS,
) -> tuple[np.ndarray, int, float]:  # fmt: skip
    """Ages [s] of the values of every sample, vectors from more than one scan, and processor seconds per second."""
    await start()
    count, at = 0, 0.0
    torn = 0
    ages: list[float] = []

    def take(outputs: Outputs) -> None:
        nonlocal torn
        ages.append(time.monotonic() - at)
        torn += bool((outputs.vector.values != outputs.vector.values[0]).any())

    async def scan(_now: float) -> None:
        nonlocal count, at
        count, at = count + 1, time.monotonic()
        await put(count)

    gateway = Gateway(loads(text), time.monotonic())
    engine = Engine(gateway, make_link(gateway.tags), on_outputs=take)
    tasks = [asyncio.create_task(every(PERIOD, scan)), asyncio.create_task(engine.run())]
    await asyncio.sleep(1.0)
    ages.clear()
    began = time.process_time()
    await asyncio.sleep(seconds)
    used = (time.process_time() - began) / seconds
    engine.stop()
    for task in tasks:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task
    await stop()
    return np.array(ages), torn, used


def main() -> int:
    """Prints the table; a node each is shown for comparison and not judged."""
    print(f"{TAGS} tags, one vector every {1e3 * PERIOD:g} ms, server and gateway in one process")
    print(f"{'how':32} {'vectors/s':>9} {'age ms: median':>14} {'p99':>7} {'torn':>6} {'CPU':>6}")
    broken = False
    for name, (text, parts), judged in (
        ("Modbus, float32, 16 requests", modbus(), True),
        ("OPC UA, one array", opcua(array=True), True),
        ("OPC UA, a node each", opcua(array=False), False),
    ):
        ages, torn, used = asyncio.run(measure(text, *parts))
        median, worst = np.median(ages), np.quantile(ages, 0.99)
        print(f"{name:32} {len(ages) / SECONDS:9.1f} {1e3 * median:14.1f} {1e3 * worst:7.1f} {torn:6d} {used:6.0%}")
        broken |= judged and (worst >= PERIOD or torn > 0)
    return int(broken)


if __name__ == "__main__":
    sys.exit(main())
