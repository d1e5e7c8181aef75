"""The points of a study beside measured data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, final

from multicell.errors import DataError, OutputError
from multicell.measured.compared import MeasuredComparison, compare_runs
from multicell.measured.table import read_measurements
from multicell.report.plots.compared import compared
from multicell.studies.status import FAILURES, read_finished

if TYPE_CHECKING:
    from multicell.studies.runs import StudyRun
    from multicell.studies.study import Study


@final
@dataclass(frozen=True, eq=False)
class PointComparison:
    """One point of a study beside measured data.

    - ``coordinates``: of the point, without the seed
    - ``comparison``: of its runs with the data of its conditions
    """

    coordinates: Mapping[str, Any]
    comparison: MeasuredComparison

    def row(self) -> dict[str, Any]:
        """Return the coordinates, number of runs and of data, and the sum of squares."""
        found = self.comparison
        return {
            **self.coordinates,
            "runs": len(found.runs),
            "data": len(found.data),
            "chi_squared": found.chi_squared,
        }


def compare_points(
    study: Study,
    source: Any,
    *,
    columns: str | Mapping[str, str] | None = None,
    where: str | None = None,
    **how: Any,
) -> list[PointComparison]:
    """Return the points of a study that have data, the one nearest to them first.

    All runs of a point that are done are compared together; nearest is the smallest χ² a datum.
    Parameters are those of :meth:`multicell.Result.compare_with`.

    Raises OutputError without a run that is done, DataError where no point has data.
    """
    table = read_measurements(source, columns, where)
    groups: dict[tuple[Any, ...], list[StudyRun]] = {}
    for run, state in zip(study.runs, study.status(), strict=True):
        if state.state == "done":
            place = tuple((k, v) for k, v in run.coordinates.items() if k != "seed")
            groups.setdefault(place, []).append(run)
    found, refused = [], None
    for place, runs in groups.items():
        try:
            histories = [read_finished(run.name, study.folder) for run in runs]
        except FAILURES:
            continue  # the study's own table names runs that cannot be read
        try:
            one = compare_runs(runs[0].scene, histories, table, **how)
        except DataError as error:
            refused = error
            continue
        found.append(PointComparison(dict(place), replace(one, draw=compared)))
    if not found and refused is not None:
        raise refused
    if not found:
        raise OutputError("the study has no run that is done: there is nothing to compare")
    return sorted(found, key=lambda one: one.comparison.chi_squared / len(one.comparison.data))
