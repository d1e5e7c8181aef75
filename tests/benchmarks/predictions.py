"""Predictions of explain compared with whole runs: population, time, memory, file.

Each scene runs twice in processes of its own, on one thread: once to compile, once to measure. The
ratios are foretold over measured; the constants are in ``multicell/report/explain/cost.py``.
Cost: about five minutes.
Command: python tests/benchmarks/predictions.py [SCENE ...]
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "helpers"))

from rich_medium import MUCH_OXYGEN

SCENES = ("spheroid", "treatment", "growth", "grow-2000", "monolayer", "dosing", "emt6",
          "chemotaxis", "sorting-signal", "hour-1e5")  # fmt: skip


def scene_of(name):
    """Return a built-in scene, or the hour of a hundred thousand cells that grow."""
    import multicell as mc

    if name != "hour-1e5":
        return mc.load_scene(name)
    changes = {"initial.count": 100_000, "initial.stage": "asynchronous", "duration": "1 h"}
    return mc.load_scene("spheroid").with_changes({**changes, **MUCH_OXYGEN})


def measured(name):
    import multicell as mc

    scene = scene_of(name)
    with tempfile.TemporaryDirectory() as folder:
        begin = time.process_time()
        result = mc.run(scene, output=f"{folder}/out", threads=1, report=False)
        took = time.process_time() - begin
        size = Path(folder, "out", "frames.h5").stat().st_size
    return {
        "cells": float(result.history["cells"][-1]),
        "CPU / s": took,
        "memory / MB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3,
        "file / MB": size / 1e6,
    }


def foretold(name):
    from multicell.report.explain.cost import predict

    found = predict(scene_of(name))
    return {
        "cells": float(found.course.cells[-1]),
        "CPU / s": found.seconds,
        "memory / MB": found.memory / 1e6,
        "file / MB": found.file / 1e6,
    }


def main():
    if sys.argv[1:2] == ["--measure"]:
        print(json.dumps(measured(sys.argv[2])))
        return
    for name in sys.argv[1:] or SCENES:
        for _ in range(2):
            done = subprocess.run(
                [sys.executable, __file__, "--measure", name],
                check=True,
                capture_output=True,
                text=True,
            )
        found, told = json.loads(done.stdout.splitlines()[-1]), foretold(name)
        print(f"\n{name}", flush=True)
        for key, value in found.items():
            ratio = told[key] / value
            print(f"  {key:12s} {value:10.4g} foretold {told[key]:10.4g} ratio {ratio:.2f}")


if __name__ == "__main__":
    main()
