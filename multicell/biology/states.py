"""Which cells proliferate, rest or are dead, from what they find around them.

**Why cells do not all react at once.** A resting cell takes up less nutrient. If all cells compared
the field with the threshold at every coupling step, those near it would rest together, the field
would recover, all would wake together, and the field would fall again: half of a spheroid was seen
to switch in every step, and cells died in the troughs. The oscillation is made by the coupling
step, not by the model: the steady state has a layer at the threshold in which a part of the cells
rests. So each cell decides at birth and then once in a reaction time, at times of its own.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multicell.biology.death import apoptotic, necrotic
from multicell.cells import Cells, FloatArray, State
from multicell.scene.coupling import fixed_step

if TYPE_CHECKING:
    from multicell.scene.scene import Scene


_GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)


def update_states(
    scene: Scene,
    cells: Cells,
    concentrations: Mapping[str, FloatArray],
    step: int = 0,
    dt: float = 0.0,
    time: float = 0.0,
) -> NDArray[np.int8]:
    """Return the new state of each cell.

    A cell turns necrotic where a nutrient is below its ``necrosis`` threshold, or above
    ``necrosis_above``, at once or at a rate (:func:`multicell.biology.death.necrotic`), and
    stays so for ever; one whose life by apoptosis has run out turns apoptotic. Another cell
    that is due to decide (:func:`deciding`) rests (quiescent) if a nutrient is below its
    ``quiescence`` threshold or its pressure reaches the critical pressure, and proliferates if
    neither holds. A scene that has neither nutrients nor a critical pressure leaves all states
    as they are.

    Parameters
    ----------
    scene
        Gives the thresholds and ``cells.reaction_time``.
    cells
        The population, n cells; its states, pressures, ages and identities are read.
    concentrations : mapping of (n,), mM
        Concentration at the cells, for every nutrient of the scene.
    step
        Number of the coupling step that has ended.
    dt
        Its length, s; 0 at the start of a run.
    time
        At its end, since the start of the run, s.

    Returns
    -------
    (n,) int8
        Values of :class:`multicell.cells.State`; ``cells`` is not changed.

    Raises
    ------
    KeyError
        If a nutrient of the scene has no concentrations.
    """
    critical = None if scene.growth is None else scene.growth.critical_pressure
    dies = apoptotic(scene, cells, time) & ~cells.dead
    if not scene.nutrients and critical is None:
        return np.where(dies, State.APOPTOTIC, cells.state).astype(np.int8)
    beyond = np.zeros(len(cells), dtype=bool)
    for name, nutrient in scene.nutrients.items():
        c = np.asarray(concentrations[name])
        if nutrient.necrosis is not None:
            beyond |= c < nutrient.necrosis
        if nutrient.necrosis_above is not None:
            beyond |= c > nutrient.necrosis_above
    dead = (cells.state == State.NECROTIC) | necrotic(scene, cells, beyond, step, dt)
    living = cells.state
    if not restricted(scene):
        resting = unfavourable(scene, cells, concentrations)
        wanted = np.where(resting, State.QUIESCENT, State.PROLIFERATING)
        due = deciding(cells, fixed_step(scene) or dt, scene.cells.reaction_time)
        living = np.where(due, wanted, cells.state)
    living = np.where(dies | (cells.state == State.APOPTOTIC), State.APOPTOTIC, living)
    dead &= living != State.APOPTOTIC
    return np.where(dead, State.NECROTIC, living).astype(np.int8)


def restricted(scene: Scene) -> bool:
    """Return whether cells rest in G0 only, which :mod:`multicell.biology.cycle` sees to."""
    growth = scene.growth
    return growth is not None and bool(growth.phases) and growth.restriction


def unfavourable(
    scene: Scene, cells: Cells, concentrations: Mapping[str, FloatArray]
) -> NDArray[np.bool_]:
    """Return which cells find too little nutrient or too much pressure to proliferate, (n,)."""
    resting = np.zeros(len(cells), dtype=bool)
    if scene.growth is not None and scene.growth.critical_pressure is not None:
        resting |= cells.pressure >= scene.growth.critical_pressure
    for name, nutrient in scene.nutrients.items():
        if nutrient.quiescence is not None:
            resting |= np.asarray(concentrations[name]) < nutrient.quiescence
    return resting


def deciding(cells: Cells, dt: float, reaction_time: float) -> NDArray[np.bool_]:
    """Return which cells decide in a step of length ``dt`` (s) that ends now, (n,).

    A cell decides at birth and whenever its age passes a multiple of the reaction time, shifted by
    a part of it that the identity sets: multiples of the golden ratio spread these parts evenly,
    and far apart for sisters. With a reaction time up to ``dt`` every cell decides in every step.
    """
    shift = (cells.id + 1) * _GOLDEN % 1.0
    now = np.floor(cells.age / reaction_time + shift)
    before = np.floor((cells.age - dt) / reaction_time + shift)
    return np.asarray((cells.age == 0.0) | (now > before))
