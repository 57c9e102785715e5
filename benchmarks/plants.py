# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Plants: what random systems of known structure, grids and water networks show, and how long they take.

    python benchmarks/plants.py [--systems 2000] [--networks FOLDER]

Prints tables and exits with 1 if a claim fails. FOLDER may hold any .inp files (wntr ships some).
Grids come from pypower and Net3's second opinion from wntr, where installed.
"""

import argparse
import sys
import time
import warnings
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from plant_sim import PlantError, UnclearStructureError
from plant_sim.hydraulics import JUNCTION, TANK, snapshot
from plant_sim.power import from_case
from plant_sim.random_systems import order, random_planted
from plant_sim.stepper import LinearStepper
from plant_sim.water import NET3, from_inp

FAILED = []


def claim(text, holds):
    """Prints a claim with its outcome and remembers a failure."""
    print(f"{'ok  ' if holds else 'FAIL'} {text}")
    if not holds:
        FAILED.append(text)


def check(planted, rng):
    """Of one system: wrong q, r, s; number of wrong answers; all clear; residual of a run; other bits in the stream."""
    system, form, found = planted.system, planted.system.weierstrass(), planted.system.structure()
    wrong = (form.q, form.r, form.s) != (planted.q, planted.r, planted.s)
    answers = [
        (found.r_controllable, planted.r_controllable), (found.c_controllable, planted.c_controllable),
        (found.r_observable, planted.r_observable), (found.c_observable, planted.c_observable),
        (found.controllability.rank, planted.q - order(planted.uncontrollable_modes)),
        (found.observability.rank, planted.q - order(planted.unobservable_modes)),
    ]  # fmt: skip
    u, z10 = rng.uniform(-1, 1, (20 + form.s - 1, system.m)), rng.standard_normal(form.q)
    run = system.simulate(u, z10)
    residual = max(
        np.abs(run.x[1:] @ system.E.T - run.x[:-1] @ system.A.T - run.u[:-1] @ system.B.T).max(),
        np.abs(run.y - run.x @ system.C.T - run.u @ system.D.T).max(),
    ) / max(1.0, np.abs(run.x).max())
    stepper = LinearStepper(form, z10)
    stream = np.array([y for y in map(stepper.push, u) if y is not None])
    clear = found.controllability.clear and found.observability.clear
    return wrong, sum(have != want for have, want in answers), clear, residual, stream.tobytes() != run.y.tobytes()


def random_systems(count):
    """The planted structure is found, trajectories solve the equations, streaming equals batch."""
    print(f"\n{count} random systems: m, p in 1..4, q in 0..12, s in 1..3, with and without lost modes")
    titles = ("cond S, P", "systems", "q r s wrong", "clear wrong", "unclear", "refused", "residual", "CPU ms")
    print(" ".join(f"{title:>11}" for title in titles))
    for conditioning, share in ((10.0, 1.0), (100.0, 0.25), (1000.0, 0.25)):
        number = max(1, int(count * share))
        structure = answers = unclear = refused = bits = 0
        worst, start = 0.0, time.process_time()
        for index in range(number):
            rng = np.random.Generator(np.random.PCG64([index, 11]))
            try:
                wrong, bad, clear, residual, differs = check(random_planted(rng, conditioning), rng)
            except UnclearStructureError:
                refused += 1
                continue
            structure, answers, unclear = structure + wrong, answers + (bad > 0 and clear), unclear + (not clear)
            worst, bits = max(worst, residual), bits + differs
        cost = 1e3 * (time.process_time() - start) / number
        counts = (number, structure, answers, unclear, refused)
        print(f"{conditioning:11g} {' '.join(f'{n:11d}' for n in counts)} {worst:11.1e} {cost:11.1f}")
        claim(f"condition {conditioning:g}: q, r, s as planted, or refused as unclear", structure == 0)
        claim(f"condition {conditioning:g}: all answers as planted, or called unclear", answers == 0)
        claim(f"condition {conditioning:g}: streaming has the bits of the batch", bits == 0)
        if conditioning == 10.0:
            claim("condition 10: nothing refused or unclear", refused + unclear == 0)
            claim("condition 10: residuals below 1e-10", worst < 1e-10)


def grids():
    """Structure and time of standard grids."""
    if find_spec("pypower") is None:
        print("\nno pypower, no grids")
        return
    pypower = import_module("pypower.api")
    print(f"\n{'grid':>8} {'n':>5} {'q':>5} {'r':>5} {'s':>3} {'build ms':>9} {'structure ms':>13} {'residuals':>18}")
    for name in ("case9", "case14", "case30", "case39", "case57", "case118", "case300"):
        case = getattr(pypower, name)()
        start = time.process_time()
        plant = from_case(case, name=name)
        built = time.process_time()
        found = plant.system.structure()
        done = time.process_time()
        n, q, r, s = plant.prior
        first, second = plant.system.weierstrass().residuals
        print(f"{name:>8} {n:5d} {q:5d} {r:5d} {s:3d} {1e3 * (built - start):9.1f} {1e3 * (done - built):13.1f}"
              f" {first:9.1e}{second:9.1e}")  # fmt: skip
        claim(
            f"{name}: two slow states a machine, s = 1, controllable from its machines",
            q % 2 == 0 and s == 1 and found.r_controllable,
        )


def waters(folder):
    """Every network builds or says why not."""
    files = sorted(folder.rglob("*.inp")) if folder else [NET3]
    print(f"\n{'network':>40} {'n':>5} {'q':>4} {'r':>5} {'CPU s':>7}  notes")
    for path in files:
        start = time.process_time()
        try:
            network = snapshot(path, 0)
            tanks = [node.name for node in network.nodes if node.kind == TANK]
            junctions = [node.name for node in network.nodes if node.kind == JUNCTION]
            plant = from_inp(path, 0, inputs=(junctions or tanks)[-1:], outputs=(tanks or junctions)[:3])
        except PlantError as error:
            print(f"{path.name:>40} {'refused':>16} {time.process_time() - start:7.2f}  {error}")
            continue
        n, q, r, _ = plant.prior
        print(f"{path.name:>40} {n:5d} {q:4d} {r:5d} {time.process_time() - start:7.2f}  {'; '.join(plant.notes)[:90]}")


def second_opinion():
    """Net3's steady state beside wntr's own solver, hour by hour."""
    if find_spec("wntr") is None:
        print("\nno wntr, no second opinion on Net3")
        return
    wntr = import_module("wntr")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        network = wntr.network.WaterNetworkModel(str(NET3))
        network.options.time.duration = 6 * 3600
        result = wntr.sim.WNTRSimulator(network).run_sim(solver_options={"TOL": 1e-9})
    print(f"\n{'Net3 hour':>9} {'head, m':>9} {'flow, m3/s':>11}   largest difference to wntr's own solver")
    for hour in (1, 2, 3, 4, 5, 6):
        ours = snapshot(NET3, hour)
        heads, flows = (result.node["head"].loc[hour * 3600], result.link["flowrate"].loc[hour * 3600])
        head = max(abs(node.head - heads[node.name]) for node in ours.nodes)
        flow = max(abs(link.flow - flows[link.name]) for link in ours.links)
        print(f"{hour:9d} {head:9.1e} {flow:11.1e}")
        claim(f"hour {hour}: within 1 mm and 0.1 l/s", head < 1e-3 and flow < 1e-4)


def main():
    """Runs all parts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--systems", type=int, default=2000)
    parser.add_argument("--networks", type=Path)
    arguments = parser.parse_args()
    with threadpool_limits(1):
        random_systems(arguments.systems)
        grids()
        waters(arguments.networks)
        second_opinion()
    print(f"\n{len(FAILED)} claims failed" if FAILED else "\nevery claim holds")
    return 1 if FAILED else 0


if __name__ == "__main__":
    sys.exit(main())
