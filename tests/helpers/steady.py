"""A run of a tiny scene over many coupling steps; how much memory it holds, as JSON on stdout.

``python tests/steady.py CASE STEPS FOLDER`` prints a list of ``[steps done, resident bytes]``. The
rows of the history that a run keeps for its result are memory by intent, about 1 kB a step: they
are set aside, all else must stay.
"""

import gc
import json
import os
import sys

import multicell as mc

CASES = {
    "mechanics": ("doublet-settle", {"motility.force": "0.01 nN", "motility.persistence": "1 h"}),
    "field": ("spheroid", {"growth": None, "death": None, "initial.count": 4,
                           "nutrients.oxygen.spacing": "20 um"}),
    "transient": ("spheroid", {"growth": None, "death": None, "initial.count": 4,
                               "nutrients.oxygen.spacing": "20 um",
                               "nutrients.oxygen.regime": "transient"}),
}  # fmt: skip


def resident():
    """Return the resident memory of this process in bytes."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def main():
    name, changes = CASES[sys.argv[1]]
    steps, folder = int(sys.argv[2]), sys.argv[3]
    scene = mc.load_scene(name).with_changes(
        {**changes, "coupling_step": 60.0, "duration": 60.0 * steps,
         "output.every": 60.0 * max(steps // 10, 1)}
    )  # fmt: skip
    found = []

    def progress(simulation):
        if simulation.step_index % max(steps // 20, 1) == 0:
            gc.collect()
            found.append([simulation.step_index, resident()])

    mc.run(scene, output=folder, report=False, threads=1, progress=progress)
    print(json.dumps(found))


if __name__ == "__main__":
    main()
