"""Cost of a network in each cell: a simulated hour of a growing ball, with and without.

The network is the cell cycle of Alarcon 2004, driven by oxygen, which divides the cells; both
scenes have the oxygen. Steps of both are taken in turn, in CPU time on one thread, so that a busy
machine slows both; a cell's cost is compared, since one scene may have more cells than the other.
Cells begin in one state of the cycle, which costs most while they pass from one of its branches to
the other: the rounds are to be a whole cycle. The first hours compile and do not count.
Cost: a minute at 5,000 cells.
Command: python tests/benchmarks/network_cost.py [--cells 5000] [--rounds 9] [--skipped 10]
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "helpers"))

from cycling_networks import alarcon

import multicell as mc

STEPS = 6  # of ten minutes, in an hour


def scenes(count):
    """Return the scene without the network and that with it."""
    phases = {"G1": "5 h", "S": "3 h", "G2": "70 min", "M": "10 min"}
    plain = mc.load_scene("growth").with_changes(
        {
            "initial.count": count,
            "initial.stage": "asynchronous",
            "coupling_step": "10 min",
            "duration": "100 h",
            "growth.cycle_time": None,
            "growth.restriction": False,
            "growth.phases": {name: {"duration": length} for name, length in phases.items()},
            "nutrients": {"oxygen": {"boundary": "10 %", "uptake": "5 amol/s", "spacing": 20.0}},
        }
    )
    table = {
        "network": alarcon,
        "inputs": {"P": "oxygen"},
        "scales": {"P": 10.0},
        "dilution": False,
        "divide": {"m": "halve"},
    }
    driven = {"networks": {"cycle": table}, "growth.phases.G1.after": "cycle.x < 0.004"}
    return plain, plain.with_changes(driven)


def main():
    """Print the CPU time of an hour of both scenes."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--cells", type=int, default=5000)
    options.add_argument("--rounds", type=int, default=9, help="hours: a cycle")
    options.add_argument("--skipped", type=int, default=10, help="hours before that")
    given = options.parse_args()
    both = [mc.Simulation(scene, threads=1) for scene in scenes(given.cells)]
    for simulation in both:
        for _ in range(STEPS * given.skipped):
            simulation.step()
    before = steps_of(both[1])
    taken, cells = [0.0, 0.0], [0, 0]
    for _ in range(STEPS * given.rounds):
        for k, simulation in enumerate(both):
            begin = time.process_time()
            simulation.step()
            taken[k] += time.process_time() - begin
            cells[k] += len(simulation.cells)
    base, driven = (1e6 * time / count for time, count in zip(taken, cells, strict=True))
    for word, k in (("without", 0), ("with", 1)):
        count, hour = cells[k] / STEPS / given.rounds, taken[k] / given.rounds
        print(f"an hour {word} the network: {hour:.2f} s of CPU, {count:.0f} cells in the mean")
    print(f"a cell and step: {base:.2f} us without, {driven:.2f} us with")
    print(
        f"the network: {driven - base:.2f} us a cell and step, {100 * (driven / base - 1):+.0f} %"
    )
    print(f"steps of the solver a cell and step: {(steps_of(both[1]) - before) / cells[1]:.2f}")


def steps_of(simulation):
    """Return how many steps the solver of the network has taken in all cells."""
    return simulation.plan.networks.parts["cycle"].solver.work[0]


if __name__ == "__main__":
    main()
