"""Cost of the look for contacts that form within a step, over that of the step.

Problem   a coupling step of the diagram (docs/programs/tile_problems.py): typical tissue at a λΔt
          of 1000, by `rosenbrock` or `cvode` at its default tolerance, on one thread
Measured  CPU time in Mechanics.missed_contact over that of the whole solve, and the CPU time of the
          solve over that of one that is given the same answers without a look: medians of solves
          in turns
Cost      printed; 10,000 cells take about a minute with the growth of the state
Command   python tests/benchmarks/watch_cost.py --cells 10000 100000    (--rounds 5)
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from statistics import median

import numpy as np

from multicell.comparison.ladders import find_method
from multicell.comparison.replay import replay
from multicell.mechanics.system import Mechanics

sys.path.insert(0, str(Path(__file__).parents[2] / "docs" / "programs"))

from tile_problems import Tile, recorded

LOOK = Mechanics.missed_contact


def measured(problem, method, rounds):
    """Return the part of the time in looks, the ratio with and without, and the number of looks."""
    answers, spent, shares, ratios = [], [0.0], [], []

    def timed(self, *path):
        begin = time.thread_time()
        answers.append(LOOK(self, *path))
        spent[0] += time.thread_time() - begin
        return answers[-1]

    def solve(look):
        Mechanics.missed_contact = look
        try:
            return replay(problem, method.make(method.info.atol / problem.mean_radius))
        finally:
            Mechanics.missed_contact = LOOK

    solve(timed)  # compiles
    for _ in range(rounds):
        answers.clear()
        spent[0] = 0.0
        looking = solve(timed)
        known = iter(list(answers))
        blind = solve(lambda *_: next(known))  # noqa: B023 - called here only
        assert np.array_equal(looking.positions[0], blind.positions[0])
        shares.append(spent[0] / looking.cpu)
        ratios.append(looking.cpu / blind.cpu)
    return median(shares), median(ratios), len(answers)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cells", type=int, nargs="+", default=[10_000])
    parser.add_argument("--stiffness", type=float, default=1e3, help="λΔt")
    parser.add_argument("--methods", nargs="+", default=["rosenbrock"])
    parser.add_argument("--rounds", type=int, default=5)
    given = parser.parse_args()
    for cells in given.cells:
        problem, facts = recorded(Tile("typical", cells, given.stiffness, 1))
        for name in given.methods:
            method = find_method(name, problem.scene, problem.mean_radius)
            begin = time.process_time()
            share, ratio, looks = measured(problem, method, given.rounds)
            print(
                f"{name}, {facts['n']:,.0f} cells: {looks} looks, {100 * share:.2f} % of the time, "
                f"with over without {ratio:.3f}; {time.process_time() - begin:.0f} s",
                flush=True,
            )


if __name__ == "__main__":
    main()
