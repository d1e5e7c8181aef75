"""Where most cells are necrotic, smoothed to what single cells can tell."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from multicell.cells import FloatArray, State
from multicell.report.plots.style import RED

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from multicell.cells import Cells

_WIDTH: Final = 1.5  # mean radii, the standard deviation: a bell about two diameters wide
_FINE: Final = 4  # points of the grid to a smoothing length
_MAX_POINTS: Final = 2000  # points along a side
_MIN_DENSITY: Final = 1e-9  # of the largest density, below which there is no tissue
STYLE: Final = "--"
LABEL: Final = "most cells are necrotic"


def necrotic_share(
    cells: Cells, place: FloatArray, level: float
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Return which part of the nearby cells is necrotic, on a grid over a plane.

    "Nearby" is a Gaussian in space whose standard deviation is 1.5 mean radii of the cells: a
    line through this field says where the core ends as far as cells can tell. An isoline of the
    nutrient cannot: dead cells take up nothing, so that the concentration in the core levels off
    close to the threshold itself.

    - ``cells``: radii and states
    - ``place``, (n, 3) µm: positions in the axes of the picture
    - ``level``: height of the plane on the third axis, µm

    Returns x, (nx,), y, (ny,) µm; share, (ny, nx): 0 to 1, NaN away from cells; None if no cell
    is necrotic.
    """
    from scipy.ndimage import gaussian_filter

    dead = cells.state == State.NECROTIC
    if not dead.any():
        return None
    width = _WIDTH * float(cells.radius.mean())
    low, high = place[:, :2].min(axis=0) - 2.0 * width, place[:, :2].max(axis=0) + 2.0 * width
    step = max(width / _FINE, float((high - low).max()) / _MAX_POINTS)
    edges = [np.arange(a, b + step, step) for a, b in zip(low, high, strict=True)]
    weight = np.exp(-0.5 * ((place[:, 2] - level) / width) ** 2)
    smooth: Any = partial(gaussian_filter, sigma=width / step, mode="constant", truncate=8.0)
    flat = place[:, 0], place[:, 1], edges
    whole, part = (smooth(np.histogram2d(*flat, weights=w)[0]) for w in (weight, weight * dead))
    known = whole > _MIN_DENSITY * whole.max()
    share = np.divide(part, whole, out=np.full_like(whole, np.nan), where=known)
    x, y = (0.5 * (edge[1:] + edge[:-1]) for edge in edges)
    return x, y, share.T


def draw_necrotic(axes: Axes, cells: Cells, place: FloatArray, level: float) -> bool:
    """Draw a line round where most cells are necrotic, and return whether there is such a place."""
    found = necrotic_share(cells, place, level)
    if found is None or not np.nanmax(found[2]) > 0.5:
        return False
    x, y, share = found
    filled = np.nan_to_num(share)
    axes.contour(x, y, filled, levels=[0.5], colors="white", linewidths=3.6, zorder=3)
    axes.contour(x, y, filled, levels=[0.5], colors=RED, linewidths=1.8, linestyles=STYLE, zorder=3)
    return True
