"""The result of a run, and of a run's folder that is opened later."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final, overload

import numpy as np
from numpy.typing import NDArray

from multicell.errors import FrameError, OutputError, SceneError
from multicell.report.wording import cell_count, measures, time_unit
from multicell.results.frame import Frame, Named
from multicell.results.history import History
from multicell.scene.bare import note_bare
from multicell.units import shown, to_base

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame
    from xarray import Dataset

    from multicell.cells import FloatArray
    from multicell.measured.compared import MeasuredComparison
    from multicell.report.citation import Citation
    from multicell.report.plots.run import Plots
    from multicell.results.reader import Contents
    from multicell.scene.scene import Scene

_MOST_VIEW: Final = 8_000_000
"""Characters above which the view is left to the report: notebooks keep all that they show."""


@final
class DrawnFrames(Sequence["Frame"]):
    """The frames of a result, each with :meth:`~multicell.results.frame.Frame.plot`."""

    def __init__(
        self, frames: Sequence[Frame], scene: Scene, lineage: Mapping[str, NDArray[Any]]
    ) -> None:
        self._frames, self._scene, self._lineage = frames, scene, lineage

    @property
    def times(self) -> FloatArray:
        """Simulated time of every frame: (k,), s; frames on disk are not read for it."""
        known = getattr(self._frames, "times", None)
        return np.array([f.time for f in self._frames] if known is None else known, dtype=float)

    def __len__(self) -> int:
        return len(self._frames)

    @overload
    def __getitem__(self, place: int) -> Frame: ...
    @overload
    def __getitem__(self, place: slice) -> Sequence[Frame]: ...
    def __getitem__(self, place: int | slice) -> Frame | Sequence[Frame]:
        if isinstance(place, slice):
            return DrawnFrames(self._frames[place], self._scene, self._lineage)
        count = len(self)
        if not hasattr(place, "__index__"):
            problem = f"frames have numbers, not {shown(place)}"
            raise FrameError(problem, "frames[0] is the first, frames[-1] the last.")
        if not -count <= place < count:
            have = f"the frames 0 to {count - 1}" if count else "no frames"
            raise FrameError(f"there is no frame {place}: the run has {have}")
        return replace(self._frames[place], draw=partial(_draw, self._scene, self._lineage))

    def __repr__(self) -> str:
        return f"<{len(self)} frames>"


def _draw(
    scene: Scene, lineage: Mapping[str, NDArray[Any]], frame: Frame, **options: Any
) -> Figure:
    from multicell.report.plots.run import Plots

    return Plots([frame], {}, scene, lineage).section(**options)


@final
@dataclass(frozen=True, eq=False)
class Result:
    """Frames, history and summary of a run.

    Attributes
    ----------
    folder
        Where the run was written, or None if it is only in memory.
    frames
        The saved frames; read from disk one at a time when there is a folder.
    history : column name -> (m,) float64
        One entry per coupling step; columns and units as in
        :mod:`multicell.results.measures`.
    summary_dict
        The summary, as in ``summary.json``.
    scene
        The scene that was run.
    lineage : column -> (k,) array
        One row for every cell that ever was; see :meth:`multicell.results.lineage.Lineage.table`.
    """

    folder: Path | None
    frames: Sequence[Frame]
    history: Mapping[str, NDArray[np.float64]]
    summary_dict: Mapping[str, Any]
    scene: Scene
    lineage: Mapping[str, NDArray[Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "history", History(self.history))
        object.__setattr__(self, "frames", DrawnFrames(self.frames, self.scene, self.lineage))

    def __repr__(self) -> str:
        words = [repr(self.scene.title or "untitled"), f"{len(self.frames)} frames"]
        try:
            last = self.frames[-1] if len(self.frames) else None
        except OutputError as trouble:  # another run is there now: who prints a result asks no more
            return f"<Result {words[0]}: {trouble}>"
        if last is not None:
            words += [time_unit(last.time).text(last.time), cell_count(len(last.cells))]
        place = "in memory" if self.folder is None else f"in '{self.folder}'"
        return f"<Result {', '.join(words)}, {place}>"

    def _repr_html_(self) -> str:
        """Return a notebook's display: key figures, a section, and the view in space and time."""
        from multicell.report.html import rendered
        from multicell.report.plots.style import inline_picture

        context: dict[str, Any] = {"caption": "", "picture": None, "view": None}
        if len(self.frames) and len(self.frames[-1].cells):
            from multicell.report.plots.run import PICTURES
            from multicell.report.viewer.pack import view_page

            context["caption"] = PICTURES["section"].caption
            context["picture"] = inline_picture(self.plot.section())
            page = view_page(self)
            context["view"] = None if page is None or len(page) > _MOST_VIEW else page
        title = self.scene.title or "Untitled run"
        return rendered(
            "notebook.html", title=title, tiles=dict(measures(self.summary())), **context
        )

    def at(self, time: float | str) -> Frame:
        """Return the frame nearest to a time.

        Parameters
        ----------
        time
            In s, or with a unit: ``"10 d"``.

        Raises
        ------
        OutputError
            If the run has no frames then.
        SceneError
            If it is no time.
        """
        return self.frames[self.number_at(time)]

    def number_at(self, time: float | str, path: str = "time") -> int:
        """Return the number of the frame nearest to a time; an error names it ``path``."""
        assert isinstance(self.frames, DrawnFrames)
        note_bare(path, time, "s")
        wanted, times = to_base(time, "s", path), self.frames.times
        if not len(times):
            raise OutputError("the run has no frames")
        unit = time_unit(times[-1])
        if not times[0] <= wanted <= times[-1]:
            first, last = (unit.text(end) for end in (times[0], times[-1]))
            asked = time if isinstance(time, str) else unit.text(wanted)
            raise OutputError(f"the run has no frame at {asked}: it goes from {first} to {last}")
        return int(np.argmin(np.abs(times - wanted)))

    def summary(self) -> dict[str, Any]:
        """Return a copy of the summary."""
        return Named(copy.deepcopy(dict(self.summary_dict)), "entry of the summary")

    @property
    def plot(self) -> Plots:
        """Pictures of the run, such as ``plot.growth()`` or ``plot.section()``."""
        from multicell.report.plots.run import Plots  # matplotlib is loaded for pictures only

        return Plots(self.frames, self.history, self.scene, self.lineage)

    def to_xarray(self) -> Dataset:
        """Return the history as a data set along ``time``, with units and the scene.

        Raises
        ------
        MissingPackage
            If xarray is not installed.
        """
        from multicell.results.tables import history_dataset

        return history_dataset(self.history, self.scene.to_toml())

    def to_pandas(self, table: str = "history") -> DataFrame:
        """Return a table of the run, its columns titled with their units as in CSV files.

        Parameters
        ----------
        table
            ``"history"``, ``"lineage"``, or ``"cells"`` and ``"contacts"`` of all frames.

        Raises
        ------
        MissingPackage
            If pandas is not installed.
        OutputError
            If there is no such table.
        """
        from multicell.report.tables import whole_table

        return whole_table(self, table)

    def compare_with(
        self,
        table: Any,
        *,
        columns: str | Mapping[str, str] | None = None,
        where: str | None = None,
        sd: float | None = None,
        specimens: str = "same",
    ) -> MeasuredComparison:
        """Compare the run with measured data, of all observables that both have.

        Parameters
        ----------
        table
            Path of a table (CSV, Excel), a ``DataFrame`` or columns by title, as :func:`fit` takes
            it.
        columns
            What its columns are, ``"day=Day, radius=R um"``; absent: what their titles say.
        where
            Which rows are meant, ``"CellLine=983b, Day=3..7"``.
        sd
            Relative standard deviation of data that come without one, by default 0.1.
        specimens
            ``"single"``: each row is another specimen, measured once.

        Returns
        -------
        MeasuredComparison
            With ``residuals``, ``chi_squared``, ``to_pandas()`` and ``plot()``.

        Raises
        ------
        DataError
            For a table that cannot be used, or that has nothing that the run has.
        """
        from multicell.measured.compared import compare_runs
        from multicell.report.plots.compared import compared

        if not len(self.history.get("time", ())):
            raise OutputError("the run has no history yet: there is nothing to compare")
        found = compare_runs(
            self.scene,
            [(self.history, self.summary())],
            table,
            columns=columns,
            where=where,
            sd=sd,
            specimens=specimens,
        )
        return replace(found, draw=compared)

    def cite(self) -> Citation:
        """Return a methods section of this run for a paper: ``text``, and ``bibtex``."""
        from multicell.report.citation import cite

        return cite(self)

    def report(
        self, folder: str | Path | None = None, *, comparison: MeasuredComparison | None = None
    ) -> Path:
        """Write ``report.html`` and its pictures, and return the path of the report.

        Parameters
        ----------
        folder
            Where to write, by default the folder of the run.
        comparison
            With measured data, to show with the run.

        Raises
        ------
        OutputError
            If the run has no folder and none is given, or it cannot be written to.
        """
        from multicell.report.page import write_report

        return write_report(self, folder, comparison)


