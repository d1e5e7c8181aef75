"""Layouts of a field: a box of cubes, a plane of squares, or a ball of shells.

Each layout spreads amounts of the cells over its nodes, interpolates at the cells, takes over the
values of the layout before it, and makes the operator that solves on it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from dataclasses import field as part_of_data
from functools import cached_property
from typing import TYPE_CHECKING, Any, cast, final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import SPHERE, FloatArray
from multicell.errors import NutrientFailed
from multicell.nutrient import balls, faces
from multicell.nutrient.cartesian import Box, covered_fractions, extent, fill, lay, mesh, moved
from multicell.vectors import corners, cubes, lengths, squares, weighted_mean

if TYPE_CHECKING:
    from multicell.results.frame import Field
    from multicell.scene.parts import Domain


_ROUNDING = 1e-6
"""Part of the spacing by which what is brought to a face stays inside of it."""

_ROUNDED = 1e-14
"""Part of a field's largest value up to which a reading on a face is zero but for rounding."""

_TISSUE = 0.5
"""Part of a node's volume that is cells from which on it is tissue."""


_CUBE = 1.14445
"""Harmonic radius of a cube seen from its middle, over half its edge.

The harmonic function with the values 1/|x| on the faces is 1 / 1.14445 there (half edge 1; by its
series of sines).
"""


