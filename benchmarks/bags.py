# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Recording and reading: speed, memory and loss, beside the libraries a user would pick.

    python benchmarks/bags.py                  # all tables, some minutes
    python benchmarks/bags.py write read       # only these
    python benchmarks/bags.py --samples 100000 # a tenth of the long bag

Exits with 1 if a claim is broken; each broken claim is printed. CPU time throughout.
"""

import argparse
import json
import os
import resource
import signal
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from ros2_deepc.bags import BagReader, BagWriter, Recording, load_run, replay
from ros2_deepc.bags.convert import to_cdr
from ros2_deepc.bags.schema import message_definition

SAMPLE, STATE = "deepc_msgs/msg/Sample", "deepc_msgs/msg/ControllerState"
NAMES = ("/bench/outputs", "/bench/inputs")


class Patch:
    """A serialized message whose k is written over: as fast as a wire delivers them."""

    def __init__(self, message: object) -> None:
        message.k = 0x1122334455667788
        data = to_cdr(message)
        self._at = data.index(struct.pack("<Q", message.k))
        self._data = bytearray(data)

    def __call__(self, k: int) -> bytes:
        """The bytes of sample k."""
        struct.pack_into("<Q", self._data, self._at, k)
        return bytes(self._data)


def sample(channels: int) -> Patch:
    """Samples of that many channels, always the same values."""
    from deepc_msgs.msg import Sample

    rng = np.random.Generator(np.random.PCG64(1))
    message = Sample(values=rng.standard_normal(channels).tolist())
    message.header.frame_id = "bench"
    return Patch(message)


def cpu(work: Callable[[], object]) -> float:
    """Processor seconds of this process for one call."""
    begin = time.process_time()
    work()
    return time.process_time() - begin


def peak() -> float:
    """Largest resident memory of this process so far [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def resident(pid: int) -> float:
    """Resident memory of a process [MB]."""
    status = Path(f"/proc/{pid}/status").read_text()
    return next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS")) / 1e3


def bench_write(folder: Path, count: int = 30_000) -> Iterator[str]:
    """Writers on the same 64-channel messages."""
    messages = [sample(64)(k) for k in range(count)]

    def ours() -> None:
        with BagWriter(folder / "ours") as bag:
            bag.add_topic(NAMES[0], SAMPLE)
            for k, data in enumerate(messages):
                bag.write(NAMES[0], data, k * 10**6)

    def rosbags() -> None:
        from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        store = get_typestore(Stores.ROS2_JAZZY)
        store.register(get_types_from_msg(message_definition(SAMPLE).split("=" * 80)[0], SAMPLE))
        bag = Writer(folder / "rosbags", version=9, storage_plugin=StoragePlugin.MCAP)
        bag.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        with bag:
            topic = bag.add_connection(NAMES[0], SAMPLE, typestore=store)
            for k, data in enumerate(messages):
                bag.write(topic, k * 10**6, data)

    def size(name: str) -> float:
        return sum(f.stat().st_size for f in (folder / name).iterdir()) / 1e6

    for name, work in (("ours", ours), ("rosbags", rosbags)):
        seconds = cpu(work)
        rate = f"{count / seconds:10.0f} messages/s CPU"
        yield f"write   {name:10} {rate}   {size(name):7.2f} MB for {count} messages of 64 channels"
    if sum(1 for _ in BagReader(folder / "ours").messages()) != count:
        yield "BROKEN: messages were lost"


def bench_read(folder: Path, count: int = 30_000) -> Iterator[str]:
    """Readers that decode every field, on the same bag."""
    with BagWriter(folder / "read") as bag:
        bag.add_topic(NAMES[0], SAMPLE)
        make = sample(8)
        for k in range(count):
            bag.write(NAMES[0], make(k), k * 10**6)

    def ours() -> int:
        return sum(m.k for _, m in BagReader(folder / "read").decoded())

    def rclpy() -> int:
        from ros2_deepc.bags.convert import from_cdr

        return sum(from_cdr(raw.data, raw.type).k for raw in BagReader(folder / "read").messages())

    def rosbags() -> int:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore

        with AnyReader([folder / "read"], default_typestore=get_typestore(Stores.EMPTY)) as reader:
            return sum(reader.deserialize(data, c.msgtype).k for c, _, data in reader.messages())

    def mcap_ros2() -> int:
        from mcap_ros2.reader import read_ros2_messages

        return sum(m.ros_msg.k for m in read_ros2_messages(str(next((folder / "read").glob("*.mcap")))))

    for work in (ours, rclpy, rosbags, mcap_ros2):
        total: list[int] = []
        seconds = cpu(lambda w=work, t=total: t.append(w()))
        yield f"read    {work.__name__:10} {count / seconds:10.0f} messages/s CPU, decoded"
        if total[0] != count * (count - 1) // 2:
            yield f"BROKEN: {work.__name__} read other numbers"


PUBLISH = """
import sys, time
import rclpy
from deepc_msgs.msg import Sample
from ros2_deepc.ros import topics
from ros2_deepc.ros.qos import profile
rclpy.init()
node = rclpy.create_node("publisher", namespace="/bench")
publisher = node.create_publisher(Sample, "outputs", profile(topics.OUTPUTS))
while not publisher.get_subscription_count():
    time.sleep(0.01)
message = Sample(values=[0.1 * i for i in range(64)])
begin = time.monotonic()
for k in range(int(sys.argv[1])):
    message.k = k
    while True:
        try:
            publisher.publish(message)
            break
        except RuntimeError:
            time.sleep(0.001)
    time.sleep(max(0.0, begin + (k + 1) * 1e-3 - time.monotonic()))
publisher.wait_for_all_acked()
print(time.monotonic() - begin)
time.sleep(0.5)
"""


def bench_record(folder: Path, seconds: float = 60.0) -> Iterator[str]:
    """The recorder node in a process of its own, 1000 messages of 64 channels a second over DDS."""
    count = round(1000 * seconds)
    env = dict(os.environ, ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST", ROS_DOMAIN_ID="99", ROS_LOG_DIR=str(folder))
    command = [sys.executable, "-m", "ros2_deepc.nodes.recorder_node", "--ros-args", "-r", "__ns:=/bench",
               "-p", f"folder:={folder / 'record'}"]  # fmt: skip
    recorder = subprocess.Popen(command, env=env)
    publisher = subprocess.Popen(
        [sys.executable, "-c", PUBLISH, str(count)], env=env, stdout=subprocess.PIPE, text=True
    )
    time.sleep(min(10.0, seconds / 2))
    if recorder.poll() is not None:
        publisher.kill()
        raise SystemExit("the recorder node ended by itself")
    early = resident(recorder.pid)
    took = float(publisher.communicate()[0])
    late = resident(recorder.pid)
    used = sum(map(int, Path(f"/proc/{recorder.pid}/stat").read_text().split()[13:15])) / os.sysconf("SC_CLK_TCK")
    recorder.send_signal(signal.SIGTERM)
    recorder.wait(60)
    ks = [m.k for _, m in BagReader(folder / "record").decoded(["/bench/outputs"])]
    lost = count - len(set(ks))
    yield f"record  {count} messages of 64 channels in {took:.1f} s: {lost} lost, {100 * used / took:.0f} % of one CPU"
    yield f"record  memory {early:.0f} MB early, {late:.0f} MB at the end"
    if lost or ks != sorted(ks):
        yield f"BROKEN: {lost} of {count} messages were lost or came out of order"
    if late > 1.2 * early + 5:
        yield "BROKEN: the recorder's memory grows"


def bench_loop(folder: Path, rounds: int = 3, steps: int = 1000) -> Iterator[str]:
    """Samples a second of processor time of the lockstep loop in one process, with and without the recorder, in turns.

    The recorder's thread is part of the process, so that this is the share of the processor that recording takes.
    """
    rates: dict[bool, list[float]] = {True: [], False: []}
    for turn in range(2 * rounds):
        recorded = turn % 2 == 0
        rates[recorded].append(loop_rate(folder / f"loop{turn}", recorded, steps))
    with_it, without = (float(np.median(rates[recorded])) for recorded in (True, False))
    yield f"loop    {with_it:.0f} samples/s CPU with the recorder, {without:.0f} without: {with_it / without:.0%}"
    if with_it < 0.4 * without:
        yield "BROKEN: the recorder more than halves the loop"


def loop_rate(folder: Path, recorded: bool, steps: int) -> float:
    """Runs the 9-bus grid in lockstep; samples a second of CPU from the first one in control to the last."""
    from ros2_deepc.nodes.config import load, merged, shipped, text_of
    from ros2_deepc.nodes.stack import running
    from ros2_deepc.ros import topics
    from ros2_deepc.ros.qos import profile

    one = int(recorded)
    readers = {
        "plant": {"readers": 3 + one, "steps": steps},  # controller, observer, our own, recorder
        "controller": {"readers_inputs": 1 + one, "readers_state": 1 + one, "T": 104},
        "operator": {"readers": 1 + one},
        "recorder": {"folder": str(folder / "bag")},
    }
    folder.mkdir()
    settings = folder / "settings.yaml"
    settings.write_text(text_of(merged(load(shipped("wscc9")), readers)))
    roles = [*(["recorder"] if recorded else []), "controller", "operator", "plant"]
    times: list[float] = []
    with running(roles, settings, namespace="/bench", domain_id=98) as stack:
        seen = stack.observer
        qos = profile(topics.OUTPUTS)
        seen.create_subscription(topics.OUTPUTS.type, "outputs", lambda _: times.append(time.process_time()), qos)
        stack.spinner.until(lambda: bool(stack.failure()) or len(times) == steps)
        if stack.failure():
            raise RuntimeError(stack.failure())
        stack.finish()
    return (steps - 150) / (times[-1] - times[149])


LONG = {  # what is done with a long bag, each in a process of its own: samples, and CPU a sample that is claimed [us]
    "load": (1.0, 20),
    "report": (1.0, 40),
    "export": (1.0, 60),
    "monitor": (1.0, 60),
    "controller": (0.1, 2000),
}
PEAK, GROWTH = 250.0, 20.0  # [MB]: for any length; and what five times the length may add


def bench_long(folder: Path, samples: int = 1_000_000) -> Iterator[str]:
    """Long bags: loaded, reported, exported, replayed; each in a process of its own, at two lengths."""
    peaks: dict[str, list[float]] = {kind: [] for kind in LONG}
    for share in (0.2, 1.0):
        for kind, (part, claimed) in LONG.items():
            count = round(share * part * samples)
            write = write_loop if kind == "controller" else write_long
            bag = folder / f"{write.__name__}{count}"
            if not bag.exists():
                seconds = cpu(lambda w=write, b=bag, n=count: w(b, n))
                size = sum(f.stat().st_size for f in bag.iterdir()) / 1e6
                yield f"long    {count} samples written in {seconds:.0f} s CPU, {size:.0f} MB"
            command = [sys.executable, __file__, "--alone", kind, str(bag)]
            done = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
            peaks[kind].append(done["peak"])
            told = f"told how far it was {done['told']} times"
            yield f"long    {count} samples: {kind:10} {done['seconds']:6.1f} s CPU, peak {done['peak']:.0f} MB, {told}"
            if done["samples"] != count:
                yield f"BROKEN: {kind} saw {done['samples']} of {count} samples"
            if not done["told"]:
                yield f"BROKEN: {kind} tells nothing while it works"
            if done["seconds"] > 5 + 1e-6 * claimed * count:
                yield f"BROKEN: {kind} takes more than {claimed} us a sample"
    for kind, (short, long) in peaks.items():
        if kind != "load" and (long > PEAK or long > short + GROWTH):
            yield f"BROKEN: the memory of {kind} is not bounded: {short:.0f} MB, five times the length {long:.0f} MB"


def alone(kind: str, bag: Path) -> dict[str, float]:
    """Does one thing with a bag; seconds of CPU, peak memory [MB], samples seen, how often it told how far it was."""
    from ros2_deepc.bags.cores import ControllerCore, MonitorCore
    from ros2_deepc.bags.export import export
    from ros2_deepc.bags.report import write_report
    from ros2_deepc.monitors import Prior
    from ros2_deepc.monitors.live import LiveMonitor
    from ros2_deepc.nodes.controller_node import make_agent, state_message

    told, period = 0, 20_000

    def progress(done: int, total: int) -> None:
        nonlocal told
        told += 0 < done <= total

    def work() -> int:
        if kind == "load":
            return len(load_run(bag, progress=progress))
        if kind == "report":
            return int(write_report(bag, bag.with_suffix(".html"), progress=progress)["steps"])
        if kind == "export":
            with Recording(bag, progress=progress) as recording:
                export(recording, bag.with_suffix(".csv"))
            return sum(1 for _ in bag.with_suffix(".csv").open()) - 1
        if kind == "monitor":
            live = LiveMonitor(Prior(q=2, s=1, n=2), window=200, period=period)
            reports: list[object] = []
            replay(bag, {"monitor": lambda _: MonitorCore(live, reports.append)}, progress=progress)
            outputs = BagReader(bag).topics[NAMES[0]].count
            return outputs if len(reports) == outputs // period else -1
        result = replay(
            bag,
            {"controller": lambda info: ControllerCore(make_agent(SETTINGS, info), state_message)},
            progress=progress,
        )
        return result.compared["controller/state"] if result.same else -1

    begin = time.process_time()
    seen = work()
    return {"seconds": time.process_time() - begin, "peak": peak(), "samples": seen, "told": told}


def write_long(folder: Path, samples: int) -> None:
    """A stable second-order plant under noise, two inputs, two outputs, one state message a sample."""
    from deepc_msgs.msg import ControllerState, PlantInfo, Sample

    rng = np.random.Generator(np.random.PCG64(2))
    A, B, x = np.array([[0.9, 0.1], [0.0, 0.8]]), np.array([[0.3, 0.0], [0.1, 0.5]]), np.zeros(2)
    info = PlantInfo(name="bench", sample_time=0.1, q=2, s=1, n=2, output_names=["a", "b"], input_names=["u", "v"])
    info.input_min, info.input_max, info.output_units, info.input_units = [-1.0] * 2, [1.0] * 2, ["m"] * 2, ["m"] * 2
    state = Patch(ControllerState(mode=2, status=1, reference=[0.0, 0.0], solve_time=1e-3))
    mark = Patch(Sample(values=[1.5, 2.5]))
    at = mark(0).index(struct.pack("<2d", 1.5, 2.5))
    with BagWriter(folder) as bag:
        kinds = {
            "plant_info": "PlantInfo",
            "outputs": "Sample",
            "inputs": "Sample",
            "controller/state": "ControllerState",
        }
        for name, kind in kinds.items():
            bag.add_topic(f"/bench/{name}", f"deepc_msgs/msg/{kind}")
        bag.write("/bench/plant_info", to_cdr(info), 0)
        for k, u in enumerate(rng.uniform(-1, 1, (samples, 2))):
            for name, values in (("inputs", u), ("outputs", x)):
                data = bytearray(mark(k))
                struct.pack_into("<2d", data, at, *values)
                bag.write(f"/bench/{name}", bytes(data), k * 10**8)
            bag.write("/bench/controller/state", state(k), k * 10**8)
            x = A @ x + B @ u


SETTINGS = {"N": 3, "L": 5, "Q": [4.0], "R": [0.5], "terminal": "none", "seed": 11}


def write_loop(folder: Path, samples: int) -> None:
    """A stable second-order plant under the controller, with a new reference every 500 samples."""
    from deepc_msgs.msg import PlantInfo, Sample

    from ros2_deepc.nodes.controller_node import make_agent, state_message

    A, B, x = np.array([[0.9, 0.1], [0.0, 0.8]]), np.array([[0.3, 0.0], [0.1, 0.5]]), np.array([1.0, -1.0])
    info = PlantInfo(name="bench", sample_time=0.1, lockstep=True, q=2, s=1, n=2)
    info.output_names, info.input_names, info.input_min, info.input_max = ["a", "b"], ["u", "v"], [-1.0] * 2, [1.0] * 2
    agent = make_agent(SETTINGS, info)
    with BagWriter(folder) as bag:

        def write(name: str, message: object, k: int) -> None:
            bag.write(f"/bench/{name}", to_cdr(message), max(k, 0) * 10**8)

        for name in ("outputs", "inputs", "reference"):
            bag.add_topic(f"/bench/{name}", SAMPLE)
        bag.add_topic("/bench/plant_info", "deepc_msgs/msg/PlantInfo")
        bag.add_topic("/bench/controller/state", STATE)
        write("plant_info", info, 0)
        for k in range(0, samples, 500):
            values = [0.5, 0.4] if k % 1000 else [0.3, 0.2]
            agent.references.set(k, values)
            write("reference", Sample(k=k, values=values), 0)
        u = agent.start()[0]
        write("inputs", Sample(k=0, values=u.tolist()), 0)
        for k in range(samples):
            write("outputs", Sample(k=k, values=x.tolist()), k)
            decision = agent.step(k, x)
            state = state_message(agent, decision)
            agent.prepare()
            write("inputs", Sample(k=k + 1, values=decision.u.tolist()), k)
            write("controller/state", state, k)
            x, u = A @ x + B @ u, decision.u


def main() -> int:
    """Prints the tables that are asked for; 1 if a claim is broken."""
    tables = {"write": bench_write, "read": bench_read, "record": bench_record, "loop": bench_loop, "long": bench_long}
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tables", nargs="*", choices=[*tables, []], help="default: all")
    parser.add_argument("--samples", type=int, default=1_000_000, help="of the long bag")
    parser.add_argument("--seconds", type=float, default=60.0, help="of the recording")
    parser.add_argument("--alone", nargs=2, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.alone:
        print(json.dumps(alone(chosen.alone[0], Path(chosen.alone[1]))))
        return 0
    options = {"record": (chosen.seconds,), "long": (chosen.samples,)}
    broken = False
    with tempfile.TemporaryDirectory() as folder:
        for name in chosen.tables or tables:
            for line in tables[name](Path(folder), *options.get(name, ())):
                print(line, flush=True)
                broken = broken or line.startswith("BROKEN")
    return int(broken)


if __name__ == "__main__":
    raise SystemExit(main())
