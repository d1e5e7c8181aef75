"""Observables of a scene's runs, known from the scene alone."""

from __future__ import annotations

from collections.abc import Mapping
from fnmatch import fnmatchcase
from typing import Any

import numpy as np
from numpy.typing import NDArray

from multicell.cells import FloatArray
from multicell.results.measures import OBSERVABLES, scene_observables
from multicell.results.observable import OWN_OBSERVABLES
from multicell.results.quantities import entry, unit_of
from multicell.scene.scene import Scene
from multicell.schema import near_miss


def may_be_negative(name: str) -> bool:
    """Return whether an observable may be negative."""
    return any(
        o.signed and fnmatchcase(name, o.name) for o in (*OBSERVABLES, *OWN_OBSERVABLES.values())
    )


def in_history(scene: Scene) -> dict[str, str]:
    """Return the observables that have a value at any time of a run, with their base units."""
    return _units(scene, at_end=False)


def at_the_end(scene: Scene) -> dict[str, str]:
    """Return the observables that only the summary of a run holds, by dotted names, with units."""
    return _units(scene, at_end=True)


def _units(scene: Scene, *, at_end: bool) -> dict[str, str]:
    found = (pair for pair in scene_observables(scene) if pair[0].at_end == at_end)
    return {o.name.replace("*", key): o.unit for o, key in found}


def suggest(name: str, options: Mapping[str, Any]) -> str:
    """Return which observable may have been meant, and the list of all."""
    parts = [o for o in options if name.lower() in o.lower() or o.lower() in name.lower()]
    known = near_miss(name, options)
    if not parts or known.startswith("Did you mean"):
        return known
    return f"Did you mean '{min(parts, key=len)}'? {known}"


def is_known_elsewhere(name: str) -> bool:
    """Return whether a name is one of some run's numbers, if not of this scene's."""
    try:
        unit_of(name)
    except KeyError:
        return False
    return True


def course_of(history: Mapping[str, NDArray[np.float64]], name: str) -> NDArray[np.float64]:
    """Return an observable over the steps of a run, (m,): the viable rim also without a core.

    A rim grows into the radius as the core becomes smaller; where nothing is dead it is the radius.
    """
    values = history[name]
    if name != "viable_rim":
        return values
    return np.where(history["necrotic_radius"] == 0.0, 0.5 * history["diameter"], values)


def entry_of(summary: Mapping[str, Any], name: str) -> float:
    """Return a number of a summary by its dotted name, NaN where there is none."""
    found = entry(summary, name)
    return float(found) if isinstance(found, int | float) else float("nan")


def value_at(
    history: Mapping[str, NDArray[np.float64]],
    summary: Mapping[str, Any],
    name: str,
    times: FloatArray | None,
) -> FloatArray | float:
    """Return an observable of a run at times, (t,), or at its end; NaN where it has none."""
    if name not in history:
        return entry_of(summary, name)
    course = course_of(history, name)
    return float(course[-1]) if times is None else at_times(times, history["time"], course)


def at_times(times: FloatArray, known: FloatArray, values: FloatArray) -> FloatArray:
    """Return a column of a history at other times: linear between its rows, NaN beyond the last.

    Where the value of a row does not exist (NaN), it does not between that row and the next ones
    either; at the time of a row it is that of the row.
    """
    result = np.interp(times, known, values, right=np.nan)
    # interpolation to the very time of a row beside one that is NaN must give the row
    place = np.searchsorted(known, times * (1.0 - 1e-12)).clip(max=len(known) - 1)
    exact = np.isclose(known[place], times, rtol=1e-12, atol=0.0)
    result[exact] = values[place[exact]]
    return result
