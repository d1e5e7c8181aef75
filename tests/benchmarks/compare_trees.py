"""Two trees of this package beside each other: speed at scale, at the start and for small runs.

Every row runs one after the other in both trees, in processes of its own, round by round, so that
other load on the machine meets both. Scripts below use nothing but what both trees have. Each tree
gets a compilation cache of its own, which is filled before anything is timed (but in the row of
compilation).
Cost: a few minutes a row and round; `emt6` an hour.
Command: python tests/benchmarks/compare_trees.py OLD NEW [--rows small hour-1e5 ...] [--rounds 3]
where OLD and NEW are folders that hold a `multicell`.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

RICH = Path(__file__).parents[2] / "docs" / "rich-medium.toml"
"""The scene of the rows ``emt6``, the same for both trees."""


def growing(count, duration, threads):
    """Return seconds and peak memory of many asynchronous cells that are well fed."""
    import multicell as mc

    scene = mc.load_scene("spheroid").with_changes(
        {
            "initial.count": count,
            "initial.stage": "asynchronous",
            "nutrients.oxygen.boundary": 5.0,
            "duration": duration,
        }
    )
    least = peak()
    begin, used = time.perf_counter(), time.process_time()
    result = mc.run(scene, threads=threads)
    return {
        "wall / s": time.perf_counter() - begin,
        "CPU / s": time.process_time() - used,
        "kB per cell": (peak() - least) / len(result.frames[-1].cells),
        "cells": len(result.frames[-1].cells),
        "diameter / µm": float(result.history["diameter"][-1]),
    }


def peak():
    """Return the largest memory that this process has held, in kB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def spheroid():
    """Return the cost of README's run, on one thread."""
    import multicell as mc

    with tempfile.TemporaryDirectory() as folder:
        used = time.process_time()
        result = mc.run(mc.load_scene("spheroid"), output=f"{folder}/out", threads=1, report=False)
        took = time.process_time() - used
        rows = sum(len(frame.cells) for frame in result.frames)
        bytes_ = sum(part.stat().st_size for part in Path(folder).rglob("*.h5"))
        last = result.history
        return {
            "CPU / s": took,
            "bytes per cell and frame": bytes_ / rows,
            "cells": int(last["cells"][-1]),
            "diameter / µm": float(last["diameter"][-1]),
        }


def small(count):
    """Return the time of a coupling step of few cells with one field."""
    import multicell as mc
    from multicell.simulation import Simulation

    scene = mc.load_scene("spheroid").with_changes(
        {"initial.count": count, "initial.stage": "asynchronous", "duration": "10 d"}
    )
    simulation = Simulation(scene, threads=1)
    for _ in range(5):
        simulation.step()
    took = []
    for _ in range(60):
        used = time.perf_counter()
        simulation.step()
        took.append(time.perf_counter() - used)
    return {"ms": 1e3 * median(took), "cells": len(simulation.cells)}


def compiling():
    """Return CPU time of the first run, with the cache as it is, and its longest later step."""
    import multicell as mc

    took = []
    now = [0.0, 0.0]

    def note(simulation):
        before, now[:] = list(now), (time.process_time(), time.perf_counter())
        took.append([b - a for a, b in zip(before, now, strict=True)])

    mc.run(mc.load_scene("spheroid").with_changes({"duration": "6 d"}), threads=2, progress=note)
    other = resource.getrusage(resource.RUSAGE_CHILDREN)
    return {
        "CPU of the process / s": time.process_time(),
        "CPU of others for it / s": other.ru_utime + other.ru_stime,
        "longest later step, CPU / s": max(cpu for cpu, _ in took[1:]),
        "longest later step, wall / s": max(wall for _, wall in took[1:]),
    }


def second_run():
    """Return wall time of a second command to the end of its first step."""
    command = [sys.executable, "-m", "multicell", "run", "spheroid"]
    took = []
    for _ in range(5):
        with tempfile.TemporaryDirectory() as folder:
            begin = time.perf_counter()
            subprocess.run(
                [*command, "-o", f"{folder}/o", "--set", "duration=10 min", "--no-report"],
                check=True,
                capture_output=True,
                cwd=folder,
            )
            took.append(time.perf_counter() - begin)
    return {"wall / s": median(took)}


