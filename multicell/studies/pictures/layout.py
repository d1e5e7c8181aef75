"""Figures of panels below a heading, which the pictures of studies share."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from multicell.report.plots.style import DPI, SIZE, blank


def with_heading(title: str, subtitle: str, size: tuple[float, float]) -> Figure:
    """Return a figure whose panels find their own margins below a heading."""
    figure = blank(title, subtitle, size)
    figure.set_layout_engine(
        "constrained", rect=(0.03, 0.05, 0.94, 1.0 - 0.85 / size[1] - 0.05), w_pad=0.13, h_pad=0.08
    )
    figure.set_dpi(DPI)
    return figure


def panels(
    title: str, subtitle: str, count: int, columns: int, height: float, **shared: Any
) -> tuple[Figure, list[Axes]]:
    """Return a figure with so many panels in rows of so many columns; the rest of a row is empty.

    - ``title``, ``subtitle``: of the figure
    - ``count``, ``columns``: panels in all, and in a row
    - ``height``: of the figure, inches
    - ``**shared``: as ``Figure.subplots`` takes them: ``sharex``, ``sharey``
    """
    figure = with_heading(title, subtitle, (SIZE[0], height))
    grid = figure.subplots(-(-count // columns), columns, squeeze=False, **shared).ravel().tolist()
    for axes in grid[count:]:
        axes.set_axis_off()
    return figure, grid[:count]


def write_plainly(axis: Any, text: Callable[[float], str] = "{:,.7g}".format) -> None:
    """Write the numbers of an axis with commas and without powers of ten, or as another text."""
    axis.set_minor_formatter(NullFormatter())
    axis.set_major_formatter(FuncFormatter(lambda value, _: text(value)))


def spread(count: int, most: int) -> list[int]:
    """Return at most so many places of ``count``, evenly, the first and last among them."""
    return sorted({round(place) for place in np.linspace(0, count - 1, min(count, most))})
