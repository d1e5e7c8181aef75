"""Diffusion on a cell-centred grid: the Laplacian, the flow through the faces, an inverse."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import FloatArray
from multicell.nutrient import dense, stencil
from multicell.nutrient.cartesian import Box
from multicell.nutrient.dense import eigenvalues
from multicell.nutrient.faces import ghost_terms
from multicell.nutrient.steady import SolveReport, solve_steady

if TYPE_CHECKING:
    from pde.grids.cartesian import CartesianGrid


# What diagonalises the second difference on n cell-centred nodes, by what stands at its two ends
# (True: a value, False: a slope): the name and the type of SciPy's transform.
TRANSFORMS = {
    (True, True): ("dst", 2),
    (False, False): ("dct", 2),
    (True, False): ("dst", 4),
    (False, True): ("dct", 4),
}


@final
class Diffusion:
    """The Laplacian on a box with conditions on its faces, and an inverse.

    Beyond each face one more node has the value ``ghost c + const``, c the value of the node at
    the face: py-pde's convention, in which a value gives a ghost of -1 and a slope one of 1.

    In two dimensions nodes are prisms: squares in the plane, ``height`` across it. Arrays have
    three axes all the same, the last one of length 1.

    - ``grid``: a box, or py-pde's Cartesian grid of cubes in three dimensions or of squares in two,
      cell-centred, not periodic
    - ``diffusion``, float, µm²/s: in tissue
    - ``boundary``: concentration in mM on all faces, or py-pde's description of its conditions. On
      a box each face is named and its condition made of numbers (``{"x-": {"value": 0.1}, "x+":
      {"derivative": 0.0}, ...}``); what py-pde knows besides, arrays too, holds on its own grid, of
      one kind on each face. Never pass text from users: py-pde executes it.
    - ``height``, float, µm: of the layer in two dimensions
    - ``varied``, (nx, ny, nz), optional: coefficient of diffusion at the nodes over that of tissue;
      absent: one everywhere. At faces between nodes it is the harmonic mean, for which the flow is
      continuous where the coefficient jumps.

    - ``ghost``, (6,): factors of the faces x-, x+, y-, y+, z-, z+
    - ``const``, six arrays (ny, nz), (ny, nz), (nx, nz), (nx, nz), (nx, ny), (nx, ny); mM: what the
      conditions add
    - ``source``, (nx, ny, nz), mM/s: what they bring to the nodes where the coefficient is that of
      tissue

    Raises ValueError if the spacing differs between the axes.
    """

    def __init__(
        self,
        grid: CartesianGrid | Box,
        diffusion: float,
        boundary: float | Mapping[str, Any],
        *,
        height: float | None = None,
        varied: FloatArray | None = None,
    ) -> None:
        self._grid = None if isinstance(grid, Box) else grid
        if isinstance(grid, Box):
            self.dimensions = 3 if grid.height is None else 2
            self.shape, self.spacing = grid.shape, grid.spacing
        else:
            steps = grid.discretization
            if not np.allclose(steps, steps[0], rtol=1e-9):
                raise ValueError(f"spacing differs between axes: {steps} um")
            self.dimensions = len(grid.shape)
            nx, ny, nz = (*grid.shape, 1)[:3]
            self.shape, self.spacing = (nx, ny, nz), float(steps[0])
        self.volume = self.spacing**2 * (height or self.spacing)
        self.diffusion = diffusion
        self.stiffness = diffusion / self.spacing**2
        self.threads = 1  # that may share the loops over many nodes; it changes no result
        self.set_boundary(boundary)
        # relative coefficients at the nodes and at the faces between them, None for one everywhere
        self.varied: FloatArray | None = None
        self.weights: stencil.Weights = None
        if varied is not None:
            self.varied = np.ascontiguousarray(varied.reshape(self.shape), dtype=float)
            wx, wy, wz = (stencil.face_means(self.varied, axis) for axis in range(3))
            self.weights = (wx, wy, wz)

    def set_boundary(self, boundary: float | Mapping[str, Any]) -> None:
        """Take other conditions on the faces."""
        if self._grid is None:
            self._sides = _plain(self.shape, *self._numbers(boundary))
        else:
            self._sides = self._by_pde(self._grid, boundary)
        self.ghost, self.const = self._sides.ghost, self._sides.const
        brought = self._sides.brought
        self.source = _brought(self.const) if brought is None else brought.copy()
        self.source *= self.stiffness
        self._leak = self.stiffness * self._sides.leak
        halves = self._sides.halves
        self._dense = dense.Inverse(halves, self.stiffness) if halves else None

    def _numbers(
        self, boundary: float | Mapping[str, Any]
    ) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return factors and constants of the faces, of a plane those across it."""
        if not isinstance(boundary, Mapping):
            boundary = {face: {"value": boundary} for face in _FACES}
        found = [ghost_terms(boundary[f], self.spacing) for f in _FACES[: 2 * self.dimensions]]
        return tuple(factor for _, factor in found), tuple(const for const, _ in found)

    def _by_pde(self, grid: CartesianGrid, boundary: float | Mapping[str, Any]) -> _Sides:
        """Return what py-pde makes of conditions."""
        values = dict(boundary) if isinstance(boundary, Mapping) else {"value": float(boundary)}
        conditions = grid.get_boundary_conditions(values, rank=0)
        self._laplacian: Callable[[FloatArray], FloatArray] = grid.make_operator(
            "laplace", bc=conditions, backend="scipy"
        )
        padded = tuple(n + 2 for n in grid.shape)
        ones, zeros = np.ones(padded), np.zeros(padded)
        conditions.set_ghost_cells(ones)
        conditions.set_ghost_cells(zeros)
        ghost, const = np.ones(6), []
        for face in range(6):
            found = np.zeros(_across(self.shape, face))
            if face < 2 * self.dimensions:
                inner = (slice(1, -1),) * (self.dimensions - 1)
                zero = _layer(zeros, face)[inner]
                found[...] = zero.reshape(found.shape)
                # one factor on a face: that of a node in its middle
                middle = tuple(n // 2 for n in zero.shape)
                ghost[face] = _layer(ones, face)[inner][middle] - zero[middle]
            const.append(found)
        return _Sides.of(self.shape, ghost, const)

    def divergence(self, c: FloatArray) -> FloatArray:
        """Return D L c in mM/s, boundary values included.

        By py-pde's operator on its own grid where the coefficient is uniform, else by the solver's
        stencil.
        """
        if self._grid is not None and self.weights is None:
            spread = self.diffusion * self._laplacian(c.reshape(self._grid.shape))
            return np.asarray(spread).reshape(self.shape)
        out = np.empty_like(c)
        zero = np.zeros_like(c)
        stencil.apply_operator(c, zero, self.stiffness, self.ghost, self.weights, out)
        return np.asarray(self.stencil_source() - out)

    def flows(self, c: FloatArray) -> tuple[float, float]:
        """Return what flows in and out through the faces, amol/s."""
        inward, outward = stencil.flows(c, self.ghost, self.const, self.weights)
        scale = self.stiffness * self.volume
        return scale * inward, scale * outward

    def solve(
        self,
        sink: FloatArray,
        half_saturation: float,
        start: FloatArray,
        *,
        linear: float = 0.0,
        supply: FloatArray | None = None,
    ) -> tuple[FloatArray, SolveReport]:
        """Solve; see :func:`multicell.nutrient.steady.solve_steady`."""
        return solve_steady(self, sink, half_saturation, start, linear=linear, supply=supply)

    def invert(self, y: NDArray[Any], shift: float) -> tuple[NDArray[Any], float]:
        """Solve (-D L0 + shift) u = y approximately, in the precision of ``y``.

        L0 is the Laplacian with every face taken as the nearer one of a value and a slope, both
        zero, and a uniform coefficient. Returns u, which takes the memory of ``y``, and y . u.
        """
        if self._dense is not None and y.dtype == np.float32:
            return y, self._dense.overwrite(y, shift + self._leak)
        ax, ay, az = self.eigenvalues
        spectrum = _transform(y, self.kinds, inverse=False)
        product = stencil.divide_spectrum(spectrum, ax, ay, az, shift + self._leak)
        return _transform(spectrum, self.kinds, inverse=True), product

    @property
    def kinds(self) -> list[tuple[bool, bool]]:
        """Of each axis which ends the inverse takes as values, the others as slopes."""
        return self._sides.kinds

    @property
    def eigenvalues(self) -> list[FloatArray]:
        """Those of -D L0 along each axis, see :meth:`invert`: (nx,), (ny,), (nz,) 1/s."""
        axes = zip(self.shape, self.kinds, strict=True)
        return [self.stiffness * eigenvalues(n, kind) for n, kind in axes]

    def stencil_source(self) -> FloatArray:
        """Return what the faces bring to the balance of the nodes, (nx, ny, nz) mM/s."""
        # a node at a face exchanges with it by its own coefficient
        return self.source if self.varied is None else self.source * self.varied


_FACES = ("x-", "x+", "y-", "y+", "z-", "z+")


@final
class _Sides(NamedTuple):
    """What follows from the shape of a grid and the conditions on its faces alone.

    - ``ghost``, ``const``: see :class:`Diffusion`
    - ``kinds``, (3,) of (bool, bool): of each axis which ends the inverse takes as values, the
      others as slopes
    - ``leak``, float: the mean of what the others let through, over D/h². The ratio of a mixed
      condition to a slope stays bounded when the grid becomes finer, that to a value does not.
    - ``halves``, (3,) of (4, h, h), (n,): see :func:`multicell.nutrient.dense.halves`; empty for
      grids that these do not suit
    - ``brought``, (nx, ny, nz), mM: what nodes gain by ``const``, over D/h²; None on such large
      grids
    """

    ghost: FloatArray
    const: stencil.Faces
    kinds: list[tuple[bool, bool]]
    leak: float
    halves: list[tuple[NDArray[np.float32], FloatArray]]
    brought: FloatArray | None

    @classmethod
    def of(
        cls, shape: tuple[int, int, int], ghost: FloatArray, const: Sequence[FloatArray]
    ) -> _Sides:
        """Return what follows from these."""
        kinds, leak = [], 0.0
        for axis, n in enumerate(shape):
            low, high = (n > 1 and factor < -0.5 for factor in ghost[2 * axis : 2 * axis + 2])
            kinds.append((bool(low), bool(high)))
            for value, factor in zip((low, high), ghost[2 * axis : 2 * axis + 2], strict=True):
                leak += 0.0 if value else float(1.0 - factor) / n
        halves = []
        if max(shape) <= dense.MOST and all(low == high for low, high in kinds):
            halves = [dense.halves(n, low) for n, (low, _) in zip(shape, kinds, strict=True)]
        a, b, c, d, e, f = const
        brought = _brought(const) if halves else None
        return cls(ghost, (a, b, c, d, e, f), kinds, leak, halves, brought)


@lru_cache(maxsize=16)
def _plain(
    shape: tuple[int, int, int], ghost: tuple[float, ...], const: tuple[float, ...]
) -> _Sides:
    """Return what follows from conditions that are the same all over each face.

    A plane has two walls besides. A grid that follows the cells has the same shape for many steps.
    """
    walls = 6 - len(ghost)
    each = [np.full(_across(shape, face), c) for face, c in enumerate((*const, *[0.0] * walls))]
    return _Sides.of(shape, np.array((*ghost, *[1.0] * walls)), each)


def _transform(
    y: NDArray[Any], kinds: Sequence[tuple[bool, bool]], *, inverse: bool
) -> NDArray[Any]:
    """Transform along all axes; those of the same kind at once."""
    from scipy import fft

    if all(kind == kinds[0] for kind in kinds):
        kinds_of_axes = {tuple(range(y.ndim)): kinds[0]}
    else:
        kinds_of_axes = {(axis,): kind for axis, kind in enumerate(kinds) if y.shape[axis] > 1}
    for axes, kind in kinds_of_axes.items():
        name, number = TRANSFORMS[kind]
        run = getattr(fft, f"i{name}n" if inverse else f"{name}n")
        y = run(y, type=number, axes=axes, norm="ortho", overwrite_x=True, workers=1)
    return y


def _brought(const: Sequence[FloatArray]) -> FloatArray:
    """Return what nodes gain by the constants of the six faces, (nx, ny, nz) mM."""
    found = np.zeros((const[2].shape[0], *const[0].shape))
    for face, each in enumerate(const):
        layer = _layer(found, face)
        layer += each
    return found


def _layer(values: NDArray[Any], face: int) -> NDArray[Any]:
    """Return the nodes at a face, of x-, x+, y-, y+, z-, z+, as a view."""
    at = -(face % 2)
    return values[(slice(None),) * (face // 2) + (at,)]


def _across(shape: tuple[int, int, int], face: int) -> tuple[int, ...]:
    """Return the shape of the nodes at a face."""
    return shape[: face // 2] + shape[face // 2 + 1 :]
