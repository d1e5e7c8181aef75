"""How much a coarse scene differs from the fine one, measured."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from multicell.results.quantities import known_unit
from multicell.scene.coarsening import coarsen
from multicell.scene.scene import Scene, load_scene
from multicell.studies.limits import MAX_SEEDS, whole
from multicell.studies.readings import observables_of
from multicell.studies.run_table import (
    RunTable,
    checked_times,
    folder_for,
    mean_and_error,
    values_of,
)
from multicell.studies.study import study

if TYPE_CHECKING:
    from multicell.studies.task import Outcome


def compare_coarse(
    scene: Scene | str | Path,
    factor: float,
    observables: Sequence[str] | None = None,
    *,
    seeds: int = 8,
    times: Sequence[float | str] | None = None,
    output: str | Path | None = None,
    cores: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[Outcome], None] | None = None,
) -> RunTable:
    """Run a scene and its coarse one with several seeds, and compare their observables.

    Parameters
    ----------
    scene, factor
        As in :func:`multicell.coarsen`.
    observables
        Columns of the history, or at the end also dotted entries of the summary; by default the
        usual ones of the scene.
    seeds
        Runs of each, at least 2.
    times
        When; by default at the end.
    output
        Folder; runs in its ``fine`` and ``coarse`` are studies, and are not run again. By default
        the runs are not kept.
    cores, scheduler, progress
        As in :meth:`multicell.studies.study.Study.run`.

    Returns
    -------
    RunTable
        A row for each observable and time: mean of both with standard errors (``..._se``),
        ``difference`` (coarse - fine) and its part of the fine value. The facts hold the time that
        the runs took, ``fine_seconds`` and ``coarse_seconds``.

    Raises
    ------
    SceneError
        As :func:`multicell.coarsen`, and for observables and times that runs do not have.
    OutputError, MissingPackage, ClusterError
        As :func:`multicell.study` and :meth:`multicell.studies.study.Study.run`.
    """
    fine = scene if isinstance(scene, Scene) else load_scene(scene)
    scenes = {"fine": fine, "coarse": coarsen(fine, factor)}
    whole("seeds", seeds, 2, MAX_SEEDS, "It is the number of runs of each.")
    named, at = observables_of(fine, observables), checked_times(fine, times)
    found, notes, seconds = {}, [], {}
    with folder_for(output) as folder:
        for name, one in scenes.items():
            runs = study(one, output=folder / name, seeds=seeds)
            found[name], own = values_of(runs, named, at, cores, scheduler, progress)
            notes += [f"{name}: {note}" for note in own]
            seconds[f"{name}_seconds"] = float(np.nansum([s.wall for s in runs.status()]))
    rows = []
    for name in named:
        for t, time in enumerate([fine.duration] if at is None else at):
            mean, its = mean_and_error(found["fine"][name][0, :, t])
            other, error = mean_and_error(found["coarse"][name][0, :, t])
            apart = other - mean
            rows.append({
                "observable": name, "unit": known_unit(name), "time": float(time),
                "fine": mean, "fine_se": its, "coarse": other, "coarse_se": error,
                "difference": apart, "difference_se": float(np.hypot(its, error)),
                "relative": apart / mean if mean else float("nan"),
            })  # fmt: skip
    return RunTable(rows, notes, {"factor": float(factor), "seeds": seeds, **seconds})
