# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""A long run in lockstep, all nodes in one process: does it grow, does it drift? Exits non-zero if it does.

python benchmarks/soak.py [--steps 100000] [--record]

The window of the 9-bus grid slides all the time, with a little dither, while references come and go. At every check the
predictions just published are compared with those of the true model, for the same planned inputs, from the state
that explains the newest outputs; memory, threads and files are those of this process.
"""

import argparse
import ctypes
import gc
import os
import sys
import tempfile
import threading
import time
from collections import deque
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from plant_sim import wscc9
from ros2_deepc.nodes.config import load, merged, shipped, text_of
from ros2_deepc.nodes.stack import running

GROWTH = 1.0  # MB per 100 000 samples, after warm-up
DRIFT = 1e-8  # error of a prediction relative to the largest one, as in tests/control/test_claims.py
WARM_UP = 0.1  # share of the run
PAST = 12  # samples that tell the state
ROLES = ("monitor", "controller", "operator", "plant")


class Truth:
    """Keeps the newest samples of a zone and predicts with the plant's own model."""

    def __init__(self, observer):
        form = wscc9().system.weierstrass()
        self.A, self.B, self.C, self.D = form.A1, form.B1, form.C1, form.D
        self._observer = observer
        self.y, self.u = deque(maxlen=PAST), deque(maxlen=PAST + 1)

    def look(self):
        """Takes what has arrived; call it after every message. True when a sample is complete."""
        outputs, state = self._observer.outputs, self._observer.state
        if outputs is None or state is None or (outputs.epoch, outputs.k) != (state.epoch, state.k):
            return False
        if self.y and self.y[-1][0] == outputs.k:
            return False
        if outputs.held or not state.input or (self.y and self.y[-1][0] != outputs.k - 1):
            self.y.clear()
        if not state.input:  # decided before, when these outputs were overdue
            return False
        self.y.append((int(outputs.k), np.array(outputs.values)))
        self.u.append((int(state.k) + 1, np.array(state.input)))
        return True

    def error(self):
        """Largest error of the plan's outputs, relative to the largest output planned; None without a plan."""
        state, p = self._observer.state, len(self.C)
        if not self.y:
            return None
        u = dict(self.u)
        first = self.y[0][0] + 1  # u of the first output is not among those seen
        samples = [(k, y) for k, y in self.y if k >= first]
        if not state.output_plan or len(samples) < PAST - 1 or samples[-1][0] != state.k:
            return None
        seen, forced, x = [], [], np.zeros(len(self.A))
        power = np.eye(len(self.A))
        for k, y in samples:
            seen.append(self.C @ power)
            forced.append(y - self.C @ x - self.D @ u[k])
            power, x = self.A @ power, self.A @ x + self.B @ u[k]
        x = power @ np.linalg.lstsq(np.vstack(seen), np.concatenate(forced), rcond=None)[0] + x
        planned = np.reshape(state.output_plan, (-1, p))
        exact = np.empty_like(planned)
        for i, v in enumerate(np.reshape(state.input_plan, (len(planned), -1))):
            exact[i] = self.C @ x + self.D @ v
            x = self.A @ x + self.B @ v
        return float(np.abs(exact - planned).max() / max(1.0, np.abs(exact).max()))


