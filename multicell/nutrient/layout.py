"""Where a field lives: a box of cubes, a plane of squares, or a ball of shells.

Each layout spreads amounts of the cells over its nodes, interpolates at the cells, takes over the
values of the layout before it, and makes the operator that solves on it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, final

import numpy as np

from multicell.cells import SPHERE, FloatArray
from multicell.errors import NutrientFailed
from multicell.nutrient import transfer
from multicell.nutrient.diffusion import Diffusion
from multicell.nutrient.grid import (
    Box,
    extent,
    lay,
    lay_flat,
    moved,
    overlaps,
)
from multicell.nutrient.shells import Shells
from multicell.nutrient.steady import SolveReport, solve_steady

if TYPE_CHECKING:
    from multicell.frame import Field
    from multicell.nutrient.parts import Side

_TISSUE = 0.5
"""Part of a node's volume that is cells from which on it is tissue."""


_CUBE = 1.14445
"""Harmonic radius of a cube seen from its middle, over half its edge.

The harmonic function with the values 1/|x| on the faces is 1 / 1.14445 there (half edge 1; by its
series of sines).
"""


class Operator(Protocol):
    """Solves for a field on the nodes of a layout."""

    def set_boundary(self, boundary: Mapping[str, Any]) -> None:
        """Take other conditions, in py-pde's terms."""

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


class Layout(Protocol):
    """Nodes in space."""

    @property
    def spacing(self) -> float:
        """Distance of neighbouring nodes, µm."""

    @property
    def volumes(self) -> FloatArray | float:
        """Volumes of the nodes, µm³; one number where they are equal."""

    def scatter(self, position: FloatArray, amount: FloatArray) -> FloatArray:
        """Spread amounts of the cells, (n,), over the nodes as densities."""

    def gather(self, position: FloatArray, values: FloatArray) -> FloatArray:
        """Interpolate at positions (n, 3) in µm."""

    def filled(self, value: float) -> FloatArray:
        """Return an array of the nodes."""

    def guess(self, values: FloatArray, old: Layout, fill: float) -> FloatArray:
        """Return the values of another layout, interpolated smoothly, and ``fill`` outside it."""

    def carried(self, values: FloatArray, old: Layout, fill: float) -> FloatArray:
        """Return the values of another layout, each as often as it overlaps: amounts stay."""

    def conditions(self, sides: Mapping[str, Side]) -> dict[str, Any]:
        """Return the conditions on the faces in py-pde's terms."""

    def operator(
        self, diffusion: float, conditions: Mapping[str, Any], varied: FloatArray | None
    ) -> Operator:
        """Return the operator on these nodes."""

    def field(self, name: str, values: FloatArray) -> Field:
        """Return a field for frames."""


def _condition(side: Side) -> dict[str, Any]:
    """Return a condition in py-pde's terms."""
    if side.type == "derivative":
        return {"derivative": float(side.derivative or 0.0)}
    value = float(side.value or 0.0)
    if side.type == "mixed":
        rate = float(side.rate or 0.0)
        return {"type": "mixed", "value": rate, "const": rate * value}
    return {"value": value}


@final
class BoxOperator:
    """:class:`Diffusion` with the solver for boxes."""

    def __init__(self, diffusion: Diffusion) -> None:
        self._diffusion = diffusion

    def set_boundary(self, boundary: Mapping[str, Any]) -> None:
        """Take other conditions, in py-pde's terms."""
        self._diffusion.set_boundary(boundary)

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
        return solve_steady(
            self._diffusion, sink, half_saturation, start, linear=linear, supply=supply
        )


