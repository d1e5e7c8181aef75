"""Observables of runs that a study has done: at their ends, or at given times."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from multicell.errors import MulticellError, SceneError
from multicell.results.documents import read_table
from multicell.studies.observed import at_the_end, course_of, entry_of, in_history, suggest
from multicell.studies.status import run_folder
from multicell.studies.table import at_times

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.scene.scene import Scene
    from multicell.studies.task import Outcome

_USUAL: Final = ("cells", "diameter", "viable_rim", "necrotic_radius", "heterotypic_fraction",
                 "pull", "largest_pressure")  # fmt: skip
_MAX_USUAL: Final = 4


def read_final(
    outcomes: Sequence[Outcome],
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
            found = _read_run(run_folder(folder, outcome.name), observables, times)
        except MulticellError as error:
            failures[outcome.name] = str(error)
            continue
        for name in observables:
            final[name][number] = found[name]
    return final, failures


def _read_run(
    place: Path, observables: Sequence[str], times: FloatArray | None
) -> dict[str, FloatArray | float]:
    """Return the values of a run."""
    from multicell.results.reader import Contents

    history = Contents(place).history()
    summary = read_table(place / "summary.json") or {}

    def value(name: str) -> FloatArray | float:
        if name not in history:
            return entry_of(summary, name)
        course = course_of(history, name)
        return float(course[-1]) if times is None else at_times(times, history["time"], course)

    return {name: value(name) for name in observables}


def observables_of(scene: Scene, names: Sequence[str] | None) -> list[str]:
    """Return the observables that are asked for, or the usual ones of a scene."""
    history = in_history(scene)
    known = {**history, **at_the_end(scene)}
    if names is None:
        starves = bool(scene.nutrients)
        usual: list[str] = [n for n in _USUAL if n in history and (starves or n not in _USUAL[2:4])]
        return usual[:_MAX_USUAL]
    if not names:
        raise SceneError("observables", "names none", f"For example {_USUAL[1]}.")
    for name in names:
        if name not in known:
            raise SceneError(
                "observable", f"runs of this scene have no {name!r}", suggest(name, known)
            )
    return list(dict.fromkeys(names))
