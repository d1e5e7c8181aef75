"""Sensitivity of a scene's observables to its parameters: Morris' screening."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, final

from multicell.calibration.sensitivity.indices import (
    INDEX_COLUMNS,
    MIN_SIZE,
    RELIABLE,
    Analysis,
    sample,
    sensitivity_indices,
)
from multicell.calibration.sensitivity.numbers import Row, failure_notes, index_rows
from multicell.calibration.sensitivity.result import Sensitivity, SobolIndices
from multicell.calibration.sensitivity.sobol import sobol_result, sobol_sample
from multicell.host.extras import needs
from multicell.scene.scene import load_scene
from multicell.schema import chosen
from multicell.studies.axes import Range, check_ranges, parse_ranges
from multicell.studies.limits import MAX_POINTS, check_runs, check_seeds, whole_between
from multicell.studies.plan import Plan, make_plan
from multicell.studies.readings import chosen_observables, read_final
from multicell.studies.study import Study, write_study

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.scene.scene import Scene
    from multicell.studies.engine import RunOutcome


METHODS_OF_ANALYSIS: Final = ("morris", "sobol")


def sensitivity(
    scene: Scene | str | Path,
    free: Mapping[str, Any],
    *,
    method: str = "morris",
    size: int | None = None,
    seeds: int = 1,
    observables: Sequence[str] | None = None,
    output: str | Path = "sensitivity",
    overwrite: bool = False,
    cores: int | None = None,
    scheduler: str | None = None,
    retry: bool = False,
    report: bool = True,
    progress: Callable[[RunOutcome], None] | None = None,
) -> Sensitivity | SobolIndices:
    """Find out which parameters of a scene decide its observables.

    The runs are those of a study whose points are a list, in the same folder: ``multicell study
    status`` says how they stand. An analysis that was stopped continues when it is asked for
    again, and a larger ``size`` or more ``seeds`` take the runs that are there.

    Parameters
    ----------
    scene
        A scene, the name of a built-in one, or a path.
    free
        Key -> range, ``{"growth.cycle_time": "8:25 h", "drag.viscosity": "log 0.1:10 kPa s"}``.
    method
        ``"morris"``: screening, effects in the observable's unit; ``"sobol"``: parts of its
        variance (:mod:`multicell.calibration.sensitivity.sobol`), in many more runs.
    size
        Trajectories of Morris, by default 10: so many times one run more than parameters. Points of
        Sobol', a power of two, by default 64: so many times two runs more than parameters.
    seeds
        How many runs at each point: the seed of the scene and those after it, the same ones at all
        points. With two or more the indices are set against the noise.
    observables
        Columns of a run's history, taken at its end, and dotted entries of its summary.
    output
        Folder.
    overwrite
        Whether the folder may hold another analysis, whose runs stay.
    cores, scheduler, retry
        As in :meth:`multicell.studies.study.Study.run`.
    report
        Whether to write the page and its pictures; tables are written in any case.
    progress
        Called with the outcome of each run.

    Raises
    ------
    SceneError
        For anything that cannot be asked: unknown keys, ranges that the scene refuses, an unknown
        observable, a sample that is too small.
    MissingPackage
        If SALib or Dask is not installed.
    OutputError
        If the folder cannot be used, or holds something else.
    ClusterError
        If the scheduler does not answer.
    """
    plan = plan_sensitivity(
        scene, free, method=method, size=size, seeds=seeds, observables=observables
    )
    write_study(plan.study, output, overwrite=overwrite)
    how = {"cores": cores, "scheduler": scheduler, "progress": progress, "retry": retry}
    result = run_sensitivity_plan(plan, output, **how)
    if report:
        result.report()
    return result


@final
@dataclass(frozen=True)
class SensitivityPlan:
    """An analysis that was checked and has not run.

    - ``scene``, ``ranges``, ``size``, ``observables``, ``method``: as in
      :func:`multicell.sensitivity`
    - ``study``: the plan of its runs: the points that differ, as a list
    - ``rows``, (n,): the number of each point of the sample in the study
    """

    scene: Scene
    ranges: tuple[Range, ...]
    size: int
    observables: tuple[str, ...]
    study: Plan
    rows: tuple[int, ...]
    method: str = "morris"

    @property
    def seeds(self) -> tuple[int, ...]:
        """The seeds of the runs at each point."""
        return tuple(range(self.scene.seed, self.scene.seed + self.study.seeds))


def plan_sensitivity(
    scene: Scene | str | Path,
    free: Mapping[str, Any],
    *,
    method: str = "morris",
    size: int | None = None,
    seeds: int = 1,
    observables: Sequence[str] | None = None,
) -> SensitivityPlan:
    """Return the plan of an analysis, in which everything is checked.

    Parameters and errors are those of :func:`sensitivity`.
    """
    needs("SALib", "distributed")
    described = load_scene(scene) if isinstance(scene, str | Path) else scene
    chosen(method, METHODS_OF_ANALYSIS, "method")
    sobol = method == "sobol"
    size = (64 if sobol else 10) if size is None else size
    hint = "It is the number of trajectories; fewer have no interval."
    whole_between("size", size, MIN_SIZE, MAX_POINTS, "" if sobol else hint)
    ranges = parse_ranges(free, described)
    check_ranges(described, ranges)
    wanted = chosen_observables(described, observables)
    check_seeds(seeds, described.seed)
    check_runs(size * (len(ranges) + (2 if sobol else 1)), seeds, "size")
    shares = (sobol_sample if sobol else sample)([one.name for one in ranges], size)
    points = [
        tuple(free.setting(free.value(float(x))) for free, x in zip(ranges, row, strict=True))
        for row in shares
    ]
    numbers = {point: number for number, point in enumerate(dict.fromkeys(points))}
    columns = zip(*numbers, strict=True)
    table = {free.key: list(column) for free, column in zip(ranges, columns, strict=True)}
    study = make_plan(described, points=table, seeds=seeds)
    rows = tuple(numbers[point] for point in points)
    return SensitivityPlan(described, ranges, size, tuple(wanted), study, rows, method)


def run_sensitivity_plan(
    plan: SensitivityPlan, output: str | Path, **how: Any
) -> Sensitivity | SobolIndices:
    """Do all runs of a plan that are not done, and return the result.

    - ``how``: as :meth:`multicell.studies.study.Study.run` takes it
    """
    folder = Path(output)
    study = Study(plan.study, folder)
    outcomes = study.run(**how)
    final, failures = read_final(outcomes, folder, plan.observables)
    shape = len(plan.study.points), plan.study.seeds
    values = {n: column.reshape(shape)[list(plan.rows)] for n, column in final.items()}
    given = plan.scene, plan.ranges, plan.seeds, values, failures
    found: Sensitivity | SobolIndices
    found = sobol_result(*given) if plan.method == "sobol" else sample_sensitivity(*given)
    result = replace(found, folder=folder)
    result.write_tables()  # numbers do not wait for a page
    return result


def sample_sensitivity(
    scene: Scene,
    ranges: Sequence[Range],
    seeds: Sequence[int],
    values: Mapping[str, FloatArray],
    failures: Mapping[str, str] = MappingProxyType({}),
) -> Sensitivity:
    """Return the sensitivity of whatever has values at the points of a sample.

    - ``scene``, ``ranges``, ``seeds``: as in :func:`sensitivity`, checked
    - ``values``, observable -> (n, seeds): at the points of
      :func:`multicell.calibration.sensitivity.indices.sample`; NaN where there is none
    - ``failures``: name of a run that failed -> reason
    """
    names = [free.name for free in ranges]
    size = len(next(iter(values.values()))) // (len(names) + 1)
    shares = sample(names, size)
    found = {name: sensitivity_indices(names, shares, known) for name, known in values.items()}
    table: list[Row] = []
    for name, analysis in found.items():
        columns = {column: analysis.columns[column].tolist() for column in INDEX_COLUMNS}
        table += index_rows(name, ranges, {**columns, "verdict": analysis.verdicts})
    notes = _notes(size, seeds, found, failures)
    return Sensitivity(scene, tuple(ranges), size, tuple(seeds), table, notes, failures)


def _notes(
    size: int, seeds: Sequence[int], found: Mapping[str, Analysis], failures: Mapping[str, str]
) -> list[str]:
    """Return notes for readers of the result."""
    notes = failure_notes(failures)
    for name, analysis in found.items():
        if analysis.used < 2:
            notes.append(
                f"{name}: fewer than two trajectories have all their runs: no index is known"
            )
        elif analysis.constant:
            notes.append(f"{name} is the same in all runs: no parameter decides it")
        if 2 <= analysis.used < size:
            notes.append(f"{name}: {size - analysis.used} of {size} trajectories lack a run")
    if size < RELIABLE:
        notes.append(
            f"{size} trajectories: intervals of 95 % cover about 90 %, from {RELIABLE} on what "
            "they say"
        )
    if len(seeds) == 1:
        notes.append("one seed: the noise is unknown, an index may be noise; take at least two")
    return notes