@final
@dataclass(frozen=True)
class BoxLayout:
    """A box of cubes, or a plane of squares, round the cells."""

    box: Box

    @classmethod
    def round(
        cls, position: FloatArray, margin: float, spacing: float, height: float | None
    ) -> BoxLayout:
        """Lay it ``margin`` beyond the outermost cells; flat where ``height`` is given."""
        low, high = extent(position, margin)
        if height is None:
            return cls(lay(low, high, spacing))
        return cls(lay_flat(low, high, spacing, height))

    @property
    def spacing(self) -> float:
        """Distance of neighbouring nodes, µm."""
        return self.box.spacing

    @property
    def volumes(self) -> float:
        """Volume of each node, µm³."""
        return self.box.volume

    def _points(self, position: FloatArray) -> FloatArray:
        return position if self.box.height is None else position * np.array([1.0, 1.0, 0.0])

    def scatter(self, position: FloatArray, amount: FloatArray) -> FloatArray:
        """Spread amounts of the cells, (n,), over the nodes as densities."""
        box = self.box
        density = transfer.scatter(
            self._points(position), amount, box.origin, box.spacing, box.shape
        )
        return density if box.height is None else density * (box.spacing / box.height)

    def gather(self, position: FloatArray, values: FloatArray) -> FloatArray:
        """Interpolate at positions (n, 3) in µm."""
        return transfer.gather(self._points(position), values, self.box.origin, self.box.spacing)

    def filled(self, value: float) -> FloatArray:
        """Return an array of the nodes."""
        return np.full(self.box.shape, value)

    def guess(self, values: FloatArray, old: Layout, fill: float) -> FloatArray:
        """Return the values of another layout, interpolated smoothly, and ``fill`` outside it."""
        if isinstance(old, BoxLayout):
            return moved(values, old.box, self.box, fill)
        return self._from_shells(values, old, fill)

    def carried(self, values: FloatArray, old: Layout, fill: float) -> FloatArray:
        """Return the values of another layout, each as often as it overlaps: amounts stay."""
        if not isinstance(old, BoxLayout):
            return self._from_shells(values, old, fill)
        x, y, z = overlaps(old.box, self.box)
        inside = np.einsum("il,jm,kn,lmn->ijk", x, y, z, values, optimize=True)
        covered = [w.sum(axis=1) for w in (x, y, z)]
        share = covered[0][:, None, None] * covered[1][None, :, None] * covered[2]
        return np.asarray(inside + fill * (1.0 - share))

    def _from_shells(self, values: FloatArray, old: Layout, fill: float) -> FloatArray:
        box = self.box
        nodes = [o + (np.arange(n) + 0.5) * box.spacing
                 for o, n in zip(box.origin, box.shape, strict=True)]  # fmt: skip
        points = np.stack(np.meshgrid(*nodes, indexing="ij"), axis=-1).reshape(-1, 3)
        assert isinstance(old, ShellLayout)
        inside = np.linalg.norm(points - old.centre, axis=1) <= old.radius
        out = np.full(len(points), fill)
        out[inside] = old.gather(points[inside], values)
        return out.reshape(box.shape)

    def conditions(self, sides: Mapping[str, Side]) -> dict[str, Any]:
        """Return the conditions on the faces in py-pde's terms."""
        axes = "xyz" if self.box.height is None else "xy"
        return {axis + end: _condition(sides[axis + end]) for axis in axes for end in "-+"}

    def operator(
        self, diffusion: float, conditions: Mapping[str, Any], varied: FloatArray | None
    ) -> Operator:
        """Return the operator on these nodes."""
        box = self.box
        return BoxOperator(
            Diffusion(box.to_pde(), diffusion, conditions, height=box.height, varied=varied)
        )

    def field(self, name: str, values: FloatArray) -> Field:
        """Return a field for frames."""
        from multicell.frame import Field

        box = self.box
        return Field(
            name=name,
            unit="mM",
            origin=np.array(box.origin),
            spacing=box.spacing,
            values=values,
            height=box.height or 0.0,
        )