@final
@dataclass(frozen=True)
class BoxLayout:
    """A box of cubes, or a plane of squares, round the cells.

    - ``threads``: how many may share the loops over many cells; it changes no result
    """

    box: Box
    threads: int = part_of_data(default=1, compare=False)
    _known: dict[str, Any] = part_of_data(
        default_factory=dict, init=False, repr=False, compare=False
    )
    kind = "box"

    @classmethod
    def round(
        cls,
        position: FloatArray,
        margin: float,
        spacing: float,
        height: float | None,
        threads: int = 1,
    ) -> BoxLayout:
        """Lay it ``margin`` beyond the outermost cells; flat where ``height`` is given."""
        low, high = extent(position, margin)
        return cls(lay(low, high, spacing, height), threads)

    @classmethod
    def within(
        cls, domain: Domain, spacing: float, height: float | None, threads: int = 1
    ) -> BoxLayout:
        """Lay it on a box that stands still, the faces on its sides."""
        low, high = (np.array(corner) for corner in domain.corners())
        return cls(fill(low, high, spacing, height, domain.repeats), threads)

    @property
    def spacing(self) -> float:
        """Distance of neighbouring nodes, µm."""
        return self.box.spacing

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of an array of the nodes."""
        return self.box.shape

    @property
    def volumes(self) -> float:
        """Volume of each node, µm³."""
        return self.box.volume

    @property
    def whole(self) -> float:
        """Volume of all nodes, µm³."""
        return float(np.sum(np.broadcast_to(self.volumes, self.shape)))

    def nearest(self, position: FloatArray) -> FloatArray:
        """Return the points of the box nearest to positions (n, 3) in µm; those inside stay."""
        if len(position) == 0:
            return position
        lowest, highest = corners(position)
        rounding, found = _ROUNDING * self.spacing, position  # which must leave no point outside
        for axis, low, high in zip(
            range(self._axes), self.box.origin, self.box.upper, strict=False
        ):
            if self.box.repeats[axis]:
                continue
            if lowest[axis] >= low and highest[axis] <= high:
                continue
            found = position.copy() if found is position else found
            x = position[:, axis]
            clipped = np.clip(x, low + rounding, high - rounding)
            found[:, axis] = np.where((x >= low) & (x <= high), x, clipped)
        return found

    def keep(self, position: FloatArray, radius: FloatArray) -> None:
        """Place cells once, in arrays that nobody will write to, for all that comes with these."""
        if not self._repeats and self._at(position, radius) is None:
            self._known["cells"] = position, radius, balls.placed(self.box, position, radius)

    def _at(self, position: FloatArray, radius: FloatArray | None) -> balls.Placed | None:
        where, width, found = self._known.get("cells", (None, None, None))
        return found if where is position and width is radius else None

    def scatter(
        self, position: FloatArray, amount: FloatArray, radius: FloatArray | None = None
    ) -> FloatArray:
        """Spread amounts of the cells, (n,), over the nodes as densities; absent radii: points."""
        if not self._repeats:
            known = self._at(position, radius)
            return balls.scatter(self.box, position, amount, radius, self.threads, known)
        wider, layers = self._unrolled(self._reach(radius))
        density = balls.scatter(wider.box, self._inside(position), amount, radius, self.threads)
        for axis, more in enumerate(layers):
            if more:
                n, v = self.box.shape[axis], np.moveaxis(density, axis, 0)
                found = np.zeros((n, *v.shape[1:]))
                np.add.at(found, (np.arange(len(v)) - more) % n, v)
                density = np.moveaxis(found, 0, axis)
        return np.ascontiguousarray(density)

    def gather(
        self, position: FloatArray, values: FloatArray, radius: FloatArray | None = None
    ) -> FloatArray:
        """Return the means over cells at positions (n, 3) in µm, or what is there at points."""
        if self._repeats:
            wider, layers = self._unrolled(self._reach(radius))
            return wider.gather(self._inside(position), _wrapped(values, layers), radius)
        known = self._at(position, radius)
        return balls.gather(self.box, position, values, radius, self.threads, known)

    def read(
        self,
        position: FloatArray,
        values: FloatArray,
        conditions: Mapping[str, Any],
        radius: FloatArray | None = None,
    ) -> FloatArray:
        """Do the same, but between the last nodes and the faces, and beyond, by the conditions."""
        if self._repeats:
            wider, ends = self._unrolled(self._reach(radius))
            unrolled = _wrapped(values, ends)
            return wider.read(self._inside(position), unrolled, conditions, radius)
        known = self._at(position, radius)
        found, some = balls.gathered(self.box, position, values, radius, self.threads, known)
        if some:
            widest = 0.0 if radius is None else float(radius.max()) / self.spacing
            near, layers = self._nearer_than(widest + 0.5, position), math.ceil(widest + 0.5)
            axes = "xyz"[: self._axes]
            padded = faces.by_condition(values, conditions, self.spacing, axes, layers)
            those = None if radius is None else radius[near]
            there = self._gather_padded(position[near], padded, those)
            # on a face at zero equal weights cancel but for rounding
            rounding = _ROUNDED * float(np.abs(padded).max())
            found[near] = np.where(np.abs(there) <= rounding, np.maximum(there, 0.0), there)
        return found

    def gradient(self, position: FloatArray, values: FloatArray) -> FloatArray:
        """Return the gradient at positions (n, 3) in µm: differences over one spacing.

        Exact for parabolas, up to the faces: there the values are extrapolated.
        """
        if self._repeats:
            wider, layers = self._unrolled(2)
            return wider.gradient(self._inside(position), _wrapped(values, layers))
        near = self._nearer_than(1.0, position)
        result = np.zeros(position.shape)
        result[~near] = self._differences(position[~near], values, self.gather)
        if near.any():
            self.gather(position[near], values)  # refuses what lies outside
            padded = faces.by_parabola(values, self._axes)
            result[near] = self._differences(position[near], padded, self._gather_padded)
        return result

    @cached_property
    def _repeats(self) -> bool:
        return any(self.box.repeats)

    def _reach(self, radius: FloatArray | None) -> int:
        """Return how many nodes beyond a face a cell on it may reach."""
        widest = 0.0 if radius is None else float(radius.max(initial=0.0))
        return math.ceil(widest / self.spacing + 0.5) + 1

    def _unrolled(self, more: int) -> tuple[BoxLayout, tuple[int, ...]]:
        """Return a wider box, with nodes more at the ends where space repeats, and how many."""
        box, h = self.box, self.spacing
        layers = tuple(more if repeats else 0 for repeats in box.repeats)
        x, y, z = (o - m * h for o, m in zip(box.origin, layers, strict=True))
        nx, ny, nz = (n + 2 * m for n, m in zip(box.shape, layers, strict=True))
        return BoxLayout(Box((x, y, z), (nx, ny, nz), h, box.height), self.threads), layers

    def _inside(self, position: FloatArray) -> FloatArray:
        """Return the images of positions (n, 3) that lie in the box, along axes that repeat."""
        found = np.array(position, dtype=float)
        for axis, (low, n) in enumerate(zip(self.box.origin, self.box.shape, strict=True)):
            if self.box.repeats[axis]:
                length = n * self.spacing
                found[:, axis] -= length * np.floor((found[:, axis] - low) / length)
        return found

    @property
    def _axes(self) -> int:
        return 3 if self.box.height is None else 2

    def _nearer_than(self, share: float, position: FloatArray) -> NDArray[np.bool_]:
        """Return which positions are nearer to a face than a share of the spacing."""
        box, axes = self.box, self._axes
        u = (position[:, :axes] - np.array(box.origin[:axes])) / box.spacing
        inside = (u >= share) & (u <= np.array(box.shape[:axes]) - share)
        return np.asarray(~inside.all(axis=1))

    def _gather_padded(
        self, position: FloatArray, padded: FloatArray, radius: FloatArray | None = None
    ) -> FloatArray:
        """Do what :meth:`gather` does with values that have more nodes at all ends of axes."""
        old, (nx, ny, nz) = self.box, padded.shape
        x, y, z = (
            o - 0.5 * (n - m) * old.spacing
            for o, n, m in zip(old.origin, padded.shape, old.shape, strict=True)
        )
        box = Box((x, y, z), (nx, ny, nz), old.spacing, old.height)
        return balls.gather(box, position, padded, radius)

    def _differences(
        self,
        position: FloatArray,
        values: FloatArray,
        gather: Callable[[FloatArray, FloatArray], FloatArray],
    ) -> FloatArray:
        h = self.spacing
        result = np.zeros(position.shape)
        for axis in range(self._axes):
            offset = np.zeros(3)
            offset[axis] = 0.5 * h
            ahead, behind = (gather(position + s * offset, values) for s in (1, -1))
            result[:, axis] = (ahead - behind) / h
        return result

    def filled(self, value: float) -> FloatArray:
        """Return an array of the nodes."""
        return np.full(self.box.shape, value)

    def guess(self, values: FloatArray, old: Layout, fill: float) -> FloatArray:
        """Return about the values of another layout, and ``fill`` outside it."""
        if not isinstance(old, BoxLayout):
            return self._from_shells(values, old, fill)
        if old.box.shape == self.box.shape:
            return values  # nodes move with the tissue: as good a guess, measured
        return moved(values, old.box, self.box, fill, self.threads)

    def carried(self, values: FloatArray, old: Layout, fill: float) -> FloatArray:
        """Return the values of another layout, each as often as it overlaps: amounts stay."""
        if not isinstance(old, BoxLayout):
            return self._from_shells(values, old, fill)
        x, y, z = covered_fractions(old.box, self.box)
        inside = np.einsum("il,jm,kn,lmn->ijk", x, y, z, values, optimize=True)
        covered = [w.sum(axis=1) for w in (x, y, z)]
        share = covered[0][:, None, None] * covered[1][None, :, None] * covered[2]
        return np.asarray(inside + fill * (1.0 - share))

    def _from_shells(self, values: FloatArray, old: Layout, fill: float) -> FloatArray:
        box = self.box
        points = mesh(box.axes())
        assert isinstance(old, ShellLayout)
        inside = lengths(points - old.centre) <= old.radius
        out = np.full(len(points), fill)
        out[inside] = old.gather(points[inside], values)
        return out.reshape(box.shape)

    def field(self, name: str, values: FloatArray) -> Field:
        """Return a field for frames."""
        from multicell.results.frame import Field

        box = self.box
        return Field(
            name=name,
            unit="mM",
            origin=np.array(box.origin),
            spacing=box.spacing,
            values=values,
            height=box.height or 0.0,
            repeats=box.repeats,
        )


def _wrapped(values: FloatArray, layers: tuple[int, ...]) -> FloatArray:
    """Return values with so many nodes more at both ends of each axis, those from the other end."""
    return np.pad(values, [(more, more) for more in layers], mode="wrap")


def equivalent_ball_radius(position: FloatArray, radius: FloatArray) -> float:
    """Return the radius in µm of the uniform ball with the same radius of gyration.

    Weighted by volume and with the cells' own extent: half the diameter of the summary. It is
    exact for one cell and for a ball, and one cell that strays hardly changes it.
    """
    weight = cubes(radius)
    away = position - weighted_mean(position, weight)
    square = squares(away) + 0.6 * radius**2
    return float(np.sqrt(weighted_mean(square, weight) / 0.6))


@final
@dataclass(frozen=True, eq=False)
class ShellLayout:
    """A ball of shells round the cells' centre of mass."""

    centre: FloatArray
    spacing: float
    count: int
    _known: dict[str, Any] = part_of_data(default_factory=dict, init=False, repr=False)
    kind = "radial"

    @classmethod
    def round(
        cls,
        position: FloatArray,
        radius: FloatArray,
        margin: float,
        spacing: float,
        layer: float | None = None,
        follows: bool = False,
    ) -> ShellLayout:
        """Lay it ``margin`` or more beyond the outermost cell; ``spacing`` is adapted.

        Its surface is that of the ball which lets as much through to its middle as the cube
        that would be laid round the same cells: how a tissue is fed does not depend on the
        geometry of the grid. Where the layer ``follows`` the tissue it is where it ends on that
        (:mod:`multicell.nutrient.layer`), in the mean over directions. With a ``layer`` the
        surface lies so far beyond the tissue's, that of the ball with the same radius of gyration,
        or where the outermost centre is if that is farther.
        """
        if len(position) == 0:
            return cls.to(np.zeros(3), (margin or spacing) if layer is None else layer, spacing)
        if not np.isfinite(position).all():
            extent(position, margin)  # raises with words
        centre = weighted_mean(position, cubes(radius))
        outermost = float(np.sqrt(squares(position - centre).max()))
        if layer is None and follows:
            from multicell.nutrient.layer import mean_end

            outer = max(mean_end(position - centre, radius, margin), outermost)
        elif layer is None:
            low, high = extent(position, margin)
            outer = max(outermost + margin, _CUBE * 0.5 * float((high - low).mean()))
        else:
            outer = max(equivalent_ball_radius(position, radius) + layer, outermost)
        return cls.to(centre, outer, spacing)

    @classmethod
    def to(cls, centre: FloatArray, outer: float, spacing: float) -> ShellLayout:
        """Lay it round a centre with a surface at a distance; ``spacing`` is adapted."""
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
    def shape(self) -> tuple[int, ...]:
        """Shape of an array of the shells."""
        return (self.count,)

    @cached_property
    def volumes(self) -> FloatArray:
        """Volumes of the shells, µm³."""
        return SPHERE * np.diff(np.linspace(0.0, self.radius, self.count + 1) ** 3)

    @cached_property
    def whole(self) -> float:
        """Volume of the ball, µm³."""
        return float(np.sum(self.volumes))

    def nearest(self, position: FloatArray) -> FloatArray:
        """Return the points of the ball nearest to positions (n, 3) in µm; those inside stay."""
        distance = self._distance(position)
        outside = distance > self.radius
        if not outside.any():
            return position
        found = position.copy()
        part = (self.radius / distance[outside])[:, None]
        found[outside] = self.centre + part * (position[outside] - self.centre)
        return found

    def keep(self, position: FloatArray, radius: FloatArray) -> None:
        """Weigh cells once, in arrays that nobody will write to, for all that comes with these."""
        self._known["cells"] = position, radius, self._cells(position, radius)

    def _cells(self, position: FloatArray, radius: FloatArray | None) -> balls.OnShells:
        where, width, found = self._known.get("cells", (None, None, None))
        if where is position and width is radius:
            return cast("balls.OnShells", found)
        return balls.OnShells.at(self.count, self.spacing, self._distance(position), radius)

    def scatter(
        self, position: FloatArray, amount: FloatArray, radius: FloatArray | None = None
    ) -> FloatArray:
        """Spread amounts of the cells, (n,), over the shells as densities; see the box's."""
        return np.asarray(self._cells(position, radius).scatter(amount) / self.volumes)

    def gather(
        self, position: FloatArray, values: FloatArray, radius: FloatArray | None = None
    ) -> FloatArray:
        """Return the means over cells at positions (n, 3) in µm, or what is there at points."""
        return self._cells(position, radius).gather(values, float(values[-1]))

    def read(
        self,
        position: FloatArray,
        values: FloatArray,
        conditions: Mapping[str, Any],
        radius: FloatArray | None = None,
    ) -> FloatArray:
        """Do the same, but beyond the last node by the condition on the surface."""
        const, factor = faces.ghost_terms(conditions, self.spacing)
        return self._cells(position, radius).gather(values, const + factor * float(values[-1]))

    def gradient(self, position: FloatArray, values: FloatArray) -> FloatArray:
        """Return the gradient at positions (n, 3) in µm: differences over one spacing.

        Along the radius, exact for parabolas of it, up to the surface: there the values are
        extrapolated. At the centre it is zero.
        """
        self.gather(position, values)  # refuses what lies outside
        h, distance = self.spacing, self._distance(position)
        mirrored = np.concatenate([values[:1], values])
        nodes = (np.arange(self.count + 2) - 0.5) * h
        known = np.append(mirrored, faces.extrapolate_face(mirrored[::-1]))
        ahead = np.interp(distance + 0.5 * h, nodes, known)
        behind = np.interp(np.abs(distance - 0.5 * h), nodes, known)
        outward = (position - self.centre) / np.where(distance > 0.0, distance, 1.0)[:, None]
        return np.asarray(((ahead - behind) / h)[:, None] * outward)

    def _distance(self, position: FloatArray) -> FloatArray:
        where, _, found = self._known.get("cells", (None, None, None))
        return found.distance if where is position else lengths(position - self.centre)

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
        points = mesh(old.box.axes())
        distance = lengths(points - self.centre)
        number, _ = np.histogram(distance, faces)
        total, _ = np.histogram(distance, faces, weights=values.ravel())
        filled = number > 0
        middles = 0.5 * (faces[1:] + faces[:-1])
        means = total[filled] / number[filled]
        return np.interp(middles, middles[filled], means) if filled.any() else self.filled(fill)

    def field(self, name: str, values: FloatArray) -> Field:
        """Return a field for frames."""
        from multicell.results.frame import Field

        return Field(
            name=name,
            unit="mM",
            origin=self.centre,
            spacing=self.spacing,
            values=values.reshape(-1, 1, 1),
            kind="radial",
        )


