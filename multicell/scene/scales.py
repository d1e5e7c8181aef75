"""Scales of a scene's fields: regime, spacing, lengths and times."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

from multicell.cells import SPHERE
from multicell.scene import domain as box
from multicell.scene.nutrient import Nutrient, Side
from multicell.scene.reactions import group_of
from multicell.scene.sizes import division_radius, typical_radius

if TYPE_CHECKING:
    from multicell.scene.scene import Scene

_SETTLED = 1.0
"""Largest diffusion time over coupling step at which ``auto`` takes a field as settled."""
_CHOSEN = 600.0  # s, which stands for a coupling step where the run chooses them

_POINTS = 5.0
"""Spacings in the diffusion length where the grid is chosen for the user."""

MAX_UNEVEN = 0.01
"""Difference of concentrations at the surface of round tissue along axes and along diagonals, over
that of the medium, from which on it is reported."""

MAX_NODES = 256**3
"""Largest grid that is ever laid: an array of it takes 128 MiB, a solve about fifteen of them."""


def level_fixed(nutrient: Nutrient, dimensions: int = 3, periodic: Sequence[str] = ()) -> bool:
    """Return whether sides, perfusion or decay fix the level of a steady field.

    A field that may go over from shells to a box needs it on both. There are no sides across the
    axes that are ``periodic``.
    """
    if nutrient.perfusion > 0.0 or nutrient.decay > 0.0:
        return True
    return touches_medium(nutrient, dimensions, periodic)


def touches_medium(nutrient: Nutrient, dimensions: int = 3, periodic: Sequence[str] = ()) -> bool:
    """Return whether a side is no wall, on every geometry that a field may have."""
    shells = nutrient.layout != "box" and dimensions == 3
    cubes = nutrient.layout != "radial"
    fixed = [
        any(_side(nutrient, face).type == "value" for face in faces)
        for faces, used in ((("r+",), shells), (_faces(dimensions), cubes))
        if used
    ]
    if periodic:
        sides = (face for face in _faces(dimensions) if face[0] not in periodic)
        return any(_side(nutrient, face).type == "value" for face in sides)
    return all(fixed)


def repeating(scene: Scene) -> tuple[str, ...]:
    """Return the axes along which the space of a scene repeats."""
    return () if scene.domain is None else scene.domain.periodic


def _faces(dimensions: int) -> tuple[str, ...]:
    return ("x-", "x+", "y-", "y+", "z-", "z+")[: 2 * dimensions]


def _side(nutrient: Nutrient, face: str) -> Side:
    """Return the condition on a face: its own, its axis', that of all, or the medium's value."""
    return next((nutrient.sides[k] for k in (face, face[0], "*") if k in nutrient.sides), Side())


@final
@dataclass(frozen=True)
class Scales:
    """The scales of a field, before anything is run.

    - ``demand``, float, mM/s: largest uptake per volume of tissue of typical cells without gaps; in
      a plane, per volume of the layer that they cover
    - ``depth``, float, µm: √(2 D c / q): how deep a thick tissue at the medium's concentration is
      fed (zeroth order); infinite without uptake
    - ``length``, float, µm: over which the field varies: ``depth`` or the tissue's radius,
      whichever is smaller, with the margin or the layer; in a fixed domain that of its slowest mode
    - ``time``, float, s: diffusion time, length² / D
    - ``damkohler``, float: uptake over diffusion, q R² / (D c), R the radius that the tissue may
      reach; above 6 a ball's centre starves
    """

    demand: float
    depth: float
    length: float
    time: float
    damkohler: float


def scales(scene: Scene, name: str) -> Scales:
    """Return the scales of a field of a scene."""
    nutrient = scene.nutrients[name]
    radius = typical_radius(scene)
    typical = SPHERE * radius**3
    room = typical if scene.dimensions == 3 else math.pi * radius**2 * layer_height(scene, name)
    demand = float(nutrient.largest_uptake(typical)) / room
    supply = nutrient.diffusion * nutrient.highest
    depth = math.sqrt(2.0 * supply / demand) if demand > 0.0 else math.inf
    radius = tissue_radius(scene)
    length = min(depth, radius) + (nutrient.margin if nutrient.layer is None else nutrient.layer)
    if scene.box is not None:
        length = slowest(nutrient, box.sides(scene.box), scene.box.periodic)
    damkohler = demand * radius**2 / supply if supply > 0.0 else math.inf
    return Scales(demand, depth, length, length**2 / nutrient.diffusion, damkohler)


def slowest(nutrient: Nutrient, lengths: list[float], periodic: Sequence[str] = ()) -> float:
    """Return the length 1/|k| of the slowest mode of diffusion in a box, µm.

    Along an axis of length L it has k = π/L between two values, π/2L between a value and a wall,
    and 0 between walls and where space repeats.
    """
    square = 0.0
    for axis, length in zip("xyz", lengths, strict=False):
        fixed = sum(_side(nutrient, axis + end).type == "value" for end in "-+")
        fixed = 0 if axis in periodic else fixed
        square += (0.5 * math.pi * fixed / length) ** 2
    return 1.0 / math.sqrt(square) if square > 0.0 else max(lengths) / math.pi


def tissue_radius(scene: Scene) -> float:
    """Return the radius in µm of a ball (disc) of as many cells as there may be in the end."""
    cells = float(scene.initial.count)
    if scene.growth is not None:
        doublings = min(scene.duration / scene.growth.mean_cycle, 60.0)
        cells = min(cells * 2.0**doublings, float(scene.stop_cells or 1e6))
    return float(typical_radius(scene) * cells ** (1.0 / scene.dimensions))


def layer_reach(scene: Scene, name: str, radius: float) -> float:
    """Return how far the margin reaches from the middle of a ball (disc) of tissue, both in µm.

    It is counted from the outermost centres of cells.
    """
    return max(radius - typical_radius(scene), 0.0) + scene.nutrients[name].margin


def layer_height(scene: Scene, name: str) -> float:
    """Return the height in µm of the layer that a field in a plane fills."""
    return scene.nutrients[name].height or 2.0 * division_radius(scene)


def regime(scene: Scene, name: str) -> str:
    """Return ``"steady"`` or ``"transient"``, whichever a field is solved as.

    ``auto`` takes the steady state where diffusion settles within a coupling step (ten minutes
    where the run chooses its steps), and where there is a steady state at all. Fields that take
    part in reactions it takes as transient, however fast they diffuse: reactions may be slow.
    """
    nutrient = scene.nutrients[name]
    group = group_of(name, scene.reactions)
    if group:
        given = [scene.nutrients[other].regime for other in group]
        return next((x for x in given if x != "auto"), "transient")
    if nutrient.regime != "auto":
        return nutrient.regime
    step = scene.coupling_step if scene.coupling_tolerance is None else _CHOSEN
    settles = scales(scene, name).time <= _SETTLED * step
    fixed = level_fixed(nutrient, scene.dimensions, repeating(scene))
    return "steady" if settles and fixed else "transient"


def largest_spacing(scene: Scene, name: str) -> float:
    """Return the largest spacing of a field's grid, µm.

    Where the scene does not say: a fifth of the depth to which tissue is fed, but neither above
    the diameter of a dividing cell nor below half of it, since cells are the sources. Of fields
    that react with each other those without a spacing have that of the others, or the smallest.
    """
    group = [name, *group_of(name, scene.reactions)]
    given = [scene.nutrients[other].spacing for other in group]
    stated = [x for x in given if x is not None]
    if stated:
        return stated[0]
    depth = min(scales(scene, other).depth for other in group)
    diameter = 2.0 * division_radius(scene)
    return max(min(depth / _POINTS, diameter), 0.5 * diameter)
