"""What a run may need later on, done once on a few cells, so that it is compiled: by a process.

The parts of a coupling step that need compiled code are the run's own, with arrays of the same
types: what they have compiled the run finds in numba's cache on disk.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from multicell.biology.initial import initial_cells
from multicell.biology.motion import motion_of
from multicell.biology.plan import biology_plan
from multicell.integrators import registry
from multicell.integrators.auto import MILD, Auto, candidates, choose
from multicell.integrators.rkc import Rkc2
from multicell.results import summary
from multicell.scene import start
from multicell.scene.checks import followed
from multicell.scene.coupling import longest_step

if TYPE_CHECKING:
    from multicell.cells import Cells, FloatArray
    from multicell.mechanics.system import Mechanics
    from multicell.scene.scene import Scene

_FEW = 27
"""Cells that a method for many is tried with."""
LAST = Rkc2.info.name
"""The method that comes last: who finds it on disk finds the others."""


def first_contact(scene: Scene) -> None:
    """Do what two cells that touch need in a coupling step."""
    system, position = touching(scene, 2)
    method = registry.make(scene.integrator)
    if isinstance(method, Auto):
        method = method.method(MILD)
    outcome = method.integrate(system, position)
    system.pressure(system.motion.end, outcome.position)
    if summary.counts_contacts(scene):
        system.contacts(system.motion.end, outcome.position)


def other_methods(scene: Scene) -> None:
    """Go over a coupling step by each method that ``auto`` may choose."""
    chosen = registry.make(scene.integrator)
    assert isinstance(chosen, Auto)
    system, position = touching(scene, _FEW)
    choose(system, position, chosen.rtol, chosen.atol)
    for name in [*sorted(set(candidates(system)) - {MILD, LAST}), LAST]:
        chosen.method(name).integrate(*touching(scene, _FEW))


def many_nodes(scene: Scene) -> None:
    """Solve for the steady fields as on many nodes, by multigrid."""
    from multicell.nutrient import steady
    from multicell.nutrient.fields import Feeding

    steady.MANY = 0
    Feeding(scene).begin(_cells(scene, _FEW), 0.0)


def touching(scene: Scene, count: int) -> tuple[Mechanics, FloatArray]:
    """Return the mechanics of some cells of a scene in a coupling step, and their places."""
    cells = _cells(scene, count)
    nothing = np.zeros((count, 3))
    system = start.mechanics(scene, 1)
    motion = motion_of(
        biology_plan(scene), cells, cells.radius, 0.0, longest_step(scene), concentrations={},
        gradients=dict.fromkeys(followed(scene), nothing),
        contacts=np.empty((0, 2), dtype=np.int64),
    )  # fmt: skip
    system.begin(motion)
    return system, cells.position


def _cells(scene: Scene, count: int) -> Cells:
    """Return copies of a scene's first cell in rows, each of which touches the next."""
    if scene.initial.cells is not None:
        scene = scene.with_changes({"initial": {"stage": scene.initial.stage}})
    cells = initial_cells(scene).take(np.zeros(count, dtype=np.int64))
    cells.id = np.arange(count, dtype=cells.id.dtype)
    width = max(round(count ** (1.0 / scene.dimensions)), 2)
    for axis in range(scene.dimensions):
        row = np.arange(count) // width**axis % width
        cells.position[:, axis] += 1.9 * cells.radius * (row - 0.5 * (width - 1))
    return cells
