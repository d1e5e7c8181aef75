"""Regions in which a scene places cells at random, and how many cells have room there.

Cells are put one after another at places that are drawn uniformly over a region, and drawn anew
where a cell would come too near to one that is there already (random sequential addition). That
comes to an end at the saturation coverage of equal spheres, discs or rods, which is known.

References
----------
G. Zhang and S. Torquato, Phys. Rev. E 88 (2013) 053312: 0.38413 in space, 0.54707 in a plane;
A. Rényi, Publ. Math. Inst. Hung. Acad. Sci. 3 (1958) 109: 0.74760 along a line.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Final, NamedTuple, final

from multicell.errors import SceneError
from multicell.scene.sizes import birth_radius

if TYPE_CHECKING:
    from multicell.scene.initial import Initial
    from multicell.scene.scene import Scene

SATURATION: Final = {1: 0.74760, 2: 0.54707, 3: 0.38413}
"""Part of space that equal spheres (discs, rods) cover when no further one finds room."""
MAX_COVERAGE: Final = 0.8
"""Part of the saturation coverage up to which cells are put: close to it no place is found."""
_UNIT: Final = {1: 2.0, 2: math.pi, 3: 4.0 * math.pi / 3.0}
"""Length, area and volume of the unit ball in one, two and three dimensions."""
_RIM: Final = 1.0 - 0.5 / SATURATION[1]
"""Part of a diameter by which the room of cells is wider than a region of their centres, on each
side: exactly so of long lines (Rényi), and about so of surfaces."""

KEYS: Final[Mapping[str, tuple[str, ...]]] = {
    "ball": (),
    "random-ball": ("radius", "centre"),
    "random-disc": ("radius", "centre", "axis"),
    "random-shell": ("radius", "inner_radius", "centre"),
    "random-line": ("length", "centre", "axis"),
    "random-box": ("x", "y", "z"),
}
"""Keys of ``initial`` that each arrangement takes."""
NEEDED: Final = ("radius", "inner_radius", "length")
"""Those of them that have no default."""
OF_REGIONS: Final = ("radius", "inner_radius", "length", "centre", "axis", "x", "y", "z")


@final
class Region(NamedTuple):
    """A region in which centres of cells are drawn.

    Attributes
    ----------
    shape
        ``"ball"`` (in ``span`` axes: a disc in two), ``"shell"`` or ``"box"`` (a line in one axis).
    axes
        Indices of the axes along which the region extends.
    centre : µm
    lengths : µm
        Of a box along its axes; else inner and outer radius.
    """

    shape: str
    axes: tuple[int, ...]
    centre: tuple[float, float, float]
    lengths: tuple[float, ...]

    def measure(self, beyond: float = 0.0) -> float:
        """Return length, area or volume, with all that is nearer than ``beyond`` (µm) to it."""
        span = len(self.axes)
        if self.shape == "box":
            return _steiner(self.lengths, beyond)
        inner, outer = self.lengths
        hollow = max(inner - beyond, 0.0) if inner > 0.0 else 0.0
        return _UNIT[span] * ((outer + beyond) ** span - hollow**span)

    def half(self) -> tuple[float, float, float]:
        """Return half the sides of the box round the region, µm."""
        found = [0.0, 0.0, 0.0]
        for place, axis in enumerate(self.axes):
            box = self.shape == "box"
            found[axis] = 0.5 * self.lengths[place] if box else self.lengths[1]
        return found[0], found[1], found[2]


def _steiner(lengths: tuple[float, ...], beyond: float) -> float:
    """Return the measure of all that is within a distance of a box (Steiner's formula)."""
    if len(lengths) == 1:
        return lengths[0] + 2.0 * beyond
    area = math.prod(lengths)
    if len(lengths) == 2:
        return area + 2.0 * beyond * sum(lengths) + math.pi * beyond**2
    a, b, c = lengths
    faces, edges = 2.0 * (a * b + b * c + c * a), a + b + c
    return area + faces * beyond + math.pi * beyond**2 * edges + 4.0 / 3.0 * math.pi * beyond**3


def region(scene: Scene) -> Region | None:
    """Return where a scene puts its cells at random; None where it packs them."""
    initial, flat = scene.initial, scene.dimensions == 2
    if not initial.arrangement.startswith("random"):
        return None
    everywhere = (0, 1) if flat else (0, 1, 2)
    centre = initial.centre or (0.0, 0.0, 0.0)
    if initial.arrangement == "random-box":
        return _box(scene, everywhere)
    if initial.arrangement == "random-line":
        assert initial.length is not None
        return Region("box", ("xyz".index(initial.axis or "x"),), centre, (initial.length,))
    assert initial.radius is not None
    sizes = (initial.inner_radius or 0.0, initial.radius)
    if initial.arrangement == "random-disc":
        normal = "xyz".index(initial.axis or "z")
        across = tuple(axis for axis in range(3) if axis != normal)
        return Region("ball", across, centre, sizes)
    shape = "shell" if initial.arrangement == "random-shell" else "ball"
    return Region(shape, everywhere, centre, sizes)


def _box(scene: Scene, axes: tuple[int, ...]) -> Region:
    """Return the box that a scene names, along axes that it leaves out that of its domain."""
    ends = []
    for axis in ("xyz"[k] for k in axes):
        given = getattr(scene.initial, axis) or getattr(scene.domain, axis, None)
        if given is None:
            hint = f"For example {axis} = ['-100 um', '100 um'], or give the scene a [domain]."
            raise SceneError(f"initial.{axis}", "is missing: a box has all sides", hint)
        ends.append(given)
    middle = [0.5 * (low + high) for low, high in ends] + [0.0] * (3 - len(ends))
    lengths = tuple(high - low for low, high in ends)
    return Region("box", axes, (middle[0], middle[1], middle[2]), lengths)


def check_keys(initial: Initial) -> None:
    """Raise ``SceneError`` for keys that an arrangement lacks or has no use for."""
    allowed = KEYS[initial.arrangement]
    for name in OF_REGIONS:
        given = getattr(initial, name) is not None
        if given and name not in allowed:
            users = " or ".join(repr(kind) for kind, keys in KEYS.items() if name in keys)
            problem = f"has no effect with arrangement = {initial.arrangement!r}"
            raise SceneError(name, problem, f"It belongs to {users}.")
        if name in NEEDED and name in allowed and not given:
            hint = f"For example {name} = '100 um'."
            raise SceneError(name, f"is missing for arrangement = {initial.arrangement!r}", hint)
    if initial.arrangement.startswith("random") and initial.jitter > 0.0:
        hint = "Leave it out, or take a smaller spacing."
        raise SceneError("jitter", "has no effect: the cells are at random places already", hint)
    inner, outer = initial.inner_radius or 0.0, initial.radius or math.inf
    if not inner < outer:
        raise SceneError("inner_radius", f"is {inner:g} um, must be less than radius {outer:g} um")


def check_arrangement(scene: Scene) -> None:
    """Raise ``SceneError`` for a region that the scene has no room for, or too many cells for it.

    The room is foretold for newborn cells, the smallest; grown ones are seen to when they are put.
    """
    if scene.initial.arrangement == "ball":
        return
    if scene.dimensions == 2:
        _check_plane(scene.initial)
    refuse_too_dense(scene, 2.0 * birth_radius(scene))


def _check_plane(initial: Initial) -> None:
    """Check that a region lies in the plane z = 0."""
    if initial.centre is not None and initial.centre[2] != 0.0:
        raise SceneError("initial.centre", "leaves the plane z = 0 of a scene of 2 dimensions")
    if initial.z is not None:
        raise SceneError("initial.z", "does not exist in a scene of 2 dimensions")
    disc = initial.arrangement == "random-disc"
    if initial.axis in (("x", "y") if disc else ("z",)):
        hint = "A disc is across z, a line along x or y."
        raise SceneError("initial.axis", f"is '{initial.axis}' in a scene of 2 dimensions", hint)


def coverage(scene: Scene, diameter: float) -> float:
    """Return the part of the room in and round a region that cells cover.

    Cells count with their diameter, in µm, times ``spacing``: how far apart their centres are.
    """
    found = region(scene)
    if found is None:
        return 0.0
    span, apart = len(found.axes), scene.initial.spacing * diameter
    return scene.initial.count * _UNIT[span] * (0.5 * apart) ** span / found.measure(_RIM * apart)


def refuse_too_dense(scene: Scene, diameter: float) -> None:
    """Raise ``SceneError`` for more cells of a diameter in µm than find room."""
    found = region(scene)
    if found is None or scene.initial.count == 1:
        return
    most = MAX_COVERAGE * SATURATION[len(found.axes)]
    covered = coverage(scene, diameter)
    if covered > most:
        room = math.floor(scene.initial.count * most / covered)
        problem = (
            f"is {scene.initial.count:,}: at random places {scene.initial.spacing:g} diameters "
            f"apart about {room:,} cells find room in this region"
        )
        hint = "Take fewer cells, a larger region or a smaller initial.spacing; 'ball' packs them."
        raise SceneError("initial.count", problem, hint)
