"""Runs of small scenes, each reduced to the digest of all its bits; one JSON object on stdout.

``python tests/bits.py GROUP`` prints ``{"digests": {case: digest}, "shared": {case: n}}`` with
``n`` the number of evaluations (or whole steps in a compiled loop) that threads shared. Chunks
are made small, so that a few hundred cells are enough for threads to have something to share.
"""

import hashlib
import json
import os
import sys

import numpy as np

import multicell as mc
from multicell.integrators import stepping as loops
from multicell.integrators.registry import METHODS
from multicell.mechanics.system import Mechanics
from multicell.simulation import Simulation

CHUNK, SHARED_CHUNKS = 32, 2
TISSUE = {"initial.count": 150, "initial.spacing": 0.82, "duration": "2 min"}
PHASES = {k: {"duration": f"{h} h"} for k, h in (("G1", 12), ("S", 7), ("G2", 4), ("M", 1))}
PHYSICS = {
    "friction": ("settle", {**TISSUE, "friction": {}}),
    "friction, explicit": ("settle", {**TISSUE, "friction": {}, "integrator": "rkc2"}),
    "receptors": ("sorting-cams", {"duration": "15 min", "types.sticky.receptor": 3.0,
                                   "types.sticky.ligand": 4.0, "initial.count": 150}),
    "types": ("sorting", {"duration": "15 min", "initial.count": 150}),
    "phases": ("growth", {"initial.count": 150, "initial.stage": "uniform", "duration": "100 min",
                          "growth.phases": PHASES}),
    # three parts in one scene: each alone would compile all that has to do with contacts anew
    "exact JKR, Brownian motion, space that repeats": (
        "settle", {**TISSUE, "contact.law": "exact-jkr", "motility": {"diffusion": "0.01 um^2/s"},
                   "domain": {axis: [-20, 20] for axis in "xyz"}
                   | {"periodic": ["x", "y", "z"]}}),
    "plane": ("settle", {**TISSUE, "dimensions": 2}),
    "walls": ("settle", {**TISSUE, "domain": {axis: [-22, 22] for axis in "xyz"}}),
    "compression": ("settle", {**TISSUE, "initial.spacing": 0.72, "compression": {},
                               "domain": {axis: [-22, 22] for axis in "xyz"}}),
    "driven": ("settle", {**TISSUE, "friction": {},
                          "motions": {"m": {"cells": [0, 1], "velocity": [0.001, 0, 0]}}}),
    "fields": ("spheroid", {"initial.count": 150, "initial.stage": "uniform",
                            "duration": "40 min", "nutrients.oxygen.regime": "transient"}),
    "death": ("spheroid", {"initial.count": 150, "initial.stage": "uniform", "duration": "2 h",
                           "nutrients.oxygen.boundary": "0.01 mM", "death.lysis_time": "1 h"}),
}  # fmt: skip
METHOD_CASES = {name: ("settle", {**TISSUE, "integrator": name}) for name in METHODS}
GROUPS = {
    "all": METHOD_CASES | PHYSICS,
    # a field, cells that divide, and the default method, whose parts are compiled as a whole
    "few": {"fields": PHYSICS["fields"]},
}


class Watch:
    """Counts the evaluations that threads share."""

    def __init__(self):
        self.shared = 0
        shared, addressed = Mechanics._shared, loops.with_addresses

        def watched(system, pairs):
            answer = shared(system, pairs)
            self.shared += answer
            return answer

        def lent(source, pairs, *, shared, **rest):
            self.shared += shared
            return addressed(source, pairs, shared=shared, **rest)

        Mechanics._shared, loops.with_addresses = watched, lent


def simulation(name, changes, threads, **state):
    scene = mc.load_scene(name).with_changes(changes)
    made = Simulation(scene, threads=threads, **state)
    made.mechanics.chunk, made.mechanics.shared_chunks = CHUNK, SHARED_CHUNKS
    return made


def arrays(frame):
    """Give every array of a frame with its name, and the numbers of its progress."""
    yield from frame.cells.columns()
    yield from sorted(frame.concentrations.items())
    for name, field in sorted(frame.fields.items()):
        yield name, field.values
        yield name, field.origin
    yield "contacts", frame.contacts
    progress = frame.progress
    yield "counts", np.array([progress.next_id, progress.divisions, progress.removals])
    yield "released", np.array([progress.released])
    yield "ledger", np.array([v for e in progress.ledger.values() for v in e.values()], dtype=float)


def digest(frame):
    found = hashlib.sha256()
    for name, values in arrays(frame):
        values = np.ascontiguousarray(values)
        found.update(f"{name} {values.dtype} {values.shape}".encode())
        found.update(values.tobytes())
    return found.hexdigest()


def last(name, changes, threads):
    """Return the digest of the end of a run."""
    run = simulation(name, changes, threads)
    while not run.finished:
        run.step()
    return digest(run.frame())


def main():
    watch = Watch()
    threads = int(os.environ["NUMBA_NUM_THREADS"])
    digests, shared = {}, {}
    for key, case in GROUPS[sys.argv[1]].items():
        before = watch.shared
        digests[key] = last(*case, threads)
        shared[key] = watch.shared - before
    print(json.dumps({"digests": digests, "shared": shared}))


if __name__ == "__main__":
    main()
