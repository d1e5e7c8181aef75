"""Places of a picture that have a name: where the points of named series are drawn."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from matplotlib.collections import Collection
from matplotlib.lines import Line2D

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NAMED: Final = "series: "
"""Beginning of the `gid` of a line or scatter whose points have a name; the rest is the name."""

_RADIUS = 0.065  # inches: a little more than a marker


class Mark(NamedTuple):
    """An ellipse in a picture and its name.

    Centre from the left and from the top, and half axes, in parts of the picture's width and
    height.
    """

    x: float
    y: float
    wide: float
    high: float
    name: str


def marks(figure: Figure) -> list[Mark]:
    """Return where a figure shows the points of its named series; hidden ones are left out.

    What was drawn later comes later, so that in a page it lies above.
    """
    wide, high = (_RADIUS / size for size in figure.get_size_inches())
    return [
        Mark(x, 1.0 - y, wide, high, name)
        for axes in figure.axes
        for drawn in sorted(_drawn(axes), key=lambda one: one.get_zorder())
        if (name := _name(drawn))
        for x, y in _places(figure, axes, drawn)
    ]


def _drawn(axes: Axes) -> list[Line2D | Collection]:
    return [*axes.lines, *axes.collections]


def _name(drawn: Line2D | Collection) -> str:
    gid = drawn.get_gid() or ""
    return gid[len(NAMED) :] if gid.startswith(NAMED) else ""


def _places(figure: Figure, axes: Axes, drawn: Line2D | Collection) -> list[tuple[float, float]]:
    """Return the points within the axes, in parts of the figure's width and height."""
    data = drawn.get_xydata() if isinstance(drawn, Line2D) else drawn.get_offsets()
    pixels = axes.transData.transform(np.asarray(data, dtype=float))
    inside = axes.bbox.padded(1.0)
    places = figure.transFigure.inverted().transform(pixels[np.isfinite(pixels).all(axis=1)])
    shown = [inside.contains(x, y) for x, y in figure.transFigure.transform(places)]
    return [(float(x), float(y)) for (x, y), seen in zip(places, shown, strict=True) if seen]
