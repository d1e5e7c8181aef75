"""Survey of PhysiCell settings of other people: how many import and run, and why not.

Every XML file of settings below a folder is imported, and run with a part of its cells for some
coupling steps. The script prints the reason of each that is refused or fails, what became of the
lines of the rules, and the numbers. The files are not part of this package.
Cost: about a second a file, more with large grids.
Command: python tests/benchmarks/survey_physicell.py FOLDER [--cells 30] [--steps 3] [--seconds 60]
"""

from __future__ import annotations

import argparse
import re
import signal
import time
from collections import Counter
from pathlib import Path

import numpy as np

import multicell as mc
from multicell.scene.scene import Scene
from multicell.scene.start_table import with_cells


def settings_below(folder):
    files = sorted(folder.rglob("*.xml"))
    return [path for path in files if b"<PhysiCell_settings" in path.read_bytes()[:20_000]]


def shortened(made, cells, steps):
    """Return an imported scene with some of its cells and coupling steps."""
    keys = {name: value for name, value in made.keys.items() if name != "output"}
    keys["duration"] = steps * keys["coupling_step"]
    number = len(made.cells["radius_um"])
    rows = np.unique(np.linspace(0, number - 1, cells).round().astype(int))
    return with_cells(Scene.from_dict(keys), {name: col[rows] for name, col in made.cells.items()})


def attempt(path, options):
    """Return the fate of a file, the reason, and the entries of its account."""
    try:
        made = mc.import_physicell(path)
    except mc.MulticellError as error:
        return "refused", str(error), ()
    signal.alarm(options.seconds)
    try:
        mc.run(shortened(made, options.cells, options.steps), report=False)
    except (mc.MulticellError, TimeoutError) as error:
        return "fails", f"{type(error).__name__}: {error}", made.entries
    finally:
        signal.alarm(0)
    return "runs", "", made.entries


def stop(number, frame):
    raise TimeoutError("takes too long")


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--cells", type=int, default=30)
    parser.add_argument("--steps", type=int, default=3)
    parser.add_argument("--seconds", type=int, default=60)
    options = parser.parse_args()
    signal.signal(signal.SIGALRM, stop)
    ends, rules, reasons = Counter(), Counter(), Counter()
    for path in settings_below(options.folder):
        begin = time.perf_counter()
        end, reason, entries = attempt(path, options)
        ends[end] += 1
        name, lasted = path.relative_to(options.folder), time.perf_counter() - begin
        print(f"{end:8}{lasted:6.1f} s  {name}  {reason}", flush=True)
        lines = [entry for entry in entries if re.search(r"\.csv, line \d+$", entry.path)]
        rules.update(str(entry.fate) for entry in lines)
        reasons.update(entry.note for entry in lines if entry.fate == "left out")
    print("\nsettings:", ", ".join(f"{number} {name}" for name, number in ends.items()))
    print("rules:", ", ".join(f"{number} {name}" for name, number in rules.items()))
    for reason, number in reasons.most_common():
        print(f"  {number} left out: {reason}")


if __name__ == "__main__":
    main()
