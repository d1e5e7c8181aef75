"""Readings of a scene's runs: what can be measured, from the scene alone, and what runs have."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from multicell.errors import SceneError
from multicell.results.measures import OBSERVABLES, scene_observables
from multicell.results.observable import OWN_OBSERVABLES
from multicell.results.quantities import entry, unit_of
from multicell.scene.scene import Scene
from multicell.schema import near_miss
from multicell.studies.status import FAILURES, failed_status, read_finished
from multicell.studies.table import at_times

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.studies.engine import RunOutcome

USUAL: Final = ("cells", "diameter", "viable_rim", "necrotic_radius", "heterotypic_fraction",
                 "pull", "largest_pressure")  # fmt: skip
_MAX_USUAL: Final = 4


def read_final(
    outcomes: Sequence[RunOutcome],
    folder: Path,
    observables: Sequence[str],
    times: FloatArray | None = None,
) -> tuple[dict[str, FloatArray], dict[str, str]]:
    """Return observables at the ends of runs or at times, and why runs failed.

    The viable rim of a population without a necrotic core is its radius, which is what it tends to
    as a core vanishes.

    - ``outcomes``: of all runs of a study, n
    - ``folder``: of the study
    - ``observables``: columns of histories, or (at the end) dotted names of entries of summaries
    - ``times``, (t,) s

    Returns dict of str to (n,), with times (n, t): NaN where a run failed or lacks the observable;
    dict of str to str: name of a run -> reason.
    """
    failures = {o.name: o.reason for o in outcomes if o.state == "failed"}
    shape = (len(outcomes),) if times is None else (len(outcomes), len(times))
    final = {name: np.full(shape, np.nan) for name in observables}
    for number, outcome in enumerate(outcomes):
        if outcome.state != "done":
            continue
        try:
            found = _read_run(folder, outcome.name, observables, times)
        except FAILURES as error:
            failures[outcome.name] = failed_status(outcome.name, error).reason
            continue
        for name in observables:
            final[name][number] = found[name]
    return final, failures


def _read_run(
    folder: Path, run: str, observables: Sequence[str], times: FloatArray | None
) -> dict[str, FloatArray | float]:
    history, summary = read_finished(run, folder)

    def value(name: str) -> FloatArray | float:
        if name not in history:
            return entry_of(summary, name)
        course = course_of(history, name)
        return float(course[-1]) if times is None else at_times(times, history["time"], course)

    return {name: value(name) for name in observables}


def chosen_observables(scene: Scene, names: Sequence[str] | None) -> list[str]:
    """Return the observables that are asked for, or the usual ones of a scene."""
    history = in_history(scene)
    known = {**history, **at_the_end(scene)}
    if names is None:
        starves = bool(scene.nutrients)
        usual: list[str] = [n for n in USUAL if n in history and (starves or n not in USUAL[2:4])]
        return usual[:_MAX_USUAL]
    if not names:
        raise SceneError("observables", "names none", f"For example {USUAL[1]}.")
    for name in names:
        if name not in known:
            raise SceneError(
                "observable", f"runs of this scene have no {name!r}", suggest(name, known)
            )
    return list(dict.fromkeys(names))


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