@final
@dataclass(frozen=True, eq=False)
class ShellLayout:
    """A ball of shells round the cells' centre of mass."""

    centre: FloatArray
    spacing: float
    count: int

    @classmethod
    def round(
        cls, position: FloatArray, radius: FloatArray, margin: float, spacing: float
    ) -> ShellLayout:
        """Lay it ``margin`` or more beyond the outermost cell; ``spacing`` gives way.

        Its surface is that of the ball which lets as much through to its middle as the cube
        that would be laid round the same cells: how a tissue is fed does not depend on the
        geometry of the grid.
        """
        if len(position) == 0:
            count = max(2, int(np.ceil(margin / spacing)))
            return cls(np.zeros(3), margin / count, count)
        if not np.isfinite(position).all():
            extent(position, margin)  # raises with words
        centre = np.average(position, axis=0, weights=radius**3)
        outer = float(np.sqrt(np.square(position - centre).sum(axis=1).max())) + margin
        low, high = extent(position, margin)
        outer = max(outer, _CUBE * 0.5 * float((high - low).mean()))
        count = int(np.ceil(outer / spacing * (1.0 - 1e-12)))
        if count > 1_000_000:
            raise NutrientFailed(
                f"cells spread over {outer:.3g} um, too far for shells of {spacing:g} um",
                "Find out why cells are so far apart",
            )
        count = max(2, count)
        return cls(centre, outer / count, count)

    @property
    def radius(self) -> float:
        """Radius of the ball, µm."""
        return self.spacing * self.count

    @property
    def volumes(self) -> FloatArray:
        """Volumes of the shells, µm³."""
        return SPHERE * np.diff(np.linspace(0.0, self.radius, self.count + 1) ** 3)

    def _weights(self, position: FloatArray) -> tuple[Any, Any, FloatArray]:
        """Return for each cell the inner and the outer shell and the weight of the outer one."""
        distance = np.sqrt(np.square(position - self.centre).sum(axis=1))
        if not (distance <= self.radius * (1.0 + 1e-12)).all():
            raise ValueError("a position lies outside the nutrient grid")
        u = distance / self.spacing - 0.5
        lower = np.floor(u).astype(np.int64)
        weight = u - lower
        return np.maximum(lower, 0), np.minimum(lower + 1, self.count - 1), weight

    def scatter(self, position: FloatArray, amount: FloatArray) -> FloatArray:
        """Spread amounts of the cells, (n,), over the shells as densities."""
        inner, outer, weight = self._weights(position)
        total = np.bincount(inner, amount * (1.0 - weight), self.count)
        total += np.bincount(outer, amount * weight, self.count)
        return np.asarray(total / self.volumes)

    def gather(self, position: FloatArray, values: FloatArray) -> FloatArray:
        """Interpolate at positions (n, 3) in µm."""
        inner, outer, weight = self._weights(position)
        return np.asarray((1.0 - weight) * values[inner] + weight * values[outer])

    def filled(self, value: float) -> FloatArray:
        """Return an array of the nodes."""
        return np.full(self.count, value)

    def guess(self, values: FloatArray, old: Layout, fill: float) -> FloatArray:
        """Return the values of another layout, interpolated smoothly, and ``fill`` outside it."""
        middles = (np.arange(self.count) + 0.5) * self.spacing
        if isinstance(old, ShellLayout):
            before = (np.arange(old.count) + 0.5) * old.spacing
            return np.asarray(np.interp(middles, before, values, right=fill))
        return self.carried(values, old, fill)

    def carried(self, values: FloatArray, old: Layout, fill: float) -> FloatArray:
        """Return the values of another layout, each as often as it overlaps: amounts stay.

        A shift of the centre is left out: shells are taken as concentric.
        """
        faces = np.linspace(0.0, self.radius, self.count + 1)
        if isinstance(old, ShellLayout):
            before = np.linspace(0.0, old.radius, old.count + 1)
            content = np.concatenate([[0.0], np.cumsum(values * old.volumes)])
            # the content of a ball of radius r, exactly: linear in r³ within a shell
            inside = np.interp(faces**3, before**3, content)
            beyond = SPHERE * np.maximum(faces**3 - old.radius**3, 0.0) * fill
            return np.asarray(np.diff(inside + beyond) / self.volumes)
        assert isinstance(old, BoxLayout)
        box = old.box
        nodes = [o + (np.arange(n) + 0.5) * box.spacing
                 for o, n in zip(box.origin, box.shape, strict=True)]  # fmt: skip
        points = np.stack(np.meshgrid(*nodes, indexing="ij"), axis=-1).reshape(-1, 3)
        distance = np.linalg.norm(points - self.centre, axis=1)
        number, _ = np.histogram(distance, faces)
        total, _ = np.histogram(distance, faces, weights=values.ravel())
        filled = number > 0
        middles = 0.5 * (faces[1:] + faces[:-1])
        means = total[filled] / number[filled]
        return np.interp(middles, middles[filled], means) if filled.any() else self.filled(fill)

    def conditions(self, sides: Mapping[str, Side]) -> dict[str, Any]:
        """Return the condition on the surface in py-pde's terms."""
        return _condition(sides["r+"])

    def operator(
        self, diffusion: float, conditions: Mapping[str, Any], varied: FloatArray | None
    ) -> Operator:
        """Return the operator on these shells."""
        return Shells(self.radius, self.count, diffusion, conditions, varied=varied)

    def field(self, name: str, values: FloatArray) -> Field:
        """Return a field for frames."""
        from multicell.frame import Field

        return Field(
            name=name,
            unit="mM",
            origin=self.centre,
            spacing=self.spacing,
            values=values.reshape(-1, 1, 1),
            kind="radial",
        )


def relative_diffusion(
    layout: Layout, position: FloatArray, radius: FloatArray, medium: float, tissue: float
) -> FloatArray:
    """Return the coefficient of diffusion at the nodes over that of tissue.

    A node is tissue where cells fill half of it or more; up to there the coefficient goes over
    linearly from that of the medium. (Packed tissue fills 0.6 to 0.9, counted as free spheres.)
    """
    filling = layout.scatter(position, SPHERE * radius**3)
    share = np.minimum(filling / _TISSUE, 1.0)
    return np.asarray((medium + (tissue - medium) * share) / tissue)


def restored(field: Field) -> tuple[Layout, FloatArray]:
    """Return the layout and the values of a field from a frame, bit for bit."""
    values = np.array(field.values, dtype=float)
    if field.kind == "radial":
        count = values.size
        return ShellLayout(np.array(field.origin), float(field.spacing), count), values.ravel()
    a, b, c = (float(x) for x in field.origin)
    nx, ny, nz = values.shape
    return BoxLayout(
        Box((a, b, c), (nx, ny, nz), float(field.spacing), field.height or None)
    ), values
