"""Check whether a table of cells fits the scene that starts with it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import HALF, FloatArray, Phase, State
from multicell.errors import DataError
from multicell.scene.domain import strayed
from multicell.scene.sizes import birth_radius, division_radii, radius_scales
from multicell.scene.start_table import Given, near_pairs, positions, refuse_coinciding
from multicell.schema import near_miss
from multicell.tables.titles import titled
from multicell.units import shown, whole_number

if TYPE_CHECKING:
    from multicell.scene.scene import Scene

_ROUNDING: Final = 1e-6  # relative: tables may be written with seven digits
_BEYOND: Final = 2.0 ** (1.0 / 3.0)
"""Radius that a cell with phases may have over the division radius: it divides by its clock.

One whose phase is known may have any: held there it grows, and a hypertrophic one may die.
"""
_SWOLLEN: Final = 2.0
"""Radius of a dead cell over the division radius: necrotic ones swell to 8 volumes at most."""


def check_start_table(scene: Scene) -> None:
    """Raise ``DataError`` with row and column for cells that cannot start in a scene."""
    assert scene.initial.cells is not None
    given = scene.initial.cells.given
    period = _period(scene)
    if scene.contact.acts:
        refuse_coinciding(given, period, near=False)
    _check_axes(scene, given)
    kinds_of(scene, given)
    _check_phases(scene, given)
    _check_sizes(scene, given)
    if scene.contact.acts:  # by radii that can be: a giant's centre is near to all
        refuse_coinciding(given, period, near=True)
    _check_places(scene, given)
    _check_inside(scene, given)


def deep_overlaps(scene: Scene) -> int:
    """Return how many pairs of a table's cells are nearer than half the sum of their radii.

    Cells whose radii the table does not give count as newborn.
    """
    assert scene.initial.cells is not None
    given = scene.initial.cells.given
    newborn = HALF * _division_radii(scene, given)
    usual = newborn if newborn.ndim else birth_radius(scene)
    return len(near_pairs(given, 0.5, usual, _period(scene)))


def _period(scene: Scene) -> FloatArray | None:
    """Return the period of a scene's domain; None also of one that lacks a side: it is refused."""
    period = None if scene.domain is None else scene.domain.period
    return period if period is not None and np.isfinite(period).all() else None


def _division_radii(scene: Scene, given: Given) -> FloatArray:
    """Return the radius in µm at which each cell of a table divides, (n,).

    One number where the table gives no types: the largest, since types are not drawn yet.
    """
    kinds = kinds_of(scene, given)
    if kinds is None:
        return np.asarray(division_radii(scene)[1])
    return np.asarray(scene.cells.division_radius * np.array(radius_scales(scene))[kinds])


def kinds_of(scene: Scene, given: Given) -> NDArray[np.int16] | None:
    """Return the types in a table by their places in the scene, (n,); None if it has none."""
    if "kind" not in given.columns:
        return None
    codes, names = given.columns["kind"], list(scene.types)
    numbers = [_type_of(name, names) for name in given.kinds]
    for code, number in enumerate(numbers):
        if number is None:
            row = int(np.argmax(codes == code))
            problem = f"is {shown(given.kinds[code])}, no type of this scene"
            table = f"[types.{given.kinds[code][:40]}]"
            none = f"It has no [types]: write {table}, or leave the column out."
            hint = near_miss(given.kinds[code], names) if names else none
            raise DataError(given.place(row, "kind"), problem, hint)
    return np.asarray(np.array(numbers, dtype=np.int16)[codes])


def _type_of(word: str, names: list[str]) -> int | None:
    """Return the place of a type by its name, or by this number as text."""
    if word in names:
        return names.index(word)
    number = whole_number(word)
    # in a scene without types all cells are of type 0
    return number if number is not None and number < max(len(names), 1) else None


def _check_axes(scene: Scene, given: Given) -> None:
    """Check that cells have a place in the scene's dimensions."""
    z = given.columns.get("position_z")
    if scene.dimensions == 2 and z is not None:
        hint = "Leave the column out, or set it to 0."
        given.refuse(z != 0.0, "position_z", "is {}, but the scene has 2 dimensions", hint)
    if scene.dimensions == 3 and z is None:
        hint = f"Title it '{titled('position_z', 'um')}'; with dimensions = 2 there is none."
        raise DataError(given.source.name, "has no column for z", hint)


