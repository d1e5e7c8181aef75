"""Compile in another process what the first division of a run needs, while the run has one cell.

A run that begins with one cell needs no forces before that cell has divided. On a new installation
their compilation takes several seconds, so another process takes one coupling step of two cells
that touch. Numba keeps the code on disk, where the run finds it. This changes no result and cannot
make a run fail: what is not ready in time is compiled when it is needed.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Final, final

import numpy as np

from multicell.coupling.timeline import Phase

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.integrators.base import Integrator
    from multicell.mechanics.system import Mechanics
    from multicell.scene.scene import Scene
    from multicell.simulation import Simulation

MAX_WAIT: Final = 30.0
"""How long the first division waits for the process, s: longer than it takes on a slow machine."""


@final
class Precompilation:
    """The process that compiles for a run; it never outlives the run.

    - ``scene``: what the run simulates
    - ``threads``: of the run; with one thread no second core is used

    - ``process``: None where nothing needs to be compiled, or no core is free for it
    """

    def __init__(self, scene: Scene, threads: int) -> None:
        self.process: subprocess.Popen[bytes] | None = None
        useful = threads > 1 and _core_count() > 1 and begins_alone(scene)
        if useful and not forces_are_cached():
            self.process = _start(scene)

    def watch(self, simulation: Simulation) -> None:
        """Wait for the process once the first cell has divided."""
        if self.process is not None and len(simulation.cells) > 1:
            compiling = Phase(simulation.wall, "compile")
            with compiling, suppress(subprocess.TimeoutExpired):
                self.process.wait(MAX_WAIT)
            self.close()

    def close(self) -> None:
        """End the process."""
        if self.process is not None:
            self.process.kill()
            self.process.wait()
            self.process = None


def _core_count() -> int:
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity else os.cpu_count() or 1


def begins_alone(scene: Scene) -> bool:
    """Return whether a run begins with one cell that grows and that nothing moves.

    With a law of the user's own the answer is no: the process cannot load it.
    """
    if scene.initial.count > 1 or scene.initial.cells is not None or scene.growth is None:
        return False
    moved = (scene.motility, scene.surface, scene.pull, scene.domain)
    if moved != (None,) * len(moved) or scene.chemotaxis or scene.motions:
        return False
    return ":" not in scene.to_dict()["contact"]["law"]


def forces_are_cached() -> bool:
    """Return whether numba's cache on disk has forces, of whatever law."""
    from multicell.mechanics.forces import forces

    pattern = f"forces.{forces.py_func.__qualname__}-*.nbi"
    return any(Path(forces.stats.cache_path).glob(pattern))


def _start(scene: Scene) -> subprocess.Popen[bytes] | None:
    # an empty place is the folder that this process is in
    places = [place or os.getcwd() for place in sys.path]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(places)}
    nowhere = subprocess.DEVNULL
    try:
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", "multicell.precompile"],
            stdin=subprocess.PIPE, stdout=nowhere, stderr=nowhere, env=environment,
        )  # fmt: skip
    except OSError:
        return None
    assert process.stdin is not None
    with suppress(OSError), process.stdin as pipe:
        pickle.dump(scene.to_dict(), pipe)
    return process


def two_cells(scene: Scene) -> tuple[Mechanics, FloatArray]:
    """Return the mechanics of two cells that touch, in a coupling step, and their positions."""
    from multicell.biology.initial import initial_cells
    from multicell.biology.motion import motion_of
    from multicell.biology.plan import biology_plan
    from multicell.scene import start
    from multicell.scene.checks import followed

    cells = initial_cells(scene).take(np.zeros(2, dtype=np.int64))
    cells.id = np.arange(2, dtype=cells.id.dtype)
    cells.position[:, 0] += 1.9 * cells.radius * np.array([-0.5, 0.5])
    system = start.mechanics(scene, 1)
    motion = motion_of(
        biology_plan(scene), cells, cells.radius, 0.0, scene.coupling_step, concentrations={},
        gradients=dict.fromkeys(followed(scene), np.zeros((2, 3))),
        contacts=np.empty((0, 2), dtype=np.int64),
    )  # fmt: skip
    system.begin(motion)
    return system, cells.position


def first_method(scene: Scene) -> Integrator:
    """Return the method that a run takes while its cells hardly touch."""
    from multicell.integrators import registry
    from multicell.integrators.auto import MILD, Auto

    method = registry.from_options(scene.integrator)
    return method.method(MILD) if isinstance(method, Auto) else method


def take_step(scene: Scene) -> None:
    """Do what two cells that touch need in a coupling step."""
    from multicell.results.observables import counts_contacts

    system, position = two_cells(scene)
    outcome = first_method(scene).integrate(system, position)
    system.pressure(system.motion.end, outcome.position)
    if counts_contacts(scene):
        system.contacts(system.motion.end, outcome.position)


def main() -> None:
    """Take the step of the scene on standard input."""
    from multicell.scene.scene import Scene

    take_step(Scene.from_dict(pickle.load(sys.stdin.buffer)))


if __name__ == "__main__":
    main()
