"""Diffusion on a cell-centred grid: the Laplacian, the flow through the faces, an inverse."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import FloatArray
from multicell.nutrient import dense, stencil
from multicell.nutrient.cartesian import Box
from multicell.nutrient.dense import Ends, eigenvalues
from multicell.nutrient.faces import ghost_terms
from multicell.nutrient.layer import exchanged
from multicell.nutrient.steady import solve_steady

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

    - ``box``: the nodes
    - ``diffusion``, float, µm²/s: in tissue
    - ``boundary``: concentration in mM on all faces, or a condition for each in py-pde's terms
      (``{"x-": {"value": 0.1}, "x+": {"derivative": 0.0}, ...}``)
    - ``varied``, (nx, ny, nz), optional: coefficient of diffusion at the nodes over that of tissue;
      absent: one everywhere. At faces between nodes it is the harmonic mean, for which the flow is
      continuous where the coefficient jumps.

    - ``exchange``, (nx, ny, nz), optional: rate of exchange over D/h² with a medium of ``level`` mM
      (:mod:`multicell.nutrient.layer`)

    - ``volumes``, float, µm³: of each node
    - ``ghost``, (6,): factors of the faces x-, x+, y-, y+, z-, z+
    - ``const``, (6,), mM: what the conditions add
    - ``source``, (nx, ny, nz), mM/s: what they bring to the nodes where the coefficient is that of
      tissue
    - ``dense``: the inverse on few nodes; None on others
    - ``room``: memory that multigrid has worked in
    """

    room: NDArray[np.float32] | None = None

    def __init__(
        self,
        box: Box,
        diffusion: float,
        boundary: float | Mapping[str, Any],
        *,
        varied: FloatArray | None = None,
        exchange: FloatArray | None = None,
        level: float = 0.0,
    ) -> None:
        self.dimensions = 3 if box.height is None else 2
        self.shape, self.spacing, self.volumes = box.shape, box.spacing, box.volume
        self.diffusion = diffusion
        self.stiffness = diffusion / self.spacing**2
        self._repeats = box.repeats
        self.threads = 1  # that may share the loops over many nodes; it changes no result
        self.set_boundary(boundary)
        # relative coefficients at the nodes and at the faces between them, None for one everywhere
        self.varied: FloatArray | None = None
        self.weights: stencil.Weights = None
        if varied is not None:
            self.varied = np.ascontiguousarray(varied.reshape(self.shape), dtype=float)
        if varied is not None or any(self._repeats):
            found = np.ones(self.shape) if self.varied is None else self.varied
            wx, wy, wz = (
                stencil.face_means(found, axis, repeats)
                for axis, repeats in enumerate(self._repeats)
            )
            self.weights = (wx, wy, wz)
        self.level = float(level)
        self.set_exchange(exchange)

    def set_exchange(self, exchange: FloatArray | None) -> None:
        """Take other rates of exchange with the medium, over D/h² of each node."""
        self.exchange: FloatArray | None = None
        self.largest_exchange = 0.0
        if exchange is not None:
            if self.varied is not None:
                exchange = exchange * self.varied
            self.exchange = self.stiffness * exchange
            self.largest_exchange = float(self.exchange.max())

    def set_boundary(self, boundary: float | Mapping[str, Any]) -> None:
        """Take other conditions on the faces."""
        if not isinstance(boundary, Mapping):
            boundary = {face: {"value": boundary} for face in _FACES}
        self._boundary = boundary
        found = [ghost_terms(boundary[f], self.spacing) for f in _FACES[: 2 * self.dimensions]]
        for axis in range(self.dimensions):
            if self._repeats[axis]:
                found[2 * axis] = found[2 * axis + 1] = (0.0, stencil.REPEATS)
        self._has_slopes = any(factor == 1.0 for _, factor in found)
        self._sides = _sides(self.shape, *zip(*found, strict=True))
        sides = self._sides
        self.ghost, self.const, self.dense = sides.ghost, sides.const, sides.dense
        self._take_stiffness()

    def resized(self, box: Box, boundary: float | Mapping[str, Any]) -> Diffusion:
        """Return it on a box of as many nodes, if the medium and the coefficient are uniform.

        That is without ``varied`` and ``exchange``.
        """
        other = object.__new__(Diffusion)
        vars(other).update(vars(self))
        other.spacing, other.volumes = box.spacing, box.volume
        other.stiffness = self.diffusion / box.spacing**2
        if boundary is self._boundary and not self._has_slopes:
            other._take_stiffness()  # what values at faces bring knows nothing of the spacing
        else:
            other.set_boundary(boundary)
        return other

    def _take_stiffness(self) -> None:
        """Renew what goes in proportion to the rate of diffusion between nodes."""
        brought = self._sides.brought
        brought = _brought(self.shape, self.const) if brought is None else brought
        self.source = brought * self.stiffness

    def flows(self, c: FloatArray, known: tuple[float, float] | None = None) -> tuple[float, float]:
        """Return the flows in and out through the faces and to the medium, amol/s.

        - ``known``: the result of :func:`.stencil.flows`
        """
        inward, outward = known or stencil.flows(c, self.ghost, self.const, self.weights)
        scale = self.stiffness * self.volumes
        inward, outward = scale * inward, scale * outward
        if self.exchange is not None:
            gained, given = exchanged(self.exchange, c, self.level)
            inward, outward = inward + self.volumes * gained, outward + self.volumes * given
        return inward, outward

    solve = solve_steady

    def invert(self, y: NDArray[Any], shift: float) -> tuple[NDArray[Any], float]:
        """Solve (-D L0 + shift) u = y approximately, in the precision of ``y``.

        L0 is the Laplacian with zero on the faces and a uniform coefficient. Returns u, which takes
        the memory of ``y``, and y . u.
        """
        ax, ay, az = self.eigenvalues
        spectrum = _transform(y, self.kinds, inverse=False)
        product = stencil.divide_spectrum(spectrum, ax, ay, az, shift)
        return _transform(spectrum, self.kinds, inverse=True), product

    def near_inverse(self, r: FloatArray, shift: FloatArray) -> FloatArray:
        """Return about (-D L0 + shift)⁻¹ r, with ``shift`` (1/s) at the nodes.

        ``shift`` holds the exchange with the medium, which is taken out of its mean.
        """
        if self.exchange is None:
            return np.asarray(self.invert(r, float(shift.mean()))[0])
        scale = 1.0 / np.sqrt(1.0 + 0.5 / self.stiffness * self.exchange)
        mean = float((shift - self.exchange).mean())
        return np.asarray(scale * self.invert(scale * r, mean)[0])

    def to_modes(self, values: FloatArray) -> FloatArray:
        """Return values of the nodes as parts of the Laplacian's modes, in their memory.

        They are those of a uniform coefficient, with zero on the faces; the transform is
        orthonormal.
        """
        return np.asarray(_transform(values, self.kinds, inverse=False))

    def from_modes(self, parts: FloatArray) -> FloatArray:
        """Return the nodes' values of parts of the modes, in their memory."""
        return np.asarray(_transform(parts, self.kinds, inverse=True))

    @property
    def kinds(self) -> list[Ends]:
        """Of each axis which ends have values, the others have slopes; None where it repeats."""
        return self._sides.kinds

    @property
    def eigenvalues(self) -> list[FloatArray]:
        """Those of -D L0 along each axis, see :meth:`invert`: (nx,), (ny,), (nz,) 1/s."""
        axes = zip(self.shape, self.kinds, strict=True)
        return [self.stiffness * eigenvalues(n, kind) for n, kind in axes]

    def brought(self) -> FloatArray:
        """Return the gain of the nodes over the faces, (nx, ny, nz) mM/s."""
        # a node at a face exchanges with it by its own coefficient
        return self.source if self.varied is None else self.source * self.varied

    def fastest(self) -> float:
        """Return about the largest rate at which diffusion empties a node, 1/s."""
        varied = 1.0 if self.varied is None else float(self.varied.max())
        return 2.0 * self.dimensions * self.stiffness * max(varied, 1.0)


