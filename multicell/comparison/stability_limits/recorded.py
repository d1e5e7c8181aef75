"""A coupling step of a run, as the run itself comes to it: the start of trials in moving tissue."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from hashlib import blake2b
from pathlib import Path
from typing import final

import numpy as np

from multicell.cells import FloatArray, IntArray
from multicell.comparison.replay import advance_system
from multicell.errors import SceneError
from multicell.integrators.auto import ChosenWork
from multicell.integrators.base import Integrator
from multicell.mechanics.motion import Motion
from multicell.mechanics.system import Mechanics
from multicell.report.result import recorded_scene
from multicell.report.wording import time_unit
from multicell.results.reader import Contents
from multicell.scene.scene import Scene
from multicell.simulation import Simulation
from multicell.units import to_base

_ROUNDING = 1e-9  # of a coupling step, by which a time may be missed


@final
@dataclass(frozen=True, eq=False)
class RecordedState:
    """A coupling step with the state that it starts from.

    - ``name``, str: in tables and charts
    - ``scene``, Scene
    - ``template``, Mechanics: each trial works on a copy
    - ``motion``, Motion: of the coupling step
    - ``start``, (n, 3) float64, µm: positions at its beginning
    - ``ids``, (n,) int64: identities of the cells
    """

    name: str
    scene: Scene
    template: Mechanics
    motion: Motion
    start: FloatArray
    ids: IntArray

    @classmethod
    def of(cls, simulation: Simulation, name: str) -> RecordedState:
        """Return the next coupling step of a simulation, which does not take it.

        Raises SceneError where nothing moves, or where cells diffuse.
        """
        system, cells = simulation.prepared(), simulation.cells
        pushed = system.motion.push is not None and system.motion.push.any()
        if not pushed and not system.contacts(simulation.time, cells.position).size:
            problem = "no cell touches another or is driven there: there is nothing to solve"
            raise SceneError("state", f"{name}: {problem}", "Choose a later time.")
        position = np.array(cells.position)
        return cls(name, simulation.scene, system, system.motion, position, cells.id.copy())

    @property
    def radius(self) -> float:
        """Mean radius at the beginning, µm: the unit of length of tolerances."""
        return float(self.motion.radius.mean())

    @property
    def length(self) -> float:
        """Length of the coupling step, s."""
        return self.motion.end - self.motion.begin

    @property
    def mark(self) -> str:
        """Digest of places, sizes and forces."""
        motion = self.motion
        parts = (self.start, motion.radius, motion.end_radius, motion.push)
        found = blake2b(repr((motion.begin, motion.end)).encode(), digest_size=8)
        for part in parts:
            found.update(b"none" if part is None else np.ascontiguousarray(part).tobytes())
        return found.hexdigest()

    def system(self, motion: Motion | None = None) -> Mechanics:
        """Return mechanics of its own, made ready for a motion, by default all of it."""
        system = replace(self.template, work=ChosenWork())
        system.begin(self.motion if motion is None else motion)
        return system

    def solve(
        self, integrator: Integrator, start: FloatArray, motion: Motion | None = None
    ) -> tuple[str, FloatArray, Mechanics]:
        """Return words of a failure or none, where the cells end, (n, 3) µm, and the mechanics."""
        system = self.system(motion)
        words, end = advance_system(system, integrator, start)
        return words, end, system


def state_at(text: str | Path, threads: int | None = None) -> RecordedState:
    """Return the coupling step of a run that begins at a time, or the first one after it.

    The run continues from its last frame before that time, as 'multicell resume' would, so that
    the state is bitwise the one that the run has passed. Nothing of the folder is changed.

    - ``text``: ``"FOLDER:TIME"``, the time with its unit
    - ``threads``: by default all

    Raises SceneError or OutputError where there is no such folder or time.
    """
    folder, colon, time = str(text).rpartition(":")
    if not (colon and folder):
        hint = "For example --state results:4h"
        raise SceneError("state", f"is {str(text)!r}, must be the folder of a run and a time", hint)
    wanted = to_base(time, "s", "state")
    contents = Contents(folder)
    contents.whole()
    known = [k for k, p in enumerate(contents.places) if p.time <= wanted * (1.0 + 1e-12)]
    if not (known and math.isfinite(wanted)):
        problem = f"is {str(text)!r}, but the run has no frame up to that time"
        raise SceneError("state", problem)
    simulation = Simulation(
        recorded_scene(contents),
        threads=threads,
        frame=contents.frame(known[-1]),
        lineage=contents.lineage(known[-1]),
    )
    while simulation.time < wanted - _ROUNDING * simulation.scene.coupling_step:
        if simulation.finished:
            break
        simulation.step()
    if simulation.finished:
        end = time_unit(simulation.time).text(simulation.time)
        raise SceneError("state", f"is {str(text)!r}, but that run ends at {end}")
    return RecordedState.of(simulation, f"{Path(folder).name} at {time.strip()}")