def settings(steps, folder, record):
    """Parameters of the zone: a window that always moves, references that change twenty times."""
    starts = list(range(0, steps, max(steps // 20, 200)))
    changes = {
        "plant": {"steps": steps, "readers": 3 + record},
        "controller": {
            "data_policy": "sliding",
            "dither": [0.1],
            "terminal": "none",
            "readers_inputs": 2 + record,
            "readers_state": 1 + record,
        },
        "monitor": {"readers": 1 + record},
        "operator": {
            "reference_k": starts,
            "reference_values": [v for i in range(len(starts)) for v in ((-0.5) ** (i % 3), 0.0)],
            "readers": 1 + record,
        },
    }
    if record:
        # MCAP keeps an index of the open file in memory, 1.3 kB a chunk: files small enough to see what else grows
        changes["recorder"] = {"folder": str(folder / "bag"), "max_size": 10.0}
    return merged(load(shipped("wscc9")), changes)


class _Mallinfo(ctypes.Structure):
    """struct mallinfo2 of glibc [bytes], summed over all arenas."""

    _names = "arena ordblks smblks hblks hblkhd usmblks fsmblks uordblks fordblks keepcost"
    _fields_ = [(name, ctypes.c_size_t) for name in _names.split()]


def heap():
    """The C heap of this process, which DDS and numpy live on [MB]: in use, and freed but kept by malloc."""
    ask = ctypes.CDLL(None).mallinfo2
    ask.restype = _Mallinfo
    info = ask()
    return (info.uordblks + info.hblkhd) / 2**20, info.fordblks / 2**20


def resources():
    """What this process holds: resident memory [MB], objects of Python, threads, open files."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    threads = len(os.listdir("/proc/self/task"))
    files = len(os.listdir("/proc/self/fd"))
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20, len(gc.get_objects()), threads, files


def soak(steps, checks, *, record=False, domain_id=None, tell=lambda _line: None):
    """Runs ``steps`` samples and looks ``checks`` times, evenly spread.

    Returns:
        Array of shape (checks, 10): samples done, MB, objects, threads, files, error of the predictions (NaN while
        there are none), samples a second since the last check, MB of the C heap in use, MB of it that are free, blocks
        of Python's own allocator.
    """
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        file = folder / "parameters.yaml"
        file.write_text(text_of(settings(steps, folder, record)), encoding="utf-8")
        roles = (("recorder",) if record else ()) + ROLES
        with running(roles, file, namespace="/soak", domain_id=domain_id) as stack:
            seen = stack.observer
            truth, stops = Truth(seen), [round((i + 1) * steps / checks) for i in range(checks)]
            last = time.perf_counter(), 0

            def check():
                nonlocal last
                if not truth.look() or seen.state.k + 1 < stops[len(rows)]:
                    return
                now, done = time.perf_counter(), int(seen.state.k) + 1
                error = truth.error()
                rate = (done - last[1]) / (now - last[0])
                found = resources()
                heaps = *heap(), sys.getallocatedblocks()
                rows.append((done, *found, np.nan if error is None else error, rate, *heaps))
                last = now, done
                tell(rows[-1])
                if len(rows) == checks:
                    seen.on_change = lambda: None
                    stack.spinner.wake()

            def over():
                return len(rows) == checks or bool(stack.failure())

            seen.on_change = check
            stack.spinner.until(over)
            if stack.failure():
                raise SystemExit(
                    f"the run broke down after {0 if seen.state is None else seen.state.k} samples: {stack.failure()}"
                )
            modes = seen.state.mode, seen.state.failures, seen.state.refused
    if modes != (seen.state.CONTROLLING, 0, 0):
        raise SystemExit(f"mode, failures, refused = {modes} at the end")
    return np.array(rows)


def slopes(rows, column=1):
    """Growth of a column after warm-up, per 100 000 samples.

    Returns:
        Median of the slopes between any two checks (Theil-Sen), and the slope by least squares. A leak shows in both. A
        pool that once grows by a step and is never given back, as those of DDS do when a reader lags on a busy machine,
        shows in the second.
    """
    late = rows[rows[:, 0] > WARM_UP * rows[-1, 0]]
    done, size = late[:, 0], late[:, column]
    i, j = np.triu_indices(len(late), 1)
    typical = np.median((size[j] - size[i]) / (done[j] - done[i]))
    return float(typical) * 1e5, float(np.polyfit(done, size, 1)[0]) * 1e5


def main():
    """Prints the table and judges it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=100_000)
    parser.add_argument("--checks", type=int, default=40)
    parser.add_argument("--record", action="store_true", help="with a recorder; the bag is thrown away")
    parser.add_argument("--domain", type=int, default=None, help="DDS domain")
    args = parser.parse_args()
    names = ["samples", "MB", "objects", "threads", "files", "error", "samples/s", "heap", "free", "blocks"]
    print(("{:>9}" * 10).format(*names))

    def tell(row):
        done, size, objects, threads, files, error, rate, used, free, blocks = row
        print(
            f"{done:9d}{size:9.2f}{objects:9d}{threads:9d}{files:9d}{error:9.1e}{rate:9.0f}"
            f"{used:9.2f}{free:9.2f}{blocks:9d}",
            flush=True,
        )

    rows = soak(args.steps, args.checks, record=args.record, domain_id=args.domain, tell=tell)
    print("growth per 100 000 samples after warm-up:      median of slopes  least squares")
    for name, column in (("resident memory [MB]", 1), ("C heap in use [MB]", 7), ("Python's blocks", 9)):
        print(f"  {name:44}{slopes(rows, column)[0]:+17.2f}{slopes(rows, column)[1]:+15.2f}")
    growth, drift = max(slopes(rows)), float(np.nanmax(rows[:, 5]))
    print(f"memory: {growth:+.2f} MB per 100 000 samples by the worse of the two, goal below {GROWTH}")
    print(f"predictions: largest error {drift:.1e}, goal below {DRIFT:.0e}")
    print(f"threads of Python at the end: {threading.active_count()}")
    return int(not (growth < GROWTH and drift < DRIFT))


if __name__ == "__main__":
    with threadpool_limits(limits=1):
        sys.exit(main())