Layout = BoxLayout | ShellLayout
"""Nodes in space."""


def relative_diffusion(share: FloatArray, medium: float, tissue: float) -> FloatArray:
    """Return the coefficient of diffusion at the nodes over that of tissue.

    A node is tissue where cells fill half of its surroundings or more (:func:`tissue_share`, its
    ``share``); up to there the coefficient goes over linearly from that of the medium.
    """
    return np.asarray((medium + (tissue - medium) * share) / tissue)


_SURROUNDINGS = 2.0
"""Radius of the ball over which a cell's volume counts as filling, over the cell's own radius."""


def tissue_share(layout: Layout, position: FloatArray, radius: FloatArray) -> FloatArray:
    """Return the part of each node that counts as tissue: all of one that cells fill by half.

    The volume of each cell is spread over a ball of twice its radius, so that gaps between cells
    are part of the tissue, however fine the grid. (Packed tissue fills 0.6 to 0.9, counted as free
    spheres.)
    """
    filling = layout.scatter(position, SPHERE * cubes(radius), _SURROUNDINGS * radius)
    return np.asarray(np.minimum(filling / _TISSUE, 1.0))


def restored(field: Field, threads: int = 1) -> tuple[Layout, FloatArray]:
    """Return the layout and the values of a field from a frame, bit for bit."""
    values = np.array(field.values, dtype=float)
    if field.kind == "radial":
        count = values.size
        return ShellLayout(np.array(field.origin), float(field.spacing), count), values.ravel()
    a, b, c = (float(x) for x in field.origin)
    nx, ny, nz = values.shape
    box = Box((a, b, c), (nx, ny, nz), float(field.spacing), field.height or None, field.repeats)
    return BoxLayout(box, threads), values
