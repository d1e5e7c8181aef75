"""About the inverse of (shift - D ∇²) on a grid of py-pde's, for equations that say their D.

On Cartesian grids in any number of dimensions each axis is diagonalised by the transform that fits
its ends: a sine or cosine transform between values and slopes, Fourier's where it is periodic. A
mixed condition is taken as a slope. On balls of shells the tridiagonal system is solved.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, final

import numpy as np

from multicell.cells import FloatArray
from multicell.nutrient.dense import eigenvalues
from multicell.nutrient.diffusion import TRANSFORMS
from multicell.nutrient.spherical import Shells

if TYPE_CHECKING:
    from pde.grids.base import GridBase

Inverse = Callable[[FloatArray, float], FloatArray]
"""(r, shift in 1/s) -> (shift - D ∇²)⁻¹ r, for the array of one field."""


def inverse_on(grid: GridBase, diffusivity: float, bc: Any = None) -> Inverse | None:
    """Return the inverse for one field, or None where the grid is of another kind.

    Parameters
    ----------
    grid
        py-pde's.
    diffusivity
        In the grid's length² over time; zero leaves r / shift.
    bc
        Conditions as py-pde takes them; absent: slopes, and periodic where the grid is. They may
        be those of the equation up to their right-hand sides.
    """
    from pde.grids.cartesian import CartesianGrid
    from pde.grids.spherical import SphericalSymGrid

    if diffusivity == 0.0:
        return lambda r, shift: r / shift
    if isinstance(grid, CartesianGrid):
        return _Cartesian(grid, diffusivity, bc).solve
    if isinstance(grid, SphericalSymGrid) and grid.axes_bounds[0][0] == 0.0:
        ends = _ends(grid, bc)[0]
        side = {"value": 0.0} if ends[1] else {"derivative": 0.0}
        shells = Shells(float(grid.axes_bounds[0][1]), grid.shape[0], diffusivity, side)
        return lambda r, shift: shells.solve_linear(shift * shells.volumes, r * shells.volumes)
    return None


@final
class _Cartesian:
    """The transforms of a grid and the eigenvalues that belong to them."""

    def __init__(self, grid: GridBase, diffusivity: float, bc: Any) -> None:
        self._ends = _ends(grid, bc)
        self._periodic = tuple(i for i, periodic in enumerate(grid.periodic) if periodic)
        total = np.zeros(grid.shape)
        for axis, n in enumerate(grid.shape):
            stiffness = diffusivity / float(grid.discretization[axis]) ** 2
            if axis in self._periodic:
                along = 4.0 * np.sin(np.pi * np.arange(n) / n) ** 2
            else:
                along = eigenvalues(n, self._ends[axis])
            shape = [1] * grid.num_axes
            shape[axis] = n
            total = total + stiffness * along.reshape(shape)
        self._total = total

    def solve(self, r: FloatArray, shift: float) -> FloatArray:
        """Return (shift - D ∇²)⁻¹ r."""
        from scipy import fft

        y = self._real(np.array(r, dtype=float), "")
        if self._periodic:
            y = fft.fftn(y, axes=self._periodic)
        y = y / (self._total + shift)
        if self._periodic:
            y = fft.ifftn(y, axes=self._periodic).real
        return self._real(y, "i")

    def _real(self, y: FloatArray, inverse: str) -> FloatArray:
        """Transform along all axes that are not periodic."""
        from scipy import fft

        for axis, ends in enumerate(self._ends):
            if axis not in self._periodic:
                name, number = TRANSFORMS[ends]
                y = getattr(fft, f"{inverse}{name}")(y, type=number, axis=axis, norm="ortho")
        return y


def _ends(grid: GridBase, bc: Any) -> list[tuple[bool, bool]]:
    """Return for each axis which ends have values: the points beyond change sign there."""
    if bc is None:
        return [(False, False)] * grid.num_axes
    conditions = grid.get_boundary_conditions(bc, rank=0)
    shape = tuple(n + 2 for n in grid.shape)
    ones, zeros = np.ones(shape), np.zeros(shape)
    conditions.set_ghost_cells(ones)
    conditions.set_ghost_cells(zeros)
    factor, found = ones - zeros, []
    for axis in range(grid.num_axes):
        layers = np.moveaxis(factor, axis, 0)
        middle = tuple(n // 2 for n in layers.shape[1:])
        found.append((bool(layers[0][middle] < -0.5), bool(layers[-1][middle] < -0.5)))
    return found
