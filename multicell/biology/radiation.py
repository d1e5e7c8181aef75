"""What irradiation does to cells: who survives a fraction, and who dies when."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multicell import random
from multicell.cells import Phase, State
from multicell.random import Purpose

if TYPE_CHECKING:
    from multicell.biology.plan import BiologyPlan
    from multicell.cells import Cells, FloatArray
    from multicell.scene.radiation import Radiation

_ROUNDING = 1e-12
"""Part of a time by which a step may end before a fraction that falls on its end."""


def irradiate(
    plan: BiologyPlan, cells: Cells, found: Mapping[str, FloatArray], begin: float, end: float
) -> tuple[Cells, NDArray[np.bool_]]:
    """Return the cells after all fractions between two times, and which have died, (n,).

    Each living cell is hit by each fraction with a random number of its own, which knows nothing of
    the coupling step. One that does not survive dies at once, or has so many divisions left.

    - ``begin``, ``end``, s: fractions fall due after the first and up to the second
    """
    after = cells.shared()
    for course, part in enumerate(plan.radiation.values()):
        for number, time in enumerate(part.schedule):
            if begin < time * (1.0 - _ROUNDING) <= end:
                u = random.uniform(plan.seed, Purpose.RADIATION, number, cells.id, attempt=course)
                _kill(part, after, (u[:, 0] >= _survival(plan, part, after, found)) & ~after.dead)
    dead = after.dead & ~cells.dead
    if dead.any():
        after.age = np.where(dead, 0.0, after.age)
    return after, dead


def _survival(
    plan: BiologyPlan, part: Radiation, cells: Cells, found: Mapping[str, FloatArray]
) -> FloatArray:
    """Return the probability of each cell to survive a fraction, (n,)."""
    known = part.phase_factor or {}
    factor = np.array([known.get(phase.name, 1.0) for phase in Phase])[cells.phase]
    if part.types:
        factor *= np.isin(cells.kind, [list(plan.types).index(kind) for kind in part.types])
    pressure = found[part.oxygen] / plan.solubility[part.oxygen] if part.oxygen else np.inf
    return np.asarray(part.survival(pressure, factor))


def _kill(part: Radiation, cells: Cells, lost: NDArray[np.bool_]) -> None:
    """Let cells die at once, or at one of their next divisions."""
    left = np.int8(part.mitotic_divisions)
    if left:
        sooner = lost & ((cells.doomed == 0) | (cells.doomed > left))
        cells.doomed = np.where(sooner, left, cells.doomed)
    else:
        cells.state = np.where(lost, np.int8(State.APOPTOTIC), cells.state)
