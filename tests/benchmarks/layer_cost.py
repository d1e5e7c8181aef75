"""Cost of a medium that follows the tissue, over one that begins at a box.

Problem   a growing spheroid of 100,000 cells with oxygen at rest, coupling steps on two threads.
          Oxygen does not change growth, so that both runs have the same cells, bit by bit; a
          slow cycle of all cells takes the place of the usual one in a rim
Measured  CPU and wall time of single steps, in turns: medians of the ratio, with its ends
Cost      half a minute
Command   python tests/benchmarks/layer_cost.py    (--cells 100000 --steps 8 --threads 2)
"""

from __future__ import annotations

import argparse
import time
from statistics import median

import numpy as np

import multicell as mc

SHAPES = ("box", "tissue")
SAME_CELLS = {
    "nutrients.oxygen.growth_half_saturation": None,
    "nutrients.oxygen.quiescence": None,
    "nutrients.oxygen.necrosis": None,
    "growth.cycle_time": "120 h",
}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cells", type=int, default=100_000)
    parser.add_argument("--steps", type=int, default=8)
    parser.add_argument("--threads", type=int, default=2)
    given = parser.parse_args()
    start = {"initial.count": given.cells, "initial.stage": "asynchronous", "duration": "20 h"}
    scene = mc.load_scene("spheroid").with_changes(start | SAME_CELLS)
    runs = {}
    for shape in SHAPES:
        own = scene.with_changes({"nutrients.oxygen.margin_shape": shape})
        runs[shape] = mc.Simulation(own, threads=given.threads)
        for _ in range(3):  # loads code, and lets the lists come to their usual size
            runs[shape].step()
    walls, cpus = [], []
    for turn in range(given.steps):
        wall, cpu = {}, {}
        for shape in SHAPES if turn % 2 else SHAPES[::-1]:
            wall[shape], cpu[shape] = -time.perf_counter(), -time.process_time()
            runs[shape].step()
            wall[shape] += time.perf_counter()
            cpu[shape] += time.process_time()
        walls.append(wall["tissue"] / wall["box"])
        cpus.append(cpu["tissue"] / cpu["box"])
    box, tissue = (runs[shape].cells.position for shape in SHAPES)
    np.testing.assert_array_equal(box, tissue)
    for name, ratios in (("CPU", cpus), ("wall", walls)):
        print(f"{name}: {median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})")


if __name__ == "__main__":
    main()
