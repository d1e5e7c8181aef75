"""The pictures of a study: ``study.plot.heatmap("viable_rim")``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, final

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure


@final
class StudyPlots:
    """The pictures of one study, drawn from its table; each is a matplotlib ``Figure``.

    Every observable is a name of the table; axes are named as its dimensions (the coordinates of
    ``point`` where the design is sampled). The scatter over seeds is always part of a picture;
    where there is one seed it says so, and runs that failed or are missing are shown as such.

    Parameters
    ----------
    table
        Of the study, as ``study.to_xarray()``.
    title
        Of the pictures.
    """

    def __init__(self, table: xr.Dataset, title: str) -> None:
        self._table, self._title = table, title

    def heatmap(
        self,
        observable: str,
        x: str | None = None,
        y: str | None = None,
        at: Mapping[str, Any] | None = None,
    ) -> Figure:
        """Draw mean ± standard deviation of an observable over two axes (a third makes panels).

        See :func:`multicell.studies.pictures.heatmap.heatmap`.
        """
        from multicell.studies.pictures.heatmap import heatmap

        return heatmap(self._table, self._title, observable, x, y, at)

    def curves(
        self,
        observable: str,
        axes: Sequence[str] | None = None,
        at: Mapping[str, Any] | None = None,
    ) -> Figure:
        """Draw an observable over time with bands over the seeds, one panel for each axis.

        See :func:`multicell.studies.pictures.curves.curves`.
        """
        from multicell.studies.pictures.curves import curves

        return curves(self._table, self._title, observable, axes, at)

    def response(self, observable: str) -> Figure:
        """Draw an observable at the end of the runs over each axis: points, means and bars.

        See :func:`multicell.studies.pictures.response.response`.
        """
        from multicell.studies.pictures.response import response

        return response(self._table, self._title, observable)
