"""Diffusion on a cell-centred grid: py-pde's Laplacian, the flow through the faces, an inverse."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import FloatArray
from multicell.nutrient import stencil

if TYPE_CHECKING:
    from pde.grids.cartesian import CartesianGrid


@final
class Diffusion:
    """The Laplacian of py-pde on a grid with Dirichlet values on all faces, and its inverse.

    Parameters
    ----------
    grid
        Cartesian grid of cubes in three dimensions, cell-centred, not periodic.
    diffusion : float, µm²/s
    boundary
        Concentration in mM on all faces, or py-pde's description of Dirichlet conditions
        (``{"x-": {"value": array}, ...}``). Never pass text from users: py-pde executes it.

    Raises
    ------
    ValueError
        If the spacing differs between the axes.
    """

    def __init__(
        self, grid: CartesianGrid, diffusion: float, boundary: float | Mapping[str, Any]
    ) -> None:
        if not np.allclose(grid.discretization, grid.discretization[0], rtol=1e-9):
            raise ValueError(f"spacing differs between axes: {grid.discretization} um")
        nx, ny, nz = grid.shape
        self.shape = (nx, ny, nz)
        self.spacing = float(grid.discretization[0])
        self.diffusion = diffusion
        self.stiffness = diffusion / self.spacing**2
        values = dict(boundary) if isinstance(boundary, Mapping) else {"value": float(boundary)}
        self._conditions = grid.get_boundary_conditions(values, rank=0)
        self._laplacian: Callable[[FloatArray], FloatArray] = grid.make_operator(
            "laplace", bc=self._conditions, backend="scipy"
        )
        self.source: FloatArray = diffusion * self._laplacian(np.zeros(self.shape))
        self._eigenvalues = [self.stiffness * sine_eigenvalues(n) for n in self.shape]

    def divergence(self, c: FloatArray) -> FloatArray:
        """Return D L c in mM/s by py-pde's operator, boundary values included."""
        return np.asarray(self.diffusion * self._laplacian(c))

    def inflow(self, c: FloatArray) -> float:
        """Return the net flow in through the faces in amol/s, from py-pde's ghost values."""
        full = np.empty([n + 2 for n in self.shape])
        full[1:-1, 1:-1, 1:-1] = c
        self._conditions.set_ghost_cells(full)
        steps = 0.0
        for axis in range(3):
            layers = np.moveaxis(full, axis, 0)[:, 1:-1, 1:-1]
            steps += float(np.sum(layers[0] - layers[1]) + np.sum(layers[-1] - layers[-2]))
        return self.diffusion * self.spacing * steps

    def invert(self, y: NDArray[Any], shift: float) -> tuple[NDArray[Any], float]:
        """Solve (-D L0 + shift) u = y for zero on the faces, in the precision of ``y``.

        Returns u, which takes the memory of ``y``, and the product y . u.
        """
        from scipy.fft import dstn, idstn

        ax, ay, az = self._eigenvalues
        spectrum = dstn(y, type=2, norm="ortho", overwrite_x=True, workers=1)
        product = stencil.divide_spectrum(spectrum, ax, ay, az, shift)
        u = idstn(spectrum, type=2, norm="ortho", overwrite_x=True, workers=1)
        return u, product


def sine_eigenvalues(n: int) -> FloatArray:
    """Return the n eigenvalues of minus the one-dimensional Dirichlet Laplacian times h²."""
    return np.asarray(4.0 * np.sin(0.5 * np.pi * np.arange(1, n + 1) / n) ** 2)
