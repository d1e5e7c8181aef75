"""Is this checkout faster than another one, row by row of docs/performance.md?

Problem   growing cells in rich medium for an hour, also in steps that the run chooses where a
          checkout has them, one evaluation of forces, a neighbour list, the first and the second
          command, coupling steps of few cells with a field, steady fields, a run of a study beside
          a bare one, a secreted field that changes, a spheroid of EMT6 cells to 244,836 cells
Measured  wall time and CPU time of all processes of each row, and peak memory, in a process of its
          own for each checkout and round; rounds alternate, every other one in reverse order, so
          that a busy machine is as busy for both. Printed: medians, and of the ratios of the rounds
          (second checkout to first) the median and, in brackets, the smallest and the largest.
Separated compilation and start: each row runs once in each checkout before it is measured, but for
          the first command, whose cache is empty, and whole runs of EMT6, which take minutes
Cost      some minutes a round without a million cells and without EMT6
Command   python tests/benchmarks/compare_trees.py BEFORE AFTER [--rounds 5] [--rows hour kernel]

Both checkouts run with this interpreter and its packages; of multicell each takes its own.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median

HOUR = """
oxygen = {"boundary": 5.0, "uptake": 40.0, "half_saturation": 0.005,
          "growth_half_saturation": 0.01, "quiescence": 0.015, "necrosis": 0.008}
scene = mc.load_scene("spheroid").with_changes({
    "initial.count": %d, "initial.stage": "asynchronous", "duration": "1 d",
    **{f"nutrients.oxygen.{key}": value / 8.0 for key, value in oxygen.items()}})
run = mc.Simulation(scene, threads=%d)
run.step()
with measured(1, run.wall):
    for _ in range(6):
        run.step()
"""
OWN_LENGTHS = """
try:
    scene = scene.with_changes({"coupling_step": "auto"})
except mc.SceneError:  # trees of before November 29 have steps of one length
    pass
"""
CHOSEN = (
    HOUR.partition("run =")[0]
    + OWN_LENGTHS
    + """
run = mc.Simulation(scene, threads=%d)
while run.time < 2400.0:
    run.step()
with measured(2):
    while run.time < 9600.0:
        run.step()
"""
)
FEW = """
scene = mc.load_scene("spheroid").with_changes(
    {"initial.count": %d, "initial.stage": "asynchronous", "duration": "10 d"})
run = mc.Simulation(scene, threads=1)
for _ in range(5):
    run.step()
with measured(30, run.wall):
    for _ in range(30):
        run.step()
"""
TISSUE = """
import numpy as np
from multicell.mechanics import neighbours
from multicell.mechanics.motion import Motion
from multicell.mechanics.system import Mechanics
if not hasattr(neighbours, "spatial_order"):  # trees of before November 25
    from multicell.mechanics import binning as neighbours
n, rng = 100_000, np.random.default_rng(0)
side = round(n ** (1 / 3)) + 1
grid = np.stack(np.meshgrid(*3 * [np.arange(side)], indexing="ij"), -1).reshape(-1, 3)[:n] * 1.0
grid[:, 0] += 0.5 * (grid[:, 1] % 2)
position = 8.2 * grid * [1.0, 0.93, 0.93] + rng.normal(0.0, 0.6, (n, 3))
position = position[neighbours.spatial_order(position, 10.0)]
from multicell.mechanics import neighbours
radius, nothing = rng.uniform(4.3, 5.2, n), np.zeros(n)
system, out = Mechanics(mc.JKR(surface_energy=0.1), 5.0, 1), np.empty((n, 3))
system.begin(Motion(radius, nothing, nothing + 1.0, nothing + 0.5, 0.0, 60.0))
system.velocity(0.0, position, out)
"""
KERNEL = (
    TISSUE
    + """
with measured(30):
    for _ in range(30):
        system.velocity(0.0, position, out)
"""
)
LIST = (
    TISSUE
    + """
neighbours.build(position, radius, 0.75)
with measured(10):
    for _ in range(10):
        neighbours.build(position, radius, 0.75)
