"""By how much a cell lowers the concentration at its own place, on a grid.

A cell is a point that takes up u, and around a point the concentration falls like u/(4 pi D r).
On a grid that ends at about the spacing h: the cell finds its own dip of g u/(D h), where g is a
value of the Green's function of the lattice, weighted as the cell's uptake is spread and read.
Cubes of 0.5 to 1.3 diameters give what a ball of the cell's radius a finds of its own, which is
0.095 u/(D a) (uniform uptake, mean concentration); finer ones give more and more.
That is no error of the field in which the cell lies, and so estimates of errors leave it out.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from multicell.cells import FloatArray
from multicell.nutrient.grid import BoxLayout, Layout, ShellLayout

_CUBES: Final = (0.2527310098586630, 0.0860643431919963, 0.0551914336877, 0.0435783543977)
"""Green's function of the simple cubic lattice at the offsets 000, 100, 110 and 111 (Watson's
integrals): 6 g(x) - sum of g over the neighbours of x is one at 000."""

_SQUARES: Final = (0.0, -0.25, -1.0 / np.pi)
"""Minus the potential kernel of the square lattice at the offsets 00, 10 and 11."""

_INNERMOST: Final = 0.6
"""Spacings from the centre within which shells know no smaller distance: 6/pi²."""


def own_dip(
    layout: Layout, position: FloatArray, taken: FloatArray, diffusion: float
) -> FloatArray:
    """Return by how much each cell lowers what it finds by its own uptake, (n,) mM.

    In a plane up to a constant that is the same for all grids.

    - ``layout``: where the field lives
    - ``position``, (n, 3), µm
    - ``taken``, (n,), amol/s: what each cell takes up less what it secretes
    - ``diffusion``, float, µm²/s
    """
    position = layout.nearest(position)
    if isinstance(layout, ShellLayout):
        distance = np.sqrt(np.square(position - layout.centre).sum(axis=1))
        reach = np.maximum(distance, _INNERMOST * layout.spacing)
        beyond = 1.0 / reach - 1.0 / max(layout.radius, layout.spacing)
        return np.asarray(taken * beyond / (4.0 * np.pi * diffusion))
    assert isinstance(layout, BoxLayout)
    box = layout.box
    if box.height is None:
        share = _share(position, box.origin, box.spacing, _CUBES)
        return np.asarray(taken * share / (diffusion * box.spacing))
    share = _share(position, box.origin, box.spacing, _SQUARES)
    share -= np.log(box.spacing) / (2.0 * np.pi)
    return np.asarray(taken * share / (diffusion * box.height))


def _share(
    position: FloatArray, origin: tuple[float, float, float], spacing: float,
    green: tuple[float, ...],
) -> FloatArray:  # fmt: skip
    """Return the sum of w_i w_j g(i - j) over the nodes i and j around each cell, (n,).

    Along an axis two nodes of weights 1 - w and w are the same with the probability
    (1 - w)² + w², else neighbours.
    """
    axes = len(green) - 1
    u = (position[:, :axes] - np.array(origin[:axes])) / spacing - 0.5
    w = u - np.floor(u)
    apart = 2.0 * w * (1.0 - w)
    number = np.zeros((len(position), axes + 1))  # probability of so many axes along which apart
    number[:, 0] = 1.0
    for axis in range(axes):
        p = apart[:, axis : axis + 1]
        moved = np.concatenate([np.zeros((len(position), 1)), number[:, :-1]], axis=1)
        number = (1.0 - p) * number + p * moved
    return np.asarray(number @ np.array(green))
