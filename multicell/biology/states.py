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
from multicell.biology.division import ROUNDING, due_to_divide
from multicell.biology.responding import rate_of_harm, wants_rest
from multicell.cells import Cells, FloatArray, State

if TYPE_CHECKING:
    from multicell.biology.plan import BiologyPlan


_GOLDEN = float(0.5 * (np.sqrt(5.0) - 1.0))
_GROWING, _RESTING = np.int8(State.PROLIFERATING), np.int8(State.QUIESCENT)


def update_states(
    plan: BiologyPlan,
    cells: Cells,
    concentrations: Mapping[str, FloatArray],
    step: int = 0,
    dt: float = 0.0,
    time: float = 0.0,
) -> NDArray[np.int8]:
    """Return the new state of each cell.

    A cell turns necrotic at the rate that its responses give (a threshold: at once;
    :func:`multicell.biology.death.necrotic`) or with as much damage as it bears, and stays so for
    ever; one whose life by apoptosis has run out turns apoptotic, and so does one at the end of its
    cycle that irradiation has doomed to die in place of this division. Another cell that is due to
    decide (:func:`deciding`) rests (quiescent) if a response lets it
    (:func:`multicell.biology.responding.wants_rest`), and proliferates if none does. Where nothing
    lets cells rest, their states stay as they are.

    - ``step``: number of the coupling step that has ended
    - ``dt``: its length, s; 0 at the start of a run

    Returns (n,) int8: values of :class:`multicell.cells.State`; ``cells`` is not changed.
    """
    state = cells.state
    if plan.may_rest and not plan.restricted:
        resting = wants_rest(plan, cells, concentrations)
        due = deciding(cells, plan.step, plan.reaction_time)
        state = np.where(due, np.where(resting, _RESTING, _GROWING), state)
    return _with_deaths(plan, cells, concentrations, state, step, dt, time)


def _with_deaths(
    plan: BiologyPlan,
    cells: Cells,
    concentrations: Mapping[str, FloatArray],
    living: NDArray[np.int8],
    step: int,
    dt: float,
    time: float,
) -> NDArray[np.int8]:
    """Return the states that cells have if they live, but for those that are dead or die now."""
    hazard = rate_of_harm(plan, "necrosis rate", concentrations, cells)
    dies_by_clock = "apoptosis rate" in plan.base_rates
    fatal = "damage rate" in plan.responses and cells.damage >= 1.0 - ROUNDING
    last = cells.doomed == 1 if plan.growth is not None else np.zeros(len(cells), dtype=bool)
    if last.any():
        last &= due_to_divide(plan, cells, concentrations)
    if not (
        dies_by_clock
        or last.any()
        or (hazard is not None and hazard.any())
        or np.any(fatal)
        or cells.dead.any()
    ):
        return living.copy()
    apoptosis = (cells.state == State.APOPTOTIC) | last
    if dies_by_clock:
        apoptosis |= apoptotic(plan, cells, concentrations, step, dt, time) & ~cells.dead
    necrosis = (cells.state == State.NECROTIC) | fatal
    if hazard is not None:
        necrosis |= necrotic(plan, cells, hazard, step, dt)
    state = living.copy()
    state[necrosis] = State.NECROTIC
    state[apoptosis] = State.APOPTOTIC
    return state


def deciding(cells: Cells, dt: float, reaction_time: float) -> NDArray[np.bool_]:
    """Return which cells decide in a step of length ``dt`` (s) that ends now, (n,).

    A cell decides at birth and whenever its age passes a multiple of the reaction time, shifted by
    a part of it that the identity sets: multiples of the golden ratio spread these parts evenly,
    and far apart for sisters. It does so at the end of the step that is nearest to that moment, so
    that decisions are neither late nor early on average. With a reaction time up to ``dt`` every
    cell decides in every step.
    """
    shift = (cells.id + 1) * _GOLDEN % 1.0
    now = np.floor((cells.age + 0.5 * dt) / reaction_time + shift)
    before = np.floor((cells.age - 0.5 * dt) / reaction_time + shift)
    return np.asarray((now > before) | (cells.age < dt))
