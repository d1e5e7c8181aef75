"""A study in its folder: what Python and the command line work with.

>>> import multicell as mc
>>> study = mc.study("growth", vary={"cells.young": "1,2 kPa"}, seeds=3, output="study")
... # doctest: +SKIP
>>> study.run(); table = study.to_xarray(); study.plot.heatmap("diameter")      # doctest: +SKIP
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

from multicell.errors import OutputError
from multicell.results.folder import (
    copy_of,
    file_errors,
    is_begun,
    make_folder,
    with_copy,
    write_text,
)
from multicell.scene.scene import Scene, load_scene
from multicell.studies.cost import StudyCost, costs_of, total_cost
from multicell.studies.plan import PLAN_FILE, SCENE, Plan, make_plan, read_plan, scene_with_end
from multicell.studies.runs import StudyRun, canonical, run_digest

if TYPE_CHECKING:
    import pandas
    import xarray

    from multicell.studies.compared import PointComparison
    from multicell.studies.engine import RunOutcome
    from multicell.studies.pictures import StudyPlots
    from multicell.studies.status import RunStatus


@final
class Study:
    """A plan and the folder that holds its runs; made by :func:`study` or :func:`load_study`.

    Attributes
    ----------
    plan
        What is varied, and how.
    folder
        With ``study.toml``, ``scene.toml``, and the runs as ``runs/<name>``.
    """

    def __init__(self, plan: Plan, folder: str | Path) -> None:
        self.plan = plan
        self.folder = Path(folder)
        self._read: tuple[Sequence[RunStatus], xarray.Dataset] | None = None

    def __repr__(self) -> str:
        return f"Study('{self.folder}', {len(self.plan.points)} points, {self.plan.seeds} seeds)"

    @cached_property
    def runs(self) -> list[StudyRun]:
        """All runs: those of one point after the other, each with all its seeds."""
        return self.plan.runs([cost.seconds for cost in costs_of(self.plan, self.folder)])

    def expected(self, cores: int = 1) -> StudyCost:
        """Return the expected cost of the runs that are not done and have not failed.

        Parameters
        ----------
        cores
            How many there are.
        """
        points = costs_of(self.plan, self.folder)
        costs = (cost for cost in points for _ in range(self.plan.seeds))
        runs = zip(costs, self.status(), strict=True)
        left = (cost for cost, run in runs if run.state not in ("done", "failed"))
        return total_cost(left, cores)

    def run(
        self,
        cores: int | None = None,
        scheduler: str | None = None,
        progress: Callable[[RunOutcome], None] | None = None,
        *,
        retry: bool = False,
    ) -> list[RunOutcome]:
        """Do all runs that are not done, and continue those that were begun.

        It may be stopped by anything and called again; see
        :func:`multicell.studies.engine.run_study` for the arguments, and for what is raised.

        Returns
        -------
        list of Outcome
            In the order of :attr:`runs`. A run that failed is one of them, with its reason.
        """
        from multicell.studies.engine import run_study

        return run_study(
            self.runs, self.folder, cores=cores, scheduler=scheduler, progress=progress, retry=retry
        )

    def status(self) -> list[RunStatus]:
        """Return the state of each run, in the order of :attr:`runs`."""
        from multicell.studies.status import run_status

        return [run_status(name, self.folder) for name in self.plan.names]

    def others(self) -> list[str]:
        """Return the folders in ``runs`` that belong to no point: of another plan, or set aside."""
        place, known = self.folder / "runs", set(self.plan.names)
        with file_errors("read", place):
            found = sorted(entry.name for entry in place.iterdir()) if place.is_dir() else []
        return [name for name in found if name not in known]

    def to_xarray(self) -> xarray.Dataset:
        """Return one table of all that the runs have found; it is written to ``study.nc``, too.

        See :mod:`multicell.studies.table`. This object reads runs again only where one of them has
        changed.

        Raises
        ------
        MissingPackage
            Without the packages of ``multicell[study]``.
        OutputError
            If results cannot be read.
        """
        return self._table(self.status())

    def _table(self, states: Sequence[RunStatus]) -> xarray.Dataset:
        from multicell.studies import table

        if self._read is None or self._read[0] != states:
            made = table.dataset(self.plan, self.folder, states)
            table.save_dataset(made, self.folder / table.TABLE_FILE)
            if table.states_of(made, states) != list(states):
                return made  # what cannot be read now may be another time
            self._read = states, made
        return self._read[1].copy()

    def to_pandas(self) -> pandas.DataFrame:
        """Return the table with one row for each run and time; units are in ``frame.attrs``."""
        table = self.to_xarray()
        frame = table.to_dataframe().reset_index()
        frame.attrs = {
            str(n): v.attrs["units"] for n, v in table.variables.items() if v.attrs.get("units")
        }
        return frame

    def compare_with(self, table: Any, **how: Any) -> list[PointComparison]:
        """Compare the points of the study with measured data, the nearest one first.

        Parameters
        ----------
        table, **how
            As of :meth:`multicell.Result.compare_with`. Rows with conditions, such as
            ``nutrients.oxygen.boundary / mM``, belong to the points that have them.

        Returns
        -------
        list of PointComparison
            Of all points that have data and a run that is done.
        """
        from multicell.studies.compared import compare_points

        return compare_points(self, table, **how)

    def report(self, points: list[PointComparison] | None = None) -> Path:
        """Write ``report.html`` with its pictures, and the table as ``study.nc`` and ``study.csv``.

        Parameters
        ----------
        points
            With measured data (:meth:`compare_with`), to show with the study.

        Returns
        -------
        pathlib.Path
            The page.
        """
        from multicell.studies.page import write_study_report

        table, states = self.write_tables()
        return write_study_report(
            self.folder, self.plan.scene, table, self.runs, states, points=points or ()
        )

    def write_tables(self) -> tuple[xarray.Dataset, list[RunStatus]]:
        """Write the table as ``study.nc`` and ``study.csv``.

        Returns
        -------
        xarray.Dataset, list of RunStatus
            The table, and the states of the runs in it.
        """
        from multicell.studies.table import states_of, write_study_csv

        states = self.status()
        table = self._table(states)
        write_study_csv(table, self.folder / "study.csv")
        return table, states_of(table, states)

    @property
    def plot(self) -> StudyPlots:
        """Pictures of the study, such as ``plot.heatmap("viable_rim")``."""
        from multicell.studies.pictures import StudyPlots

        return StudyPlots(self.to_xarray(), self.plan.scene.title or "Study")


def study(
    scene: Scene | str | Path,
    vary: Mapping[str, Any] | None = None,
    *,
    output: str | Path,
    points: Any = None,
    seeds: int = 1,
    overwrite: bool = False,
) -> Study:
    """Plan a study of a scene in a folder; nothing runs until :meth:`Study.run` is called.

    A folder that holds the same study, or one that the new plan widens (further values, seeds or
    keys), is continued: runs that are there are not computed again.

    Parameters
    ----------
    scene
        A scene, the name of a built-in one, or the path of a file.
    vary
        Dotted key -> values, as ``"0.07,0.14,0.28 mM"`` or a list; all combinations run.
    output
        Folder of the study.
    points
        In place of ``vary``: a list of points, as a table of columns (a ``DataFrame``, too) or its
        rows. The values of keys that vary together stand in one row.
    seeds
        Runs of each point, with the scene's seed and those that follow it; the same at all points.
    overwrite
        Whether the plan of another study in the folder may be replaced. Its runs stay: they are
        named by what they are of, and never mistaken for others.

    Returns
    -------
    Study

    Raises
    ------
    SceneError
        For anything in the plan that cannot be, before anything runs: see
        :class:`multicell.studies.plan.Plan`.
    OutputError
        If the folder holds another study, or something else, or cannot be written to.
    """
    base = scene if isinstance(scene, Scene) else load_scene(scene)
    plan = make_plan(base, vary, points=points, seeds=seeds)
    return write_study(plan, output, overwrite=overwrite)


def load_study(folder: str | Path) -> Study:
    """Open the folder of a study.

    Parameters
    ----------
    folder
        With ``study.toml``.

    Raises
    ------
    SceneError
        If there is no study, or its plan is refused.
    """
    return Study(read_plan(folder), folder)


def write_study(plan: Plan, folder: str | Path, *, overwrite: bool = False) -> Study:
    """Write a plan to a folder, and return the study."""
    folder = Path(folder)
    there = (folder / PLAN_FILE).is_file()
    if there and not overwrite:
        _refuse_other(plan, read_plan(folder), folder)
    elif not there:
        scene, content = copy_of(plan.scene, folder)
        first: dict[str, bytes | str] = {
            **content,
            SCENE: scene_with_end(scene, folder),
            PLAN_FILE: "",
        }
        make_folder(folder, overwrite=overwrite or is_begun(folder, first))
    if (copied := with_copy(plan.scene, folder)) is not plan.scene:
        plan = replace(plan, scene=copied)
    write_text(folder / SCENE, scene_with_end(plan.scene, folder))
    write_text(folder / PLAN_FILE, plan.to_toml())
    return Study(plan, folder)


def _refuse_other(plan: Plan, there: Plan, folder: Path) -> None:
    """Refuse a plan that does not widen the one in a folder."""
    way_out = (
        "Choose another folder, or allow overwriting (--overwrite, overwrite=True): runs that are "
        "there stay, and are taken where they fit"
    )
    if run_digest(there.scene) != run_digest(plan.scene):
        old, new = canonical(there.scene), canonical(plan.scene)
        keys = ", ".join(key for key in {**old, **new} if old.get(key) != new.get(key))
        raise OutputError(
            f"'{folder}' holds a study of another scene: it differs in {keys}. {way_out}"
        )
    missing = set(there.names) - set(plan.names)
    if missing:
        raise OutputError(
            f"'{folder}' holds a study of {len(set(there.names))} runs, of which {len(missing)} "
            f"are not in this one: it would not be widened, but changed. {way_out}"
        )