"""
)
FIELD = """
import numpy as np
from multicell.nutrient.field import NutrientField
from multicell.nutrient.parameters import FieldParameters
from multicell.scene.nutrient import Nutrient
n, rng = 80_000, np.random.default_rng(1)
position = rng.normal(size=(n, 3))
position *= 250.0 * rng.random((n, 1)) ** (1 / 3) / np.linalg.norm(position, axis=1)[:, None]
field = NutrientField("oxygen", FieldParameters(Nutrient(), %g, 10.0, "steady", dimensions=3))
field.threads, capacity = 2, np.full(n, 20.0)
field.solve(position, capacity)
moved = [position * 1.001 + rng.normal(0.0, 0.1, position.shape) for _ in range(9)]
with measured(9):
    for places in moved:
        field.solve(places, capacity)
"""
# the rows above solve to 1e-9 of the uptake in all trees, this one to what runs of the tree take
FIELD_OF_RUN = FIELD.replace(
    "field.threads",
    'getattr(getattr(field, "group", None), "settle_for_enough", int)()\nfield.threads',
    1,
)
EMT6 = """
scene = mc.load_scene(%r).with_changes({"stop_cells": 244_836, "duration": "40 d"})
%swith measured(1):
    mc.run(scene, threads=2)
"""
EMT6_STEPS = """
scene = mc.load_scene(%r).with_changes({"initial.count": %d, "stop_cells": 244_836})
run = mc.Simulation(scene, threads=2)
for _ in range(2):
    run.step()
with measured(4, run.wall):
    for _ in range(4):
        run.step()
"""
SECRETED = """
scene = mc.load_scene("sorting-signal")
name = next(iter(scene.nutrients))
changes = {"decay": "0.001 1/s", "margin": "300 um", "regime": "transient"}
changes = {f"nutrients.{name}.{key}": value for key, value in changes.items()}
scene = scene.with_changes({**changes, "initial.count": 360, "duration": "35 min"})
with measured(1):
    mc.run(scene, threads=1)
"""
STUDY = """
import tempfile
scene = mc.load_scene("growth").with_changes({"duration": "1 h", "output.every": "1 h"})
with tempfile.TemporaryDirectory() as folder:
    mc.study(scene, seeds=2, output=f"{folder}/first").run(cores=1)
    study = mc.study(scene, seeds=30, output=f"{folder}/second")
    with measured(30):
        study.run(cores=1)
"""
BARE = """
scene = mc.load_scene("growth").with_changes({"duration": "1 h", "output.every": "1 h"})
mc.run(scene, threads=1)
with measured(30):
    for seed in range(30):
        mc.run(scene.with_changes({"seed": seed}), threads=1)
"""
_RICH = Path(__file__).parents[2] / "docs" / "rich-medium.toml"
ROWS = {
    "hour": HOUR % (100_000, 2),
    "hour-one-thread": HOUR % (100_000, 1),
    "hour-chosen": CHOSEN % (100_000, 2),
    "hour-chosen-10000": CHOSEN % (10_000, 1),
    "hour-10000": HOUR % (10_000, 1),
    "hour-million": HOUR % (1_000_000, 2),
    "hour-million-one-thread": HOUR % (1_000_000, 1),
    "kernel": KERNEL,
    "list": LIST,
    "one-cell": FEW % 1,
    "sixty-cells": FEW % 60,
    "field-64": FIELD % 10.0,
    "field-128": FIELD % 5.0,
    "field-64-of-run": FIELD_OF_RUN % 10.0,
    "field-128-of-run": FIELD_OF_RUN % 5.0,
    "study-run": STUDY,
    "bare-run": BARE,
    "secreted": SECRETED,
    "emt6": EMT6 % (str(_RICH), ""),
    "emt6-chosen": EMT6 % (str(_RICH), OWN_LENGTHS),
    "emt6-40000": EMT6_STEPS % (str(_RICH), 40_000),
}
COMMANDS = {"first-command": "20 d", "second-command": "10 min"}  # and what is simulated
AROUND = """
import contextlib, json, os, resource, time
import multicell as mc
@contextlib.contextmanager
def measured(times, parts={}):
    used = lambda: sum(os.times()[:4])  # and of processes that have ended
    begun, wall, cpu = dict(parts), time.perf_counter(), used()
    yield
    cpu, wall = used() - cpu, time.perf_counter() - wall
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    spent = {f"part {name}": (took - begun[name]) / times for name, took in parts.items()}
    print(json.dumps({"wall": wall / times, "CPU": cpu / times, "memory": 1e3 * memory, **spent}))
