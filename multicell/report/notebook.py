"""What a notebook shows of a run, and frames that can be drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, Final, final, overload

import numpy as np
from numpy.typing import NDArray

from multicell.report.wording import cell_count, measures, time_unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from multicell.cells import FloatArray
    from multicell.report.result import Result
    from multicell.results.frame import Frame
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
        return replace(self._frames[place], draw=partial(_draw, self._scene, self._lineage))

    def __repr__(self) -> str:
        return f"<{len(self)} frames>"


def _draw(
    scene: Scene, lineage: Mapping[str, NDArray[Any]], frame: Frame, **options: Any
) -> Figure:
    from multicell.report.plots.run import Plots

    return Plots([frame], {}, scene, lineage).section(**options)


def line(result: Result) -> str:
    """Return a run in a line."""
    words = [repr(result.scene.title or "untitled"), f"{len(result.frames)} frames"]
    if len(result.frames):
        last = result.frames[-1]
        words += [time_unit(last.time).text(last.time), cell_count(len(last.cells))]
    place = "in memory" if result.folder is None else f"in '{result.folder}'"
    return f"<Result {', '.join(words)}, {place}>"


def shown(result: Result) -> str:
    """Return a run as HTML: key figures, a section, and the view of cells in space and time."""
    from multicell.report.html import rendered
    from multicell.report.plots.style import inline_picture

    context: dict[str, Any] = {"caption": "", "picture": None, "view": None}
    if len(result.frames) and len(result.frames[-1].cells):
        from multicell.report.plots.run import PICTURES
        from multicell.report.viewer.pack import view_page

        kind = PICTURES["section"]
        flat = result.scene.dimensions == 2
        context["caption"] = kind.flat_caption if flat else kind.caption
        context["picture"] = inline_picture(result.plot.section())
        page = view_page(result)
        context["view"] = None if page is None or len(page) > _MOST_VIEW else page
    title = result.scene.title or "Untitled run"
    return rendered("notebook.html", title=title, tiles=dict(measures(result.summary())), **context)
