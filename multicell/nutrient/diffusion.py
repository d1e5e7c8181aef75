"""Diffusion on a cell-centred grid: py-pde's Laplacian, the flow through the faces, an inverse."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import FloatArray
from multicell.nutrient import stencil
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
    """The Laplacian of py-pde on a box with conditions on its faces, and an inverse.

    In two dimensions nodes are prisms: squares in the plane, ``height`` across it. Arrays have
    three axes all the same, the last one of length 1.

    Parameters
    ----------
    grid
        Cartesian grid of cubes in three dimensions or of squares in two, cell-centred, not
        periodic.
    diffusion : float, µm²/s
        In tissue.
    boundary
        Concentration in mM on all faces, or py-pde's description of its conditions
        (``{"x-": {"value": array}, "x+": {"derivative": 0.0}, ...}``), of one kind on each
        face. Never pass text from users: py-pde executes it.
    height : float, µm
        Of the layer in two dimensions.
    varied : (nx, ny, nz), optional
        Coefficient of diffusion at the nodes over that of tissue; absent: one everywhere. At
        faces between nodes it is the harmonic mean, for which the flow is continuous where the
        coefficient jumps.

    Raises
    ------
    ValueError
        If the spacing differs between the axes.
    """

    def __init__(
        self,
        grid: CartesianGrid,
        diffusion: float,
        boundary: float | Mapping[str, Any],
        *,
        height: float | None = None,
        varied: FloatArray | None = None,
    ) -> None:
        if not np.allclose(grid.discretization, grid.discretization[0], rtol=1e-9):
            raise ValueError(f"spacing differs between axes: {grid.discretization} um")
        self.dimensions = len(grid.shape)
        nx, ny, nz = (*grid.shape, 1)[:3]
        self.shape = (nx, ny, nz)
        self.spacing = float(grid.discretization[0])
        self.volume = self.spacing**2 * (height or self.spacing)
        self.diffusion = diffusion
        self.stiffness = diffusion / self.spacing**2
        self.threads = 1  # that may share the loops over many nodes; it changes no result
        self._grid = grid
        self.set_boundary(boundary)
        # relative coefficients at the nodes and at the faces between them, None for one everywhere
        self.varied: FloatArray | None = None
        self.weights: stencil.Weights = None
        if varied is not None:
            self.varied = np.ascontiguousarray(varied.reshape(self.shape), dtype=float)
            wx, wy, wz = (_face_means(self.varied, axis) for axis in range(3))
            self.weights = (wx, wy, wz)

    def set_boundary(self, boundary: float | Mapping[str, Any]) -> None:
        """Take other conditions on the faces."""
        values = dict(boundary) if isinstance(boundary, Mapping) else {"value": float(boundary)}
        self._conditions = self._grid.get_boundary_conditions(values, rank=0)
        self._laplacian: Callable[[FloatArray], FloatArray] = self._grid.make_operator(
            "laplace", bc=self._conditions, backend="scipy"
        )
        self.source, self.ghost = self._faces()
        self._kinds, leak = self._nearest()
        self._eigenvalues = [
            self.stiffness * eigenvalues(n, kind)
            for n, kind in zip(self.shape, self._kinds, strict=True)
        ]
        self._leak = leak

    def divergence(self, c: FloatArray) -> FloatArray:
        """Return D L c in mM/s, boundary values included.

        By py-pde's operator where the coefficient is uniform, else by the solver's own stencil.
        """
        if self.weights is None:
            flat = c.reshape(self.shape[: self.dimensions])
            return np.asarray(self.diffusion * self._laplacian(flat)).reshape(self.shape)
        out = np.empty_like(c)
        zero = np.zeros_like(c)
        stencil.apply_operator(c, zero, self.stiffness, self.ghost, self.weights, out)
        return np.asarray(self.stencil_source() - out)

    def flows(self, c: FloatArray) -> tuple[float, float]:
        """Return what flows in and out through the faces, amol/s, from py-pde's ghost values."""
        flat = self.shape[: self.dimensions]
        full, c = np.empty([n + 2 for n in flat]), c.reshape(flat)
        for axis in range(self.dimensions):  # ghost values need the outermost layers only
            _, first, last, _ = _layers(full, axis)
            nodes = np.moveaxis(c, axis, 0)
            first[...], last[...] = nodes[0], nodes[-1]
        self._conditions.set_ghost_cells(full)
        inward = outward = 0.0
        for axis in range(self.dimensions):
            low_ghost, first, last, high_ghost = _layers(full, axis)
            low, high = (
                (1.0, 1.0) if self.weights is None
                else _ends(self.weights[axis], axis, self.dimensions)
            )  # fmt: skip
            for step in (low * (low_ghost - first), high * (high_ghost - last)):
                inward += float(np.sum(step, where=step > 0.0))
                outward -= float(np.sum(step, where=step < 0.0))
        scale = self.stiffness * self.volume
        return scale * inward, scale * outward

    def inflow(self, c: FloatArray) -> float:
        """Return the net flow in through the faces, amol/s."""
        inward, outward = self.flows(c)
        return inward - outward

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
        ax, ay, az = self._eigenvalues
        spectrum = _transform(y, self._kinds, inverse=False)
        product = stencil.divide_spectrum(spectrum, ax, ay, az, shift + self._leak)
        return _transform(spectrum, self._kinds, inverse=True), product

    def stencil_source(self) -> FloatArray:
        """Return what the faces bring to the balance of the nodes, (nx, ny, nz) mM/s."""
        # a node at a face exchanges with it by its own coefficient
        return self.source if self.varied is None else self.source * self.varied

    def _faces(self) -> tuple[FloatArray, FloatArray]:
        """Return what the faces bring to each node, mM/s, and the factor of their ghost values.

        Both from py-pde's ghost values, of a field of zeros and of one of ones; only the layers at
        the faces are looked at. The third axis of a plane has walls.
        """
        flat = self.shape[: self.dimensions]
        field, source, factors = np.zeros([n + 2 for n in flat]), np.zeros(flat), np.ones(6)
        self._conditions.set_ghost_cells(field)
        scale = self._grid.discretization[0] ** -2
        layers = [_layers(field, axis) for axis in range(self.dimensions)]
        for axis, (low, _, _, high) in enumerate(layers):
            ends = np.moveaxis(source, axis, 0)
            if flat[axis] == 1:
                ends[0] += scale * low + scale * high
            else:
                ends[0] += scale * low
                ends[-1] += scale * high
        source *= self.diffusion
        middle = [tuple(n // 2 for n in layer[0].shape) for layer in layers]
        zeros = [(low[m], high[m]) for (low, _, _, high), m in zip(layers, middle, strict=True)]
        for _, first, last, _ in layers:
            first[...] = last[...] = 1.0
        self._conditions.set_ghost_cells(field)
        for axis, ((low, _, _, high), m) in enumerate(zip(layers, middle, strict=True)):
            factors[2 * axis] = low[m] - zeros[axis][0]
            factors[2 * axis + 1] = high[m] - zeros[axis][1]
        return source.reshape(self.shape), factors

    def _nearest(self) -> tuple[list[tuple[bool, bool]], float]:
        """Return for each axis which ends are taken as values, and the mean leak of the others.

        A mixed condition is taken as a slope with the mean of what it lets through: the ratio of
        the two stays bounded when the grid becomes finer, that to a value does not.
        """
        kinds, leak = [], 0.0
        for axis, n in enumerate(self.shape):
            ends = []
            for factor in self.ghost[2 * axis : 2 * axis + 2]:
                is_value = n > 1 and factor < -0.5
                ends.append(bool(is_value))
                leak += 0.0 if is_value else self.stiffness * (1.0 - factor) / n
            kinds.append((ends[0], ends[1]))
        return kinds, leak


def eigenvalues(n: int, ends: tuple[bool, bool]) -> FloatArray:
    """Return the n eigenvalues of minus the second difference between two ends.

    With values at both ends the angles are kπ/n for k = 1 ... n, with slopes at both for
    k = 0 ... n - 1, and with one of each (k + 1/2)π/n.
    """
    first = {(True, True): 1.0, (False, False): 0.0}.get(ends, 0.5)
    return np.asarray(4.0 * np.sin(0.5 * np.pi * (np.arange(n) + first) / n) ** 2)


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


def _face_means(varied: FloatArray, axis: int) -> FloatArray:
    """Return the coefficients at the faces across an axis: harmonic means, and the outer nodes'."""
    v = np.moveaxis(varied, axis, 0)
    means = 2.0 * v[1:] * v[:-1] / (v[1:] + v[:-1])
    return np.ascontiguousarray(np.moveaxis(np.concatenate([v[:1], means, v[-1:]]), 0, axis))


def _layers(full: FloatArray, axis: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return ghost values, first nodes, last nodes and ghost values along an axis, views."""
    inner = (slice(1, -1),) * (full.ndim - 1)
    lines = np.moveaxis(full, axis, 0)
    return lines[0][inner], lines[1][inner], lines[-2][inner], lines[-1][inner]


def _ends(w: FloatArray, axis: int, dimensions: int) -> tuple[Any, Any]:
    """Return the coefficients at the two outer faces of an axis, without a plane's third axis."""
    layers = np.moveaxis(w, axis, 0)
    low, high = layers[0], layers[-1]
    return (low[..., 0], high[..., 0]) if dimensions == 2 else (low, high)
