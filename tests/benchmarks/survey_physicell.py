"""Survey of PhysiCell settings of other people: how many import and run, and why not.

Every XML file of settings below a folder is imported, and run with a part of its cells for some
coupling steps. The script prints the reason of each that is refused or fails, what became of the
lines of the rules, the numbers, and what is left out by the number of files that have it. Files
that are alike count once. The files are not part of this package.
Cost: about a second a file, more with large grids; a fiftieth with --steps 0, which runs none.
Command: python tests/benchmarks/survey_physicell.py FOLDER [--cells 30] [--steps 3] [--seconds 60]
    [--files 100]
"""

from __future__ import annotations

import argparse
import hashlib
import random
import re
import signal
import time
from collections import Counter
from pathlib import Path

import numpy as np

import multicell as mc
from multicell.scene.scene import Scene
from multicell.scene.start_table import with_cells

OTHERS = {
    "old": "has no cell_definition",
    "no table": "there is no such file",
    "no XML": "is not well-formed XML",
}
"""What is no fault of the import, by words of the error."""


def settings_below(folder):
    made = {}
    for path in sorted(folder.rglob("*.xml")):
        content = path.read_bytes()
        if b"<PhysiCell_settings" in content[:20_000]:
            made.setdefault(hashlib.sha256(content).digest(), path)
    return list(made.values())


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
        fate = next((name for name, words in OTHERS.items() if words in str(error)), "refused")
        return fate, str(error), ()
    if not options.steps:
        return "imports", "", made.entries
    signal.alarm(options.seconds)
    try:
        mc.run(shortened(made, options.cells, options.steps), report=False)
    except (mc.MulticellError, TimeoutError) as error:
        return "fails", f"{type(error).__name__}: {error}", made.entries
    finally:
        signal.alarm(0)
    return "runs", "", made.entries


def ranked(entries):
    """Return the elements that are left out, without the names of types, and why."""
    return {
        (re.sub(r"\[[^]]*\]", "", entry.path) if entry.line else "a rule or table", entry.note)
        for entry in entries
        if entry.fate == "left out"
    }


def stop(number, frame):
    raise TimeoutError("takes too long")


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--cells", type=int, default=30)
    parser.add_argument("--steps", type=int, default=3)
    parser.add_argument("--seconds", type=int, default=60)
    parser.add_argument("--files", type=int, help="draw so many of all settings")
    options = parser.parse_args()
    signal.signal(signal.SIGALRM, stop)
    ends, rules, reasons, left = Counter(), Counter(), Counter(), Counter()
    paths = settings_below(options.folder)
    if options.files is not None:
        paths = random.Random(0).sample(paths, min(options.files, len(paths)))
    for path in paths:
        begin = time.perf_counter()
        end, reason, entries = attempt(path, options)
        ends[end] += 1
        name, lasted = path.relative_to(options.folder), time.perf_counter() - begin
        print(f"{end:8}{lasted:6.1f} s  {name}  {reason}", flush=True)
        lines = [entry for entry in entries if re.search(r"\.csv, line \d+$", entry.path)]
        left.update(ranked(entries))
        rules.update(str(entry.fate) for entry in lines)
        reasons.update(entry.note for entry in lines if entry.fate == "left out")
    print("\nsettings:", ", ".join(f"{number} {name}" for name, number in ends.items()))
    print("rules:", ", ".join(f"{number} {name}" for name, number in rules.items()))
    for reason, number in reasons.most_common():
        print(f"  {number} left out: {reason}")
    print("left out of so many settings:")
    for (path, reason), number in left.most_common(40):
        print(f"  {number:5} {path}: {reason}")


if __name__ == "__main__":
    main()
