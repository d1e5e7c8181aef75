"""Phases that a condition ends: which cells wait for one, and when in a step it comes true.

A cell that enters such a phase and finds the condition true leaves it at once. Values of a network
in the cell itself are followed by its solver (:mod:`multicell.networks.watching`); all other
signals go linearly between the moments at which they are known. A step that holds the ends of two
such phases of a cell begins the second at the next step.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, final

import numpy as np

from multicell.biology.responding import Level, one_level
from multicell.cells import State
from multicell.scene.conditions import conditions

if TYPE_CHECKING:
    from multicell.biology.exposure import Exposure
    from multicell.biology.plan import BiologyPlan
    from multicell.cells import Cells, FloatArray, Mask, Phase
    from multicell.scene.scene import Scene

_GROWING = int(State.PROLIFERATING)
SINCE = 3  # column of a watch, behind place, sign and level: the time from which it is kept


@final
@dataclass(frozen=True, eq=False)
class Awaited:
    """A condition that ends a phase.

    - ``ends``: the phase
    - ``level``, ``needs``: what reads the signal, and names of all that this is made from; none of
      a network's value in the cell itself
    - ``sign``: 1 where the signal is to be above ``value``, -1 below it
    - ``network``, ``name``: of such a value; empty for other signals
    """

    ends: Phase
    level: Level
    needs: frozenset[str]
    sign: float
    value: float
    network: str
    name: str


def awaited_of(scene: Scene) -> tuple[Awaited, ...]:
    """Return the conditions of a scene."""
    made = []
    for part in conditions(scene):
        level, needs = one_level(scene, part.signal)
        sign = 1.0 if part.rises else -1.0
        own = frozenset[str]() if part.network else frozenset(needs)
        made.append(Awaited(part.ends, level, own, sign, part.level, part.network, part.name))
    return tuple(made)


def waiting(plan: BiologyPlan, cells: Cells) -> Mask:
    """Return which cells are in a phase that a condition ends, (n,)."""
    return np.asarray(plan.waits[cells.phase] & (cells.state == _GROWING))


def waits_since(cells: Cells, dt: float) -> FloatArray:
    """Return from which part of a step of ``dt`` s cells have been in their phase, (n,).

    By the clock of phases that a condition ends, which counts all time.
    """
    return 1.0 - np.minimum(cells.progress / dt, 1.0)


def watched(plan: BiologyPlan, cells: Cells, dt: float) -> dict[str, FloatArray]:
    """Return the conditions that cells wait for in their networks, name -> (n, 4).

    Place of the value, sign, level, and the part of the step from which it counts; that is infinite
    where a cell waits for nothing of the network.
    """
    found: dict[str, FloatArray] = {}
    for part in plan.awaited:
        if not part.network:
            continue
        assert plan.networks is not None
        place = plan.networks.parts[part.network].solver.place_of(part.name)
        if part.network not in found:
            found[part.network] = np.tile([0.0, 1.0, 0.0, np.inf], (len(cells), 1))
        rows = np.flatnonzero(waiting(plan, cells) & (cells.phase == part.ends))
        found[part.network][rows, :3] = place, part.sign, part.value
        found[part.network][rows, SINCE] = waits_since(cells, dt)[rows]
    return found


def passages(plan: BiologyPlan, exposure: Exposure, met: FloatArray | None) -> FloatArray:
    """Return at which part of a step the conditions of waiting cells come true, (n,).

    Infinite where they do not.

    - ``met``, (n,): the same of conditions on networks
    """
    cells = exposure.cells
    first, waits = np.full(len(cells), np.inf), waiting(plan, cells)
    for part in plan.awaited:
        rows = np.flatnonzero(waits & (cells.phase == part.ends))
        if part.network:
            assert met is not None
            first[rows] = met[rows]
        elif rows.size:
            since = waits_since(cells, exposure.length)
            first[rows] = exposure[rows].first_beyond(part, since[rows])
    return first