def _check_phases(scene: Scene, given: Given) -> None:
    """Check that the place in the cycle is one of this scene's cycles, and that cells are in it."""
    columns = given.columns
    if scene.growth is None or not scene.growth.phases:
        for name in (x for x in ("phase", "progress", "phase_length") if x in columns):
            hint = "growth.phases gives them; else leave the column out."
            given.refuse(columns[name] != 0, name, "is {}, but the scene has no phases", hint)
        return
    state, growth = columns.get("state", np.zeros(len(given))), scene.growth
    if "phase" not in columns:
        own_pace = growth.volume_doubling_time is not None or growth.target_scales is not None
        if "radius" in columns and own_pace:
            hint = "Phases do not follow from sizes with volume_doubling_time or target_scale."
            raise DataError(given.source.name, "has no column 'phase'", hint)
        for name in (x for x in ("progress", "phase_length") if x in columns):
            where = f"{given.source.name}, '{given.titles[name]}'"
            raise DataError(where, "has no meaning without a column 'phase'")
    elif "state" in columns or not columns["phase"].any():
        wrong = (state == State.PROLIFERATING) & (columns["phase"] == Phase.G0)
        hint = "Cells in G0 are quiescent; leave the column out to draw phases."
        given.refuse(wrong, "phase", "is {}, but the cell proliferates", hint)
    if "progress" in columns and "phase_length" in columns:
        beyond = columns["progress"] > columns["phase_length"] * (1.0 + _ROUNDING)
        beyond &= ~growth.waits[columns["phase"].astype(int)]
        problem = "is {}, more than the length of the phase"
        given.refuse(beyond & (state <= State.QUIESCENT), "progress", problem)


def _check_sizes(scene: Scene, given: Given) -> None:
    """Check radii, Poisson ratios and cycle times against those that the scene allows."""
    columns, limit = given.columns, _division_radii(scene, given)
    if "radius" in columns:
        dead = columns.get("state", np.zeros(len(given))) > State.QUIESCENT
        phases = scene.growth is not None and bool(scene.growth.phases)
        most = np.where(dead, _SWOLLEN, _BEYOND if phases else 1.0) * limit
        if phases and "phase" in columns:  # of a run, where cells may have been held in one
            most = np.full(len(given), np.inf)
        wrong = columns["radius"] > most * (1.0 + _ROUNDING)
        own = np.broadcast_to(limit, len(given))[np.argmax(wrong)]
        problem = f"is {{}}, beyond the radius of a dividing cell, {own:g} um"
        hint = "Set cells.division_radius to that of your cells, or check the unit."
        given.refuse(wrong, "radius", problem, hint)
    if "poisson" in columns:
        wrong = ~((columns["poisson"] > -1.0) & (columns["poisson"] <= 0.5))
        given.refuse(wrong, "poisson", "is {}, must be above -1 and at most 0.5")
    if "cycle_time" in columns and scene.growth is not None:
        endless = np.isinf(columns["cycle_time"])
        hint = "Leave the column out to draw cycle times."
        given.refuse(endless, "cycle_time", "is {}, but the cells of this scene grow", hint)


def _check_places(scene: Scene, given: Given) -> None:
    """Check that all centres are inside the domain."""
    found = None if scene.domain is None else strayed(scene.domain, positions(given))
    if found is None:
        return
    row, side = found
    axis = f"position_{side[0]}"
    value = given.columns[axis][row] if axis in given.columns else 0.0
    problem = f"is {value:g} um, outside the domain: beyond its side {side}"
    hint = "Widen the domain, or move the cells."
    raise DataError(given.place(row, axis), problem, hint)


def _check_inside(scene: Scene, given: Given) -> None:
    """Check that values of networks are of networks here, in cells that have these."""
    if not given.inside:
        return
    from multicell.scene.networks import HIDDEN, columns_of_network

    own = {x: name for name in scene.networks for x in columns_of_network(scene, name)}
    known, kinds = [name for name in own if HIDDEN not in name], kinds_of(scene, given)
    for name, values in given.inside.items():
        if name not in known:
            hint = near_miss(name, known) if known else "The scene has no networks."
            title = given.titles[name]
            raise DataError(f"{given.source.name}, '{title}'", "is no value of a network", hint)
        types = scene.networks[own[name]].types
        if types and kinds is not None:
            has = np.isin(kinds, [list(scene.types).index(kind) for kind in types])
            problem = f"is {{}}, but cells of this type have no network {own[name]!r}"
            given.refuse(~has & ~np.isnan(values), name, problem, "Leave it empty.")