def field(radius, spacing, threads):
    """Return the time of a warm-started steady solve on a grid of cubes."""
    import numpy as np

    from multicell.nutrient.field import NutrientField

    try:
        from multicell.nutrient.parameters import FieldParameters
        from multicell.scene.nutrient import Nutrient
    except ModuleNotFoundError:
        from multicell.nutrient.parts import Nutrient
        from multicell.nutrient.plan import FieldParameters
    rng = np.random.default_rng(1)
    n = int(0.64 * (radius / 5.0) ** 3)
    direction = rng.normal(size=(n, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    position = direction * radius * rng.random((n, 1)) ** (1 / 3)
    oxygen = FieldParameters(Nutrient(), spacing, 10.0, "steady", dimensions=3)
    solved, capacity = NutrientField("oxygen", oxygen), np.full(n, 20.0)
    solved.threads = threads  # which old trees do not look at
    solved.solve(position, capacity)
    took = []
    for _ in range(9):
        moved = position * 1.001 + rng.normal(0.0, 0.1, position.shape)
        begin = time.perf_counter()
        report = solved.solve(moved, capacity)
        took.append(time.perf_counter() - begin)
    assert abs(report.inflow / report.uptake - 1.0) < 1e-8
    return {"ms": 1e3 * median(took), "nodes": int(np.prod(solved.layout.box.shape))}


def emt6(cells, threads):
    """Return the time of the spheroid of EMT6 cells up to a number of cells."""
    import multicell as mc

    scene = mc.load_scene(RICH).with_changes({"stop_cells": cells, "duration": "40 d"})
    begin, used = time.perf_counter(), time.process_time()
    result = mc.run(scene, threads=threads)
    last = result.history
    return {
        "wall / s": time.perf_counter() - begin,
        "CPU / s": time.process_time() - used,
        "cells": int(last["cells"][-1]),
        "time / h": float(last["time"][-1]) / 3600.0,
        "diameter / µm": float(last["diameter"][-1]),
    }


def busy(count):
    """Return the time of three steps of many cells beside one process that keeps a core busy."""
    growing(count, "10 min", 2)  # what is loaded once
    other = subprocess.Popen([sys.executable, "-c", "while True: pass"])
    try:
        return {f"{n}: {k}": v for n in (1, 2) for k, v in growing(count, "30 min", n).items()}
    finally:
        other.kill()


ROWS = {
    "small-1": lambda: small(1),
    "small-60": lambda: small(60),
    "spheroid": spheroid,
    "hour-1e5": lambda: growing(100_000, "1 h", 2),
    "hour-1e5-one": lambda: growing(100_000, "1 h", 1),
    "hour-1e6": lambda: growing(1_000_000, "1 h", 2),
    "busy": lambda: busy(100_000),
    "second-run": second_run,
    "compiling": compiling,
    "field-64": lambda: field(250, 10.0, 2),
    "field-128": lambda: field(250, 5.0, 2),
    "emt6-20000": lambda: emt6(20_000, 2),
    "emt6": lambda: emt6(244_836, 2),
}


def measured(tree, row, cache):
    """Run a row in a tree and return what it prints."""
    # byte code is kept as it is for an installed package, also where the environment forbids it
    keep = {
        "PYTHONPATH": str(tree),
        "NUMBA_CACHE_DIR": str(cache),
        "PYTHONPYCACHEPREFIX": str(cache / "bytecode"),
        "PYTHONDONTWRITEBYTECODE": "",
    }
    done = subprocess.run(
        [sys.executable, __file__, "--row", row],
        env=os.environ | keep,
        cwd=tempfile.gettempdir(),
        check=True,
        capture_output=True,
        text=True,
    )
    return json.loads(done.stdout.splitlines()[-1])


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("trees", nargs="*", type=lambda text: Path(text).resolve())
    parser.add_argument("--rows", nargs="+", default=[r for r in ROWS if r != "emt6"])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--caches", type=Path, default=None, help="kept between calls")
    parser.add_argument("--row", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.row:
        print(json.dumps(ROWS[given.row]()))
        return
    caches = given.caches or Path(tempfile.mkdtemp())
    for row in given.rows:
        found = [[] for _ in given.trees]
        for number in range(given.rounds):
            for at, tree in enumerate(given.trees):
                cache = caches / str(at)
                if row == "compiling":
                    cache = caches / f"cold-{os.getpid()}-{number}-{at}"
                elif number == 0 and not row.startswith(("hour-1e6", "emt6")):
                    measured(tree, row, cache)
                found[at].append(measured(tree, row, cache))
        print(f"\n{row}", flush=True)
        for name in found[-1][0]:
            columns = [[run.get(name, float("nan")) for run in runs] for runs in found]
            middle = "  ".join(f"{median(column):10.4g}" for column in columns)
            both = zip(columns[0], columns[-1], strict=True)
            ratios = [new / old if old else float("nan") for old, new in both]
            print(
                f"  {name:28s} {middle}   ratio {median(ratios):.3f} "
                f"({min(ratios):.3f} to {max(ratios):.3f})",
                flush=True,
            )


if __name__ == "__main__":
    main()
