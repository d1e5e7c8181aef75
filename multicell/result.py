"""What a run hands back, and what its folder can be opened as later."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import numpy as np
from numpy.typing import NDArray

from multicell.errors import OutputError
from multicell.frame import Frame

if TYPE_CHECKING:
    from multicell.plots import Plots
    from multicell.scene import Scene


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
        :func:`multicell.observables.history_row`.
    summary_dict
        The summary, as in ``summary.json``.
    scene
        The scene that was run.
    lineage : column -> (k,) array
        One row for every cell that ever was; see :meth:`multicell.lineage.Lineage.table`.
    """

    folder: Path | None
    frames: Sequence[Frame]
    history: Mapping[str, NDArray[np.float64]]
    summary_dict: Mapping[str, Any]
    scene: Scene
    lineage: Mapping[str, NDArray[Any]] = field(default_factory=dict)

    def summary(self) -> dict[str, Any]:
        """Return a copy of the summary."""
        return copy.deepcopy(dict(self.summary_dict))

    @property
    def plot(self) -> Plots:
        """Pictures of the run, such as ``plot.growth()`` or ``plot.section()``."""
        from multicell.plots import Plots  # matplotlib is loaded for pictures only

        return Plots(self.frames, self.history, self.scene)

    def report(self, folder: str | Path | None = None) -> Path:
        """Write ``report.html`` and its pictures, and return the path of the report.

        Parameters
        ----------
        folder
            Where to write, by default the folder of the run.

        Raises
        ------
        OutputError
            If the run has no folder and none is given, or it cannot be written to.
        """
        from multicell.report import write_report

        return write_report(self, folder)


def history_arrays(rows: Iterable[Mapping[str, float]]) -> dict[str, NDArray[np.float64]]:
    """Return rows of a history as one array per column.

    Raises
    ------
    ValueError
        If a row lacks a column of the first one, or has more.
    """
    rows = list(rows)
    if any(set(row) != set(rows[0]) for row in rows):
        raise ValueError("rows of a history must have the same columns")
    return {name: np.array([row[name] for row in rows], float) for name in rows[0]} if rows else {}


def load_result(folder: str | Path) -> Result:
    """Open the folder of a finished, interrupted or killed run.

    A killed run leaves no ``summary.json``: its summary is then taken from the last frame and
    marked ``"interrupted": true``.

    Raises
    ------
    OutputError
        If the folder holds no results, or results that cannot be read.
    SceneError
        If its ``scene.toml`` cannot be read.
    """
    from multicell.scene import load_scene
    from multicell.store import open_frames, open_history, open_lineage

    folder = Path(folder)
    frames = open_frames(folder)
    scene = load_scene(folder / "scene.toml")
    return Result(
        folder=folder,
        frames=frames,
        history=open_history(folder),
        summary_dict=_read_summary(folder / "summary.json", frames, scene),
        scene=scene,
        lineage=open_lineage(folder).table() if len(frames) else {},
    )


def _read_summary(path: Path, frames: Sequence[Frame], scene: Scene) -> dict[str, Any]:
    """Read the summary, or put one together from the last frame where there is none."""
    if not path.is_file():
        return _partial_summary(frames, scene)
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise OutputError(f"cannot read '{path}': {error}") from error
    if not isinstance(summary, dict):
        raise OutputError(f"cannot read '{path}': it does not hold a table")
    return summary


def _partial_summary(frames: Sequence[Frame], scene: Scene) -> dict[str, Any]:
    """Return what the last frame of a killed run tells."""
    from multicell.observables import state_summary
    from multicell.quantities import units_of

    summary: dict[str, Any] = {}
    if len(frames):
        last = frames[-1]
        summary |= state_summary(last.time, last.cells, scene.dimensions) | {"steps": last.step}
    return {"interrupted": True, **summary, "units": units_of(summary)}
