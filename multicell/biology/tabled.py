"""The population at the start as a table gives it; what the table leaves open is drawn."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multicell import random
from multicell.biology.cycle import (
    growing_time,
    place_by_volume,
    place_in_cycle,
    share_of_growth,
    time_before_phase,
    volume_in_phase,
    volume_ratio,
)
from multicell.biology.draws import draw_cycle_times, draw_kinds, draw_lengths, draw_moduli, stages
from multicell.biology.plan import BiologyPlan, biology_plan
from multicell.cells import SPHERE, Cells, FloatArray, Phase, State
from multicell.random import Purpose
from multicell.scene.start_checks import check_start_table, kinds_of, positions

if TYPE_CHECKING:
    from multicell.scene.scene import Scene
    from multicell.scene.start_table import Given


def tabled_cells(scene: Scene) -> Cells:
    """Return the cells that a scene's table gives, in its order.

    What has no column is drawn as for cells that the scene arranges, with random numbers that
    depend on the seed and the identity of a cell alone. Radius, age and place in the cycle belong
    together: of those that are missing each follows from those that are there.

    Returns Cells: identities of the table, else numbered by its rows; parent -1 but for sisters
    that part.
    """
    check_start_table(scene)
    plan = biology_plan(scene)
    assert scene.initial.cells is not None
    given = scene.initial.cells.given
    columns, n = given.columns, len(given)
    ids = columns.get("id", np.arange(n, dtype=np.int64))
    kind = kinds_of(scene, given)
    kind = draw_kinds(plan, ids) if kind is None else kind
    cells = Cells(
        id=ids,
        parent=np.full(n, -1, dtype=np.int64),
        position=positions(given),
        radius=np.ones(n),
        young=columns["young"] if "young" in columns else draw_moduli(plan, ids, kind),
        poisson=columns.get("poisson", np.full(n, scene.cells.poisson)),
        state=_states(given),
        age=np.zeros(n),
        cycle_time=np.full(n, np.inf),
        pressure=columns.get("pressure", np.zeros(n)),
        kind=kind,
        doomed=columns.get("doomed", np.zeros(n, dtype=np.int8)),
        damage=columns.get("damage", np.zeros(n)),
        lag=columns.get("lag", np.zeros(n)),
    )
    phases = bool(plan.order)
    volume = _in_phases(plan, cells, given) if phases else _without_phases(plan, cells, given)
    cells.radius = columns.get("radius", np.cbrt(volume / SPHERE))
    if "age" in columns:
        cells.age = columns["age"]
    elif cells.dead.any():
        cells.age = np.where(cells.dead, 0.0, cells.age)
    if phases and "parent" in columns:
        cells.parent = _mothers(plan, cells, given)
    return cells.copy()  # the table stays as it is


def _mothers(plan: BiologyPlan, cells: Cells, given: Given) -> NDArray[np.int64]:
    """Return the mothers of sisters that part, -1 for all other cells.

    Only of those does it matter: they are in M together, where division is smooth.
    """
    assert plan.growth is not None
    mother = np.full(len(cells), -1, dtype=np.int64)
    if plan.growth.division != "smooth":
        return mother
    named = given.columns["parent"]
    young = np.flatnonzero((cells.phase == Phase.M) & (named >= 0))
    _, place, number = np.unique(named[young], return_inverse=True, return_counts=True)
    crowd = np.zeros(len(cells), dtype=bool)
    crowd[young] = number[place] > 2
    given.refuse(crowd, "parent", "is {}, the mother of more than two cells in M")
    sisters = young[number[place] == 2]
    mother[sisters] = named[sisters]
    return mother


def _states(given: Given) -> NDArray[np.int8]:
    """Return the states of the cells; those in G0 rest where nothing else is said."""
    if "state" in given.columns:
        return given.columns["state"]
    state = np.full(len(given), State.PROLIFERATING, dtype=np.int8)
    if "phase" in given.columns and given.columns["phase"].any():
        state[given.columns["phase"] == Phase.G0] = State.QUIESCENT
    return state


def _volume_of(plan: BiologyPlan, given: Given) -> FloatArray | None:
    """Return the volumes of the cells over that at birth, (n,), if the table tells them."""
    radius = given.columns.get("radius")
    return None if radius is None else np.asarray(SPHERE * radius**3 / plan.birth_volume)


def _without_phases(plan: BiologyPlan, cells: Cells, given: Given) -> FloatArray:
    """Give cells cycle times and ages; return their volumes, µm³."""
    drawn = draw_cycle_times(plan, cells.id, cells.kind)
    cells.cycle_time = given.columns.get("cycle_time", drawn)
    volume = _volume_of(plan, given)
    if volume is not None:
        progress = share_of_growth(plan, volume)
    elif "age" in given.columns and plan.growth is not None:
        progress = _share_of_cycle(cells, given, cells.cycle_time)
    else:
        progress = stages(plan, cells.id, cells.kind, cells.cycle_time)
    if plan.growth is not None:
        cells.age = progress * cells.cycle_time
    ratio = volume_ratio(plan, progress) if volume is None else volume
    return np.asarray(plan.birth_volume * ratio)


def _in_phases(plan: BiologyPlan, cells: Cells, given: Given) -> FloatArray:
    """Give cells their place in the cycle; return their volumes, µm³."""
    columns = given.columns
    lengths = draw_lengths(plan, cells.id, cells.kind)
    cells.cycle_time = columns.get("cycle_time", growing_time(plan, lengths))
    volume = _volume_of(plan, given)
    if "phase" in columns:
        cells.phase = columns["phase"]
        _in_given_phase(plan, cells, given, lengths)
    elif volume is not None:
        place_by_volume(plan, cells, volume)
    else:
        share = stages(plan, cells.id, cells.kind, lengths.sum(axis=1))
        if "age" in columns:
            share = _share_of_cycle(cells, given, lengths.sum(axis=1))
        own = cells.cycle_time
        place_in_cycle(plan, cells, lengths, share)
        cells.cycle_time = own
    cells.age = time_before_phase(plan, cells)[:, 0] + cells.progress
    return np.asarray(plan.birth_volume * volume_in_phase(plan, cells))


def _in_given_phase(plan: BiologyPlan, cells: Cells, given: Given, lengths: FloatArray) -> None:
    """Say how long cells are to be in the phases that the table gives, and have been."""
    columns, resting = given.columns, cells.phase == Phase.G0
    own = np.where(resting, 0.0, lengths[np.arange(len(cells)), cells.phase - 1])
    cells.phase_length = columns.get("phase_length", own)
    if "progress" in columns:
        cells.progress = columns["progress"]
        beyond = (cells.progress > cells.phase_length) & ~cells.dead
        problem = "is {}, more than the length of the phase that is drawn for the cell"
        hint = "Give a column 'phase_length_s', or leave progress out."
        given.refuse(beyond, "progress", problem, hint)
        return
    share = np.zeros(len(cells))
    if plan.stage != "birth":
        share = random.uniform(plan.seed, Purpose.STAGE, 0, cells.id)[:, 0]
    cells.progress = share * cells.phase_length


def _share_of_cycle(cells: Cells, given: Given, cycle: FloatArray) -> FloatArray:
    """Return the part of the cycle that cells have behind them by their age, (n,)."""
    share = given.columns["age"] / cycle
    share = np.where(cells.dead, 0.0, share)  # the age of the dead counts from their death
    hint = "Give a column 'radius_um': of cells that have rested the age does not tell the size."
    given.refuse(share >= 1.0, "age", "is {}, beyond the cycle time of the cell", hint)
    return share
