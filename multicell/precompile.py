"""Compile in another process what the first division of a run needs, while the run has one cell.

A run that begins with one cell needs no forces before that cell has divided. On a new installation
their compilation takes several seconds, so another process begins with it, part by part. Numba
keeps the code on disk, where the run finds it. Once the cell has divided, the run itself compiles
those parts that the process has not come to. This changes no result and cannot make a run fail:
what is not ready in time is compiled when it is needed.
"""

from __future__ import annotations

import gc
import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from shutil import rmtree
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from multicell.compiling import COMPILATION
from multicell.simulation.timeline import PhaseTimer

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.integrators.adams_bashforth import AdaptiveAdams
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
            with suppress(OSError):  # no room for a folder or a process: nothing is done ahead
                self._scene, self._taken = scene, TemporaryDirectory(ignore_cleanup_errors=True)
                self.process = _start(scene, self._taken.name)

    def watch(self, simulation: Simulation) -> None:
        """Share the rest with the process once the first cell has divided, and wait for it."""
        if self.process is not None and len(simulation.state.cells) > 1:
            with PhaseTimer(simulation.wall, "compile"):
                with suppress(Exception):  # the process meets it as well, and so ends early
                    take_step(self._scene, partial(take, self._taken.name))
                with suppress(subprocess.TimeoutExpired), COMPILATION.awaited("forces"):
                    self.process.wait(MAX_WAIT)
            self.close()

    def close(self) -> None:
        """End the process."""
        if self.process is not None:
            self.process.kill()
            self.process.wait()
            self.process = None
            self._taken.cleanup()


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
    if moved != (None,) * len(moved) or scene.chemotaxis or scene.motions or scene.networks:
        return False
    if not scene.contact.acts:
        return False
    return ":" not in scene.to_dict()["contact"]["law"]


def forces_are_cached() -> bool:
    """Return whether numba's cache on disk has forces, of whatever law."""
    from multicell.compiling.numba_068 import is_on_disk
    from multicell.mechanics.forces import forces

    return is_on_disk(forces)


def take(folder: str, part: str) -> bool:
    """Return whether nobody has taken a part before; it is then the caller's."""
    with suppress(OSError):  # it is there, or the run has ended
        Path(folder, part).mkdir()
        return True
    return False


def _start(scene: Scene, taken: str) -> subprocess.Popen[bytes]:
    # an empty place is the folder that this process is in
    places = [place or os.getcwd() for place in sys.path]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(places)}
    nowhere = subprocess.DEVNULL
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "multicell.precompile"],
        stdin=subprocess.PIPE,
        stdout=nowhere,
        stderr=nowhere,
        env=environment,
    )
    assert process.stdin is not None
    with suppress(OSError), process.stdin as pipe:
        pickle.dump((scene.to_dict(), taken), pipe)
    return process


def two_cells(scene: Scene) -> tuple[Mechanics, FloatArray]:
    """Return the mechanics of two cells that touch, in a coupling step, and their positions."""
    from multicell.biology.initial import initial_cells
    from multicell.biology.motion import motion_of
    from multicell.biology.plan import biology_plan
    from multicell.scene.dependences import followed
    from multicell.simulation.assembly import mechanics_of

    cells = initial_cells(scene).take(np.zeros(2, dtype=np.int64))
    cells.id = np.arange(2, dtype=cells.id.dtype)
    cells.position[:, 0] += 1.9 * cells.radius * np.array([-0.5, 0.5])
    system = mechanics_of(scene, 1)
    motion = motion_of(
        biology_plan(scene),
        cells,
        cells.radius,
        0.0,
        scene.coupling_step,
        signals={},
        gradients=dict.fromkeys(followed(scene), np.zeros((2, 3))),
        contacts=np.empty((0, 2), dtype=np.int64),
    )
    system.begin(motion)
    return system, cells.position


def first_method(scene: Scene) -> Integrator:
    """Return the method that a run takes while its cells hardly touch."""
    from multicell.integrators import registry
    from multicell.integrators.auto import MILD, Auto

    method = registry.from_options(scene.integrator)
    return method.method(MILD) if isinstance(method, Auto) else method


def parts(system: Mechanics, position: FloatArray, method: AdaptiveAdams) -> dict[str, list[Any]]:
    """Return the parts for :func:`multicell.compiling.address_of`, the slowest to compile first.

    Nothing is run, so that no part needs the code of another one. Those that share functions, which
    are compiled once in a process, are one part.
    """
    from multicell.integrators import driver, stepping
    from multicell.integrators.loops.adams_bashforth import adaptive_adams
    from multicell.mechanics import forces
    from multicell.mechanics.any_law import law_values

    known, pairs, shared = system.kernel_data()
    cells, law = known[:2]
    source = stepping.Source(cells, law_values(law), *known[2:], np.zeros(5, np.int64))
    used = stepping.stepping_kernels(source, pairs, law, shared=shared, passes=True)
    rows, placed = source.rows, position.view()
    placed.flags.writeable = False  # as the forces have it
    report = stepping.Report(0, 0.0, 0.0, -1, 0.0), pairs
    settings = driver.control(method, system, 3.0, 2), method.patience
    return {
        "lists": [used["rebuild_at"]],
        "forces": [
            used["kernel_at"],
            used["velocities_at"],
            (forces.pack, True, cells, placed, 0.0, rows),
            (forces.half_virials, None, rows, pairs, law, 0.0, source.reach),
        ],
        "loop": [
            (
                adaptive_adams,
                report,
                source,
                pairs,
                position,
                1.0,
                source.reach,
                source.counts,
                *settings,
            )
        ],
        "evaluation": [used["evaluation_at"]],
        "passes": [used["foresee_at"], used["assess_at"]],
    }


def take_step(scene: Scene, takes: Callable[[str], bool] = bool) -> None:
    """Compile what a coupling step of two cells that touch needs.

    - ``takes``: says of each part, by its name, whether it is for the caller
    """
    from multicell.compiling import address_of
    from multicell.integrators.adams_bashforth import AdaptiveAdams
    from multicell.integrators.driver import needs_python
    from multicell.scene.dependences import counts_contacts

    (system, position), method = two_cells(scene), first_method(scene)
    counts = counts_contacts(scene)
    if isinstance(method, AdaptiveAdams) and not (counts or needs_python(system)):
        for part, kernels in parts(system, position, method).items():
            for kernel in kernels if takes(part) else ():
                address_of(*kernel)
    elif takes("all"):
        outcome = method.integrate(system, position)
        system.pressure(system.motion.end, outcome.position)
        if counts:
            system.contacts(system.motion.end, outcome.position)


def take_shares() -> None:
    """Take parts of what the scene on standard input needs, until none is left."""
    from multicell.scene.scene import Scene

    (scene, taken), run = pickle.load(sys.stdin.buffer), os.getppid()
    take_step(Scene.from_dict(scene), lambda part: os.getppid() == run and take(taken, part))
    if os.getppid() != run:  # it was killed, and cannot clean up
        rmtree(taken, ignore_errors=True)


if __name__ == "__main__":
    gc.disable()  # it ends before its garbage matters
    take_shares()