def history_columns(rows: Iterable[Mapping[str, float]]) -> dict[str, NDArray[np.float64]]:
    """Return rows of a history as one array per column."""
    rows = list(rows)
    if any(set(row) != set(rows[0]) for row in rows):
        raise ValueError("rows of a history must have the same columns")
    return {name: np.array([row[name] for row in rows], float) for name in rows[0]} if rows else {}


def load_result(folder: str | Path) -> Result:
    """Open the folder of a finished, interrupted or killed run.

    A killed run leaves no ``summary.json``: its summary is then taken from the last frame and
    marked ``"interrupted": true``.

    Parameters
    ----------
    folder
        Of the run.

    Raises
    ------
    OutputError
        If the folder holds no results, or results that cannot be read or are not what was
        written. A frame is checked when it is read, and raises this error then.
    SceneError
        If its ``scene.toml`` cannot be read.
    """
    from multicell.results.reader import Contents, Frames
    from multicell.results.summary import read_summary

    contents = Contents(folder)
    contents.whole()
    frames = Frames(contents)
    summary = read_summary(contents)
    scene = recorded_scene(contents)
    return Result(
        folder=contents.folder,
        frames=frames,
        history=contents.history(),
        summary_dict=_partial_summary(frames, scene) if summary is None else summary,
        scene=scene,
        lineage=contents.lineage(len(frames) - 1).table() if len(frames) else {},
    )


