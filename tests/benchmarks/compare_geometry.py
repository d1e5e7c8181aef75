"""The spheroid with its oxygen on shells against the one with a grid of cubes, up to 5,000 cells.

Problem: the built-in spheroid from 200 cells with `geometry` box and radial; the same seeds. The
largest relative difference of the growth curves, wall time of the field, and the departure of the
cells from a ball.
Found: curves apart at most by 2.0, 3.1 and 1.4 %, mean curves by 1.6 %, at the end by 0.5 %.
Cost: a minute on one core.
Command: python tests/benchmarks/compare_geometry.py [--cells 5000] [--seeds 1,2,3]
"""

from __future__ import annotations

import argparse

import numpy as np

import multicell as mc
from multicell.nutrient.cartesian import departure


def grown(geometry: str, seed: int, cells: int) -> mc.Result:
    changes = {
        "nutrients.oxygen.geometry": geometry,
        "stop_cells": cells,
        "seed": seed,
        "initial.count": 200,
        "initial.stage": "asynchronous",
        "duration": "9 d",
    }
    scene = mc.load_scene("spheroid").with_changes({**changes, "integrator": "ab2-adaptive"})
    return mc.run(scene, threads=1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cells", type=int, default=5000)
    parser.add_argument("--seeds", default="1,2,3")
    given = parser.parse_args()
    curves: dict[str, list[np.ndarray]] = {"box": [], "radial": []}
    for seed in map(int, given.seeds.split(",")):
        runs = {g: grown(g, seed, given.cells) for g in curves}
        steps = min(len(run.history["cells"]) for run in runs.values())
        box, radial = (runs[g].history["cells"][:steps] for g in curves)
        for geometry, run in runs.items():
            curves[geometry].append(run.history["cells"])
        known = box >= 100
        apart = np.abs(radial[known] / box[known] - 1.0)
        wall = {g: run.summary()["wall"]["nutrient"] for g, run in runs.items()}
        last = runs["box"].frames[-1].cells
        print(
            f"seed {seed}: {box[-1]:.0f} and {radial[-1]:.0f} cells, growth curves apart at most "
            f"{100 * apart.max():.1f} %, median {100 * np.median(apart):.1f} %; field "
            f"{wall['box']:.1f} s and {wall['radial']:.2f} s; departure from a ball "
            f"{departure(last.position, last.radius):.3f}",
            flush=True,
        )
    steps = min(len(c) for cs in curves.values() for c in cs)
    mean = {g: np.mean([np.log(c[:steps]) for c in cs], axis=0) for g, cs in curves.items()}
    known = np.exp(mean["box"]) >= 100
    apart = np.abs(np.expm1(mean["radial"][known] - mean["box"][known]))
    print(
        f"mean curves apart at most {100 * apart.max():.1f} %, at the end {100 * apart[-1]:.1f} %"
    )


if __name__ == "__main__":
    main()
