# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Sliding data matrices over 100 000 pushes with a 100 000-fold spike: accuracy against a fresh factor, and CPU time.

Exits non-zero if the factor differs from a fresh one by more than 1e-9 relative once the spike has left, or if a push
takes more than 0.1 ms on average.
"""

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np

from ros2_deepc.behavior import SlidingFactor, SlidingGram, hankel

CHANNELS, BLOCKS = 5, 20  # three inputs and two outputs, N + L = 20


def microseconds(run, count):
    """Median CPU time per call."""
    times = []
    for i in range(count):
        begin = time.process_time_ns()
        run(i)
        times.append(time.process_time_ns() - begin)
    return float(np.median(times)) / 1e3, float(np.mean(times)) / 1e3


def speed(T):
    w = np.random.Generator(np.random.PCG64(0)).normal(size=(3 * T + 4000, CHANNELS))
    row = {"T": T}
    for kind in (SlidingGram, SlidingFactor):
        sliding = kind(CHANNELS, BLOCKS, T - BLOCKS + 1)
        for sample in w[: 2 * T]:
            sliding.push(sample)
        median, mean = microseconds(lambda i, s=sliding: s.push(w[2 * T + i]), 2000)
        row[kind.__name__] = {"push_median_us": median, "push_mean_us": mean}
    row["SlidingFactor"]["factor_us"] = microseconds(lambda i: sliding.factor(), 200)[0]
    H = hankel(w[:T], BLOCKS)
    row["fresh_qr_us"] = microseconds(lambda i: np.linalg.qr(H.T, mode="r"), 50)[0]
    return row


def drift(pushes, columns=81):
    rng = np.random.Generator(np.random.PCG64(1))
    w = rng.normal(size=(pushes, CHANNELS))
    w[pushes // 2] *= 1e5
    after = pushes // 2 + columns + BLOCKS  # the first push after which the spike has left
    both = {kind.__name__: kind(CHANNELS, BLOCKS, columns) for kind in (SlidingGram, SlidingFactor)}
    errors = {name: {} for name in both}
    for k, sample in enumerate(w):
        for name, sliding in both.items():
            sliding.push(sample)
            if k + 1 in (after, pushes):
                H = hankel(w[k + 2 - columns - BLOCKS : k + 1], BLOCKS)
                S = sliding.matrix if name == "SlidingGram" else sliding.factor().T @ sliding.factor()
                errors[name][k + 1] = float(np.linalg.norm(S - H @ H.T, 2) / np.linalg.norm(H @ H.T, 2))
    return errors


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pushes", type=int, default=100_000)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    rows = [speed(T) for T in (100, 400, 1600)]
    print("CPU microseconds          push (median, mean)        factor   fresh QR")
    for row in rows:
        g, f = row["SlidingGram"], row["SlidingFactor"]
        print(f"T = {row['T']:5d}  Gram    {g['push_median_us']:8.1f} {g['push_mean_us']:8.1f}")
        print(
            f"           factor  {f['push_median_us']:8.1f} {f['push_mean_us']:8.1f}      {f['factor_us']:8.0f}"
            f"   {row['fresh_qr_us']:8.0f}"
        )
    errors = drift(args.pushes)
    for name, by_push in errors.items():
        for k, error in by_push.items():
            print(f"{name}: relative difference from a fresh one after {k} pushes: {error:.1e}")
    if args.json:
        args.json.write_text(json.dumps({"speed": rows, "drift": errors}, indent=1))
    worst = max(e for by_push in errors.values() for e in by_push.values())
    if worst > 1e-9:
        sys.exit(f"a sliding matrix differs from a fresh one by {worst:.1e}")
    slowest = max(row[kind]["push_mean_us"] for row in rows for kind in ("SlidingGram", "SlidingFactor"))
    if slowest > 100:
        sys.exit(f"a push takes {slowest:.0f} us")


if __name__ == "__main__":
    main()
