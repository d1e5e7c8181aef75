"""The pictures of a study: ``study.plot.heatmap("viable_rim")``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, final

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

_KEPT = ("point", "seed")


@final
class StudyPlots:
    """The pictures of one study, drawn from its table; each is a matplotlib ``Figure``.

    Every observable is a name of the table; axes are named as its dimensions (the coordinates of
    ``point`` where the design is sampled). The scatter over seeds is always part of a picture;
    where there is one seed it says so, and runs that failed or are missing are shown as such.

    - ``table``: of the study, as ``study.to_xarray()``
    - ``title``: of the pictures
    """

    def __init__(self, table: xr.Dataset, title: str) -> None:
        single = [n for n in table["state"].dims if table.sizes[n] == 1 and n not in _KEPT]
        self._table, self._title = table.squeeze(single, drop=True), title

    def heatmap(
        self,
        observable: str,
        x: str | None = None,
        y: str | None = None,
        at: Mapping[str, Any] | None = None,
    ) -> Figure:
        """Draw the mean of an observable over two axes, one tile for each pair of values.

        Each tile states mean and standard deviation over the seeds, and how many seeds there are
        where some failed or have not run. A third axis makes panels; further ones are fixed.

        - ``observable``: its values at the end of each run are shown
        - ``x``, ``y``: axes of the map, by default the first two; of a study of one axis the map
          has one row
        - ``at``: axis -> value for axes that are fixed, by default their middle value

        Raises SceneError for an unknown observable or axis; ValueError if the design is sampled or
        varies nothing: there are no tiles.
        """
        from multicell.studies.pictures import heatmap

        return heatmap(self._table, self._title, observable, x, y, at)

    def curves(self, observable: str, at: Mapping[str, Any] | None = None) -> Figure:
        """Draw an observable over time: the mean over the seeds, a band of one deviation each way.

        A panel for each axis, whose values have a colour each while the other axes are fixed. Where
        a run has no value, because it ended sooner than others of its point or the observable does
        not exist yet, those that have one are thin lines without mean and band.

        - ``observable``: one with a course
        - ``at``: axis -> value for axes that are fixed, by default their middle value; of a sample
          nothing is fixed

        Raises SceneError for an unknown observable or axis, or an observable that is a single
        number of each run.
        """
        from multicell.studies.pictures import curves

        return curves(self._table, self._title, observable, at)

    def response(self, observable: str) -> Figure:
        """Draw an observable at the end of each run over every axis, one panel for each.

        Dots are single runs. Each point of a sample, and each value of a single axis, has a bar of
        one standard deviation over its seeds; of several axes the line is the mean over all runs of
        a value. Runs that failed are crosses at the foot.

        Raises SceneError for an unknown observable; ValueError if nothing is varied.
        """
        from multicell.studies.pictures import response

        return response(self._table, self._title, observable)
