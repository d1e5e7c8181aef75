"""Cost, memory and results of a network in many cells, compared with libRoadRunner.

Every cell begins with other states. libRoadRunner has an instance for each cell, as PhysiCell has,
and is called cell by cell, once in the same steps and once every 0.01 min, as PhysiCell does (for
some cells and a part of the time); this package solves all cells in one loop on one thread, at the
same tolerance. A part of the cells is enough for libRoadRunner's cost: it is proportional to their
number. Times are CPU times, so that a busy machine does not matter.
Cost: about a minute.
Command: python tests/benchmarks/compare_roadrunner.py [MODEL] [--cells 10000] [--compared 200]
    [--hours 1] [--step 0.1] [--tolerance 1e-7]

MODEL is a file of SBML or Antimony; a model of this package's tests without any. PhysiCell's is
sample_projects_intracellular/ode/ode_energy/config/Toy_Metabolic_Model.xml.
"""

from __future__ import annotations

import argparse
import resource
import sys
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
import roadrunner

from multicell.networks.antimony_text import sbml_of
from multicell.networks.files import read_network
from multicell.networks.solver import NetworkSolver

USUAL = Path(__file__).parents[1] / "networks" / "energy.ant"


def starts_of(network, count):
    """Return states of cells around those of the file, (n, s): a factor from 0.2 to 2 each."""
    factors = np.random.default_rng(1).uniform(0.2, 2.0, (count, len(network.states)))
    return np.array(network.start) * factors


def resident():
    """Return the memory of this process in bytes."""
    pages = Path("/proc/self/statm").read_text().split()[1]
    return int(pages) * resource.getpagesize()


def ours(network, starts, times, tolerance, absolute):
    """Return the states at the end and how long a step of all cells took, s each."""
    solver = NetworkSolver(network, relative=tolerance, absolute=absolute)
    none = np.zeros((len(starts), 0))
    taken = []
    for _ in range(2):  # compiles, then measures
        inside = solver.begin(len(starts))
        inside.y[:] = starts
        taken.clear()
        for begin, end in pairwise(times):
            before = time.process_time()
            inside = solver.advance(inside, none, none, begin, end - begin)
            taken.append(time.process_time() - before)
    held = inside.y.nbytes + inside.p.nbytes + inside.memory.nbytes
    return inside.y, float(np.sum(taken)), held / len(starts)


def theirs(text, network, starts, times, tolerance, absolute):
    """Return the states at the end, the time of all calls in s, of an instance, and its memory."""
    before, began = resident(), time.process_time()
    cells = [roadrunner.RoadRunner(text) for _ in starts]
    instance = (time.process_time() - began) / len(cells)
    memory = (resident() - before) / len(cells)
    names = [selection(cells[0], name) for name in network.states]
    for cell, start in zip(cells, starts, strict=True):
        cell.integrator.relative_tolerance = tolerance
        cell.integrator.absolute_tolerance = absolute
        for name, value in zip(names, start, strict=True):
            cell[name] = value
    taken = 0.0
    for begin, end in pairwise(times):
        before = time.process_time()
        for cell in cells:
            cell.simulate(begin, end, 2)
        taken += time.process_time() - before
    found = np.array([[cell[name] for name in names] for cell in cells])
    return found, taken, instance, memory


def called_often(text, network, starts, interval, tolerance, absolute, count=500):
    """Return the time of one of many short calls, s."""
    times = interval * np.arange(count + 1)
    return theirs(text, network, starts, times, tolerance, absolute)[1] / count / len(starts)


def selection(cell, name):
    """Return how libRoadRunner calls a state: concentrations of species in brackets."""
    return f"[{name}]" if f"[{name}]" in cell.keys() else name  # noqa: SIM118 - no mapping


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("model", nargs="?", type=Path, default=USUAL)
    parser.add_argument("--cells", type=int, default=10_000)
    parser.add_argument("--compared", type=int, default=200)
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--step", type=float, default=0.1, help="of coupling, h")
    parser.add_argument("--tolerance", type=float, default=1e-7)
    parser.add_argument("--absolute", type=float, help="in the model's units; relative / 100")
    options = parser.parse_args()
    network = read_network(options.model)
    text = options.model.read_text()
    if not text.lstrip().startswith("<"):
        text = sbml_of(text, options.model.name)
    second = network.time_unit or 1.0
    count = round(options.hours / options.step)
    times = np.linspace(0.0, options.hours * 3600.0 / second, count + 1)
    starts = starts_of(network, options.cells)
    absolute = options.absolute or 1e-2 * options.tolerance
    mine, taken, held = ours(network, starts, times, options.tolerance, absolute)
    some = starts[: options.compared]
    found, calls, instance, memory = theirs(text, network, some, times, options.tolerance, absolute)
    scale = np.maximum(np.abs(found).max(axis=0), 1e-300)
    off = np.abs(mine[: len(some)] - found) / scale
    often = 0.01 * 60.0 / second
    short = called_often(text, network, some[:10], often, options.tolerance, absolute)
    calls_an_hour = 6000.0
    per_cell = taken / options.cells / count * 1e6
    per_call = calls / len(some) / count * 1e6
    print(f"{options.model.name}: {len(network.states)} states, {len(network.events)} events")
    print(f"{options.cells:,} cells, {options.hours:g} h in {count} steps, {options.tolerance:g}")
    print("\n| | multicell | libRoadRunner | ratio |\n|---|---|---|---|")
    print(f"| µs a cell and step | {per_cell:.3g} | {per_call:.3g} | {per_call / per_cell:.0f} |")
    print(f"| bytes a cell | {held:.0f} | {memory:.3g} | {memory / held:.0f} |")
    hour, own = short * calls_an_hour, taken / options.cells / options.hours
    print(f"| ms a cell and hour, called every 0.01 min | {own * 1e3:.3g} | {hour * 1e3:.3g} "
          f"| {hour / own:.0f} |")  # fmt: skip
    print(f"| s for all cells | {taken:.3g} | {per_call * options.cells * count / 1e6:.3g} | |")
    print(f"| ms to make a cell | | {instance * 1e3:.2g} | |")
    print(f"\nLargest difference over the largest value of a state: {off.max():.2e}")
    worst = np.unravel_index(np.argmax(off), off.shape)
    print(
        f"in '{network.states[worst[1]]}' of cell {worst[0]}: {mine[worst]:.9g}, {found[worst]:.9g}"
    )
    sys.exit(0 if off.max() <= 1e-5 else 1)


if __name__ == "__main__":
    main()
