"""Observables of the runs of a study."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from multicell.errors import SceneError
from multicell.measured.observables import at_the_end, in_history, suggest, value_at
from multicell.scene.scene import Scene
from multicell.studies.status import FAILURES, failed_status, read_finished

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.studies.engine import RunOutcome

USUAL: Final = (
    "cells",
    "diameter",
    "viable_rim",
    "necrotic_radius",
    "heterotypic_fraction",
    "pull",
    "largest_pressure",
)
_MAX_USUAL: Final = 4  # observables of a study that names none


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
            history, summary = read_finished(outcome.name, folder)
        except FAILURES as error:
            failures[outcome.name] = failed_status(outcome.name, error).reason
            continue
        for name in observables:
            final[name][number] = value_at(history, summary, name, times)
    return final, failures


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