def recorded_scene(contents: Contents) -> Scene:
    """Return the scene of a result folder."""
    from multicell.scene.scene import load_scene

    path = contents.folder / "scene.toml"
    run = scene_of_text(contents.scene, path)
    if path.exists() and not path.is_file():
        raise OutputError(f"'{path}' is no file")  # to read a pipe would wait for ever
    texts = (path, path.with_name("scene.toml.next"))
    # remarks may change; numbers may not
    if not any(same_text(text, contents.scene) for text in texts) and load_scene(path) != run:
        raise OutputError(
            f"'{path}' is not the scene that was run, so the frames beside it do not belong to it. "
            "To go on with changes use 'multicell resume --set'"
        )
    if sorted(run.nutrients) != sorted(contents.nutrients):
        raise OutputError(
            f"the frames in '{contents.folder}' have fields of {sorted(contents.nutrients)}, the "
            f"scene has {sorted(run.nutrients)}"
        )
    return run


def scene_of_text(text: str, path: Path) -> Scene:
    """Return the scene that frames are of, whose ``scene.toml`` is at ``path``."""
    from multicell.host.files import OTHER_FILE, parse_toml
    from multicell.scene.own_files import COPIED_FIELD, COPIED_NETWORK, place_files
    from multicell.scene.scene import Scene

    try:
        return Scene.from_dict(place_files(parse_toml(text), path))
    except SceneError as error:
        copied = f"{COPIED_NETWORK}.", f"{COPIED_FIELD}."
        if not (error.path.endswith(".file") and any(x in error.problem for x in copied)):
            raise
        damaged = any(words in error.problem for words in (OTHER_FILE, "UTF-8"))
        problem = f"{error.path}: {error.problem}"
        raise OutputError(problem, damaged=damaged) from error
    except ValueError as error:
        raise OutputError(f"the scene in '{path.parent}' is damaged: {error}") from error


def same_text(path: Path, text: str) -> bool:
    """Return whether a file holds a text, without reading one of another length."""
    data = text.encode()
    try:
        return path.is_file() and path.stat().st_size == len(data) and path.read_bytes() == data
    except OSError:
        return False  # whoever needs the file will say what is wrong with it


def _partial_summary(frames: Sequence[Frame], scene: Scene) -> dict[str, Any]:
    from multicell.results.quantities import units_of
    from multicell.results.summary import state_summary

    summary: dict[str, Any] = {}
    for last in frames[-1:]:
        summary = {**state_summary(scene, last, own=False), "steps": last.step}
    return {"interrupted": True, **summary, "units": units_of(summary)}
