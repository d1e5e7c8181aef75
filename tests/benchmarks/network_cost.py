"""Cost of a network in each cell: a simulated hour of a growing ball, with and without.

The network is the cell cycle of Alarcon 2004, driven by oxygen, which divides the cells; both
scenes have the oxygen. Steps of both are taken in turn, in CPU time on one thread, so that a busy
machine slows both. The first hours compile, and bring cells out of step; they do not count.
Cost: a minute at 5,000 cells.
Command: python tests/benchmarks/network_cost.py [--cells 5000] [--rounds 9] [--skipped 10]
"""

from __future__ import annotations

import argparse
import statistics
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
    before = both[1].plan.networks.parts["cycle"].solver.work[0]
    taken = [[], []]
    for _ in range(STEPS * given.rounds):
        for simulation, times in zip(both, taken, strict=True):
            begin = time.process_time()
            simulation.step()
            times.append(time.process_time() - begin)
    hours = [STEPS * statistics.fmean(times) for times in taken]
    more = hours[1] - hours[0]
    cells = len(both[1].cells)
    work = both[1].plan.networks.parts["cycle"].solver.work
    print(f"cells: {len(both[0].cells)} without, {cells} with; divisions {both[1].divisions}")
    print(f"an hour without the network: {hours[0]:.2f} s of CPU")
    print(f"an hour with it:             {hours[1]:.2f} s, {100 * more / hours[0]:+.0f} %")
    print(f"the network: {1e6 * more / STEPS / cells:.2f} us a cell and step")
    print(f"steps of the solver a cell and step: {(work[0] - before) / cells / len(taken[1]):.2f}")


if __name__ == "__main__":
    main()