_FACES = ("x-", "x+", "y-", "y+", "z-", "z+")


@final
class _Sides(NamedTuple):
    """Constants of a grid's shape and the conditions on its faces.

    - ``ghost``, ``const``: see :class:`Diffusion`
    - ``kinds``, (3,) of (bool, bool): of each axis which ends have values, the others have slopes;
      None where space repeats
    - ``dense``: the inverse on few nodes; None for grids that it does not suit
    - ``brought``, (nx, ny, nz), mM: what nodes gain by ``const``, over D/h²; None on such grids
    """

    ghost: FloatArray
    const: FloatArray
    kinds: list[Ends]
    dense: dense.Inverse | None
    brought: FloatArray | None


@lru_cache(maxsize=16)  # a grid that follows the cells has the same shape for many steps
def _sides(
    shape: tuple[int, int, int], constants: tuple[float, ...], factors: tuple[float, ...]
) -> _Sides:
    """Return the sides for constants (mM) and factors; a plane has two walls besides."""
    walls = 6 - len(factors)
    ghost, const = np.array((*factors, *[1.0] * walls)), np.array((*constants, *[0.0] * walls))
    kinds: list[Ends] = [
        None if low == stencil.REPEATS else (bool(low < 0.0), bool(high < 0.0))
        for low, high in ghost.reshape(3, 2)
    ]
    inverse = None
    alike = all(ends is None or ends[0] == ends[1] for ends in kinds)
    if max(shape) <= dense.MAX_DENSE_NODES and alike:
        inverse = dense.Inverse(
            [
                dense.halves(n, None if ends is None else ends[0])
                for n, ends in zip(shape, kinds, strict=True)
            ]
        )
    return _Sides(ghost, const, kinds, inverse, _brought(shape, const) if inverse else None)


def _transform(y: NDArray[Any], kinds: Sequence[Ends], *, inverse: bool) -> NDArray[Any]:
    """Transform along all axes; those of the same kind at once."""
    from scipy import fft

    kinds_of_axes: dict[tuple[int, ...], Ends]
    if all(kind == kinds[0] for kind in kinds) and kinds[0] is not None:
        kinds_of_axes = {tuple(range(y.ndim)): kinds[0]}
    else:
        kinds_of_axes = {(axis,): kind for axis, kind in enumerate(kinds) if y.shape[axis] > 1}
    for axes, kind in kinds_of_axes.items():
        if kind is None:
            # Hartley's transform: real, orthogonal, and its own inverse
            waves = fft.fft(y, axis=axes[0], norm="ortho", workers=1)
            y = np.ascontiguousarray(waves.real - waves.imag)
            continue
        name, number = TRANSFORMS[kind]
        run = getattr(fft, f"i{name}n" if inverse else f"{name}n")
        y = run(y, type=number, axes=axes, norm="ortho", overwrite_x=True, workers=1)
    return y


def _brought(shape: tuple[int, int, int], const: FloatArray) -> FloatArray:
    """Return the gain of nodes by the constants of the six faces, (nx, ny, nz) mM."""
    found = np.zeros(shape)
    for face, each in enumerate(const):
        found[(slice(None),) * (face // 2) + (-(face % 2),)] += each
    return found