"""


def measure(row: str, tree: Path) -> dict[str, float]:
    """Measure a row in a checkout: s of wall and CPU time, and bytes of memory."""
    environment = {**os.environ, "PYTHONPATH": str(tree)}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # as for an installed package
    if row in ROWS:
        command = [sys.executable, "-c", AROUND + ROWS[row]]
        done = subprocess.run(
            command, cwd=tree, env=environment, check=True, capture_output=True, text=True
        )
        return dict(json.loads(done.stdout.splitlines()[-1]))
    with tempfile.TemporaryDirectory() as folder:
        if row == "first-command":
            environment["NUMBA_CACHE_DIR"] = str(Path(folder) / "cache")
        length = ["--set", f"duration={COMMANDS[row]}", "--set", "stop_cells=1000"]
        command = [sys.executable, "-m", "multicell", "run", "spheroid", *length, "--no-report"]
        timed = (
            "import json, os, subprocess, sys, time; begin = time.perf_counter()\n"
            "subprocess.run(sys.argv[1:], check=True, stdout=subprocess.DEVNULL)\n"
            "used = os.times()\n"
            "print(json.dumps({'wall': time.perf_counter() - begin,"
            " 'CPU': used.children_user + used.children_system, 'memory': 0.0}))"
        )
        done = subprocess.run(
            [sys.executable, "-c", timed, *command, "-o", str(Path(folder) / "out")],
            cwd=tree, env=environment, check=True, capture_output=True, text=True,
        )  # fmt: skip
        return dict(json.loads(done.stdout.splitlines()[-1]))


def main() -> None:
    """Measure the rows in both checkouts and print medians and ratios."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path)
    parser.add_argument("--rounds", type=int, default=5)
    names = [*ROWS, *COMMANDS]
    usual = [name for name in names if "million" not in name and "emt6" not in name]
    parser.add_argument("--rows", nargs="+", choices=names, default=usual)
    parser.add_argument("--parts", action="store_true", help="the parts of coupling steps as well")
    given = parser.parse_args()
    trees = [given.before.resolve(), given.after.resolve()]
    print("| row | wall before | after | ratio | CPU before | after | ratio | memory ratio |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for row in given.rows:
        found: list[list[dict[str, float]]] = [[], []]
        warm = 0 if row in ("first-command", "emt6", "emt6-chosen") else 1
        for turn in range(given.rounds + warm):
            for side in (0, 1) if turn % 2 else (1, 0):
                value = measure(row, trees[side])
                if turn >= warm:
                    found[side].append(value)
        cells = [row]
        for key in ("wall", "CPU", "memory"):
            values = [[value[key] for value in side] for side in found]
            ratio = _ratio(*values)
            before, after = (median(side) for side in values)
            cells += [ratio] if key == "memory" else [f"{before:.4g} s", f"{after:.4g} s", ratio]
        print(f"| {' | '.join(cells)} |", flush=True)
        if given.parts:
            for part in (key for key in found[1][0] if key.startswith("part ")):
                values = [[value.get(part, 0.0) for value in side] for side in found]
                before, after = (1e3 * median(side) for side in values)
                print(f"|   {part} | {before:.3f} ms | {after:.3f} ms | {_ratio(*values)} |")


def _ratio(before: list[float], after: list[float]) -> str:
    """Return the median of the ratios of rounds, and in brackets the smallest and the largest."""
    if not all(before):  # the memory of a command, a part that the first checkout does not have
        return ""
    ratios = [new / old for old, new in zip(before, after, strict=True)]
    return f"{median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})"


if __name__ == "__main__":
    main()
