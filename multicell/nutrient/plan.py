"""What the fields of a scene amount to: whether they fit together, their order, regime, scales.

Light: nothing here loads a grid, so that a scene can be read and explained at once.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

from multicell import domain as box
from multicell.cells import SPHERE
from multicell.errors import SceneError
from multicell.parameters import near_miss

if TYPE_CHECKING:
    from multicell.nutrient.parts import Nutrient, Side
    from multicell.parts import Domain
    from multicell.scene import Scene

_SETTLED = 1.0
"""Largest diffusion time over coupling step at which ``auto`` takes a field as settled."""

_POINTS = 5.0
"""Spacings in the diffusion length where the grid is chosen for the user."""

MAX_NODES = 256**3
"""Largest grid that is ever laid: an array of it takes 128 MiB, a solve about fifteen of them."""

_FINEST = 0.001
"""Least spacing of a grid over the radius of a dividing cell: below, cells are points to it."""


def check_nutrients(scene: Scene) -> None:
    """Raise ``SceneError`` for fields that do not fit together or to the rest of the scene."""
    for name, nutrient in scene.nutrients.items():
        path = f"nutrients.{name}"
        _check_names(scene, path, nutrient)
        _check_spacing(scene, path, nutrient)
        _check_sides(scene, path, nutrient)
        _check_medium(path, nutrient)
        _check_layer(path, nutrient)
        if scene.domain is not None:
            _check_in_domain(scene, name)
    solving_order(scene.nutrients)


def _check_names(scene: Scene, path: str, nutrient: Nutrient) -> None:
    """Check that fields which a field refers to exist."""
    for key in ("uptake_on", "secretion_from"):
        for other in getattr(nutrient, key) or ():
            if other not in scene.nutrients:
                hint = near_miss(other, scene.nutrients)
                raise SceneError(f"{path}.{key}.{other}", "is not a field of this scene", hint)
    if nutrient.uptake_on and nutrient.uptake == 0.0:
        hint = "Give an uptake, or remove uptake_on."
        raise SceneError(f"{path}.uptake_on", "has no effect: uptake is zero", hint)
    for other in nutrient.secretion_from or ():
        if scene.nutrients[other].uptake == 0.0:
            hint = "What is secreted from a field's uptake needs that uptake."
            raise SceneError(f"{path}.secretion_from.{other}", "is a field with no uptake", hint)


def _check_spacing(scene: Scene, path: str, nutrient: Nutrient) -> None:
    widest = 4.0 * scene.cells.division_radius
    if nutrient.spacing is not None and nutrient.spacing > widest:
        problem = (
            f"is {nutrient.spacing:g} um, must be at most {widest:g} um "
            "(two diameters of a dividing cell): grid too coarse for its cells"
        )
        raise SceneError(f"{path}.spacing", problem, "Take about one diameter.")
    finest = _FINEST * scene.cells.division_radius
    if nutrient.spacing is not None and nutrient.spacing < finest:
        problem = f"is {nutrient.spacing:g} um, must be at least {finest:g} um: finer than any cell"
        raise SceneError(f"{path}.spacing", problem, "Take about one diameter.")


def _check_sides(scene: Scene, path: str, nutrient: Nutrient) -> None:
    """Check that the sides exist in the scene's dimensions and that something fixes the level."""
    flat = scene.dimensions == 2
    if flat and nutrient.geometry == "radial":
        hint = "In two dimensions fields live on a grid of squares."
        raise SceneError(f"{path}.geometry", "is 'radial' in a scene of 2 dimensions", hint)
    for face in nutrient.sides:
        if flat and (face.startswith("z") or face == "r+"):
            problem = "does not exist in a scene of 2 dimensions"
            raise SceneError(f"{path}.sides.{face}", problem, "Use 'x-' to 'y+' or '*'.")
    if not level_fixed(nutrient, scene.dimensions):
        if nutrient.regime == "steady":
            hint = "Give one side a value, or a perfusion, or let the field be 'transient'."
            raise SceneError(f"{path}.sides", "fix no level: no steady state is defined", hint)
        if nutrient.initial == "steady":
            problem = "is 'steady', but the sides fix no level: there is no steady state"
            hint = "Start from 'medium', or give one side a value, or a perfusion."
            raise SceneError(f"{path}.initial", problem, hint)
    shaped = {face for face in nutrient.sides if face not in ("*", "r+")}
    if nutrient.geometry == "auto" and shaped:
        hint = "Take geometry = 'box', or only '*'."
        face = min(shaped)
        raise SceneError(f"{path}.sides.{face}", "is not the same all round", hint)


def _check_medium(path: str, nutrient: Nutrient) -> None:
    if nutrient.media is not None and nutrient.media[0][0] < 0.0:
        raise SceneError(f"{path}.media", f"begins at {nutrient.media[0][0]:g} s, before the run")


def _check_layer(path: str, nutrient: Nutrient) -> None:
    """Check that a layer lies round shells: only there it is as thick everywhere."""
    if nutrient.layer is not None and nutrient.geometry != "radial":
        problem = f"has no meaning with geometry = '{nutrient.geometry}'"
        hint = (
            "The layer of a ball needs geometry = 'radial'; a grid of cubes has its faces at "
            "'margin' from the outermost centres, farther at the corners."
        )
        raise SceneError(f"{path}.layer", problem, hint)


def _check_in_domain(scene: Scene, name: str) -> None:
    """Check that a field can live on the box that the scene fixes."""
    path, nutrient, domain = f"nutrients.{name}", scene.nutrients[name], scene.domain
    assert domain is not None
    if nutrient.geometry != "box":
        problem = f"is '{nutrient.geometry}' in a scene with a domain, which is a box"
        raise SceneError(f"{path}.geometry", problem, "Take geometry = 'box', or leave domain out.")
    wanted, lengths = spacing(scene, name), box.sides(domain)
    if math.prod(max(length / wanted, 2.0) for length in lengths) > MAX_NODES:
        problem = f"is {wanted:g} um: the domain would need more than {MAX_NODES} nodes"
        raise SceneError(f"{path}.spacing", problem, "Take a larger spacing or a smaller domain.")
    found = box.filling(lengths, wanted)
    if found is None:
        whole = [abs(length / wanted - round(length / wanted)) for length in lengths]
        axis = "xyz"[whole.index(max(whole))]
        given = " x ".join(f"{length:g}" for length in lengths)
        problem = (
            f"makes a box of {given} um, which no cubes of {0.25 * wanted:.3g} to {wanted:.3g} um "
            f"fill (the spacing of {name})"
        )
        fit = max(round(lengths["xyz".index(axis)] / wanted), 2) * wanted
        hint = f"Take lengths that are multiples of one spacing, here for example {fit:.6g} um."
        raise SceneError(f"domain.{axis}", problem, hint)
    if math.prod(found) > MAX_NODES:
        problem = f"makes a grid of {math.prod(found)} nodes, more than the {MAX_NODES} allowed"
        hint = "Take lengths that are multiples of one larger spacing."
        raise SceneError("domain", problem, hint)


def level_fixed(nutrient: Nutrient, dimensions: int = 3) -> bool:
    """Return whether sides, perfusion or decay fix the level of a steady field.

    A field that may go over from shells to a box needs it on both.
    """
    if nutrient.perfusion > 0.0 or nutrient.decay > 0.0:
        return True
    shells = nutrient.geometry != "box" and dimensions == 3
    cubes = nutrient.geometry != "radial"
    fixed = [
        any(_side(nutrient, face).type != "derivative" for face in faces)
        for faces, used in ((("r+",), shells), (_faces(dimensions), cubes))
        if used
    ]
    return all(fixed)


def _faces(dimensions: int) -> tuple[str, ...]:
    return ("x-", "x+", "y-", "y+", "z-", "z+")[: 2 * dimensions]


def _side(nutrient: Nutrient, face: str) -> Side:
    """Return the condition on a face: its own, its axis', that of all, or the medium's value."""
    from multicell.nutrient.parts import Side

    for key in (face, face[0], "*"):
        if key in nutrient.sides:
            return nutrient.sides[key]
    return Side()


def solving_order(nutrients: Mapping[str, Nutrient]) -> list[str]:
    """Return the names of the fields so that each comes after those that it depends on.

    Raises
    ------
    SceneError
        For fields that depend on each other in a circle.
    """
    from graphlib import CycleError, TopologicalSorter

    needs = {
        name: [*nutrient.uptake_on, *(nutrient.secretion_from or ())]
        for name, nutrient in nutrients.items()
    }
    try:
        return list(TopologicalSorter(needs).static_order())
    except CycleError as error:
        circle = list(reversed(error.args[1]))
        problem = f"depends on itself: {' needs '.join(circle)}"
        hint = "Fields are solved one after another; leave out the weakest dependence."
        raise SceneError(f"nutrients.{circle[0]}", problem, hint) from None


@final
@dataclass(frozen=True)
class Scales:
    """The scales of a field, before anything is run.

    Attributes
    ----------
    demand : float, mM/s
        Largest uptake per volume of tissue of typical cells without gaps.
    depth : float, µm
        √(2 D c / q): how deep a thick tissue at the medium's concentration is fed (zeroth
        order); infinite without uptake.
    length : float, µm
        Over which the field varies: ``depth`` or the tissue's radius, whichever is smaller,
        with the margin or the layer; in a fixed domain that of its slowest mode.
    time : float, s
        Diffusion time, length² / D.
    damkohler : float
        Uptake over diffusion, q R² / (D c), R the radius that the tissue may reach; above 6 a
        ball's centre starves.
    """

    demand: float
    depth: float
    length: float
    time: float
    damkohler: float


def scales(scene: Scene, name: str) -> Scales:
    """Return the scales of a field of a scene."""
    nutrient = scene.nutrients[name]
    demand = nutrient.uptake / (SPHERE * _typical_radius(scene) ** 3)
    supply = nutrient.diffusion * nutrient.highest
    depth = math.sqrt(2.0 * supply / demand) if demand > 0.0 else math.inf
    radius = tissue_radius(scene)
    length = min(depth, radius) + (nutrient.margin if nutrient.layer is None else nutrient.layer)
    if scene.domain is not None:
        length = _slowest(nutrient, box.sides(scene.domain))
    damkohler = demand * radius**2 / supply if supply > 0.0 else math.inf
    return Scales(demand, depth, length, length**2 / nutrient.diffusion, damkohler)


def _slowest(nutrient: Nutrient, lengths: list[float]) -> float:
    """Return the length 1/|k| of the slowest mode of diffusion in a box, µm.

    Along an axis of length L it has k = π/L between two values, π/2L between a value and a wall,
    and 0 between walls. A mixed condition is a value behind a layer as thick as 1/rate.
    """
    square = 0.0
    for axis, length in zip("xyz", lengths, strict=False):
        ends = [_side(nutrient, axis + end) for end in "-+"]
        fixed = [side for side in ends if side.type != "derivative"]
        across = length + sum(1.0 / side.rate for side in fixed if side.rate is not None)
        square += (0.5 * math.pi * len(fixed) / across) ** 2
    return 1.0 / math.sqrt(square) if square > 0.0 else max(lengths) / math.pi


def tissue_radius(scene: Scene) -> float:
    """Return the radius in µm of a ball of as many cells as there may be in the end."""
    cells = float(scene.initial.count)
    if scene.growth is not None:
        doublings = min(scene.duration / scene.growth.mean_cycle, 60.0)
        cells = min(cells * 2.0**doublings, float(scene.stop_cells or 1e6))
    return float(_typical_radius(scene) * cells ** (1.0 / 3.0))


def _typical_radius(scene: Scene) -> float:
    """Return the radius of a typical cell of the scene, µm."""
    from multicell.pairs import typical_radius

    return float(typical_radius(scene))


def regime(scene: Scene, name: str) -> str:
    """Return ``"steady"`` or ``"transient"``, whichever a field is solved as.

    ``auto`` takes the steady state where diffusion settles within a coupling step, and where
    there is a steady state at all.
    """
    nutrient = scene.nutrients[name]
    if nutrient.regime != "auto":
        return nutrient.regime
    settles = scales(scene, name).time <= _SETTLED * scene.coupling_step
    fixed = level_fixed(nutrient, scene.dimensions)
    return "steady" if settles and fixed else "transient"


def spacing(scene: Scene, name: str) -> float:
    """Return the largest spacing of a field's grid, µm.

    Where the scene does not say: a fifth of the depth to which tissue is fed, but neither above
    the diameter of a dividing cell nor below half of it, since cells are the sources.
    """
    nutrient = scene.nutrients[name]
    if nutrient.spacing is not None:
        return nutrient.spacing
    diameter = 2.0 * scene.cells.division_radius
    return max(min(scales(scene, name).depth / _POINTS, diameter), 0.5 * diameter)


@final
@dataclass(frozen=True)
class FieldParameters:
    """What :class:`multicell.nutrient.field.NutrientField` asks for, from a scene."""

    nutrient: Nutrient
    spacing: float
    height: float
    regime: str
    dimensions: int
    domain: Domain | None = None

    @classmethod
    def of(cls, scene: Scene, name: str) -> FieldParameters:
        """Return the parameters of a field of a scene."""
        nutrient = scene.nutrients[name]
        height = nutrient.height or 2.0 * scene.cells.division_radius
        return cls(
            nutrient, spacing(scene, name), height, regime(scene, name), scene.dimensions,
            scene.domain,
        )  # fmt: skip

    @property
    def diffusion(self) -> float:
        """Diffusion coefficient in tissue, µm²/s."""
        return self.nutrient.diffusion

    @property
    def diffusion_medium(self) -> float | None:
        """Diffusion coefficient outside tissue, µm²/s; None: as inside."""
        return self.nutrient.diffusion_medium

    @property
    def half_saturation(self) -> float:
        """Michaelis constant of uptake, mM."""
        return self.nutrient.half_saturation

    @property
    def margin(self) -> float:
        """Least distance from a cell's centre to the faces, µm."""
        return self.nutrient.margin

    @property
    def layer(self) -> float | None:
        """Distance of the shells' surface from the tissue's, µm; None: by the margin."""
        return self.nutrient.layer

    @property
    def decay(self) -> float:
        """Rate of decay, 1/s."""
        return self.nutrient.decay

    @property
    def perfusion(self) -> float:
        """Rate of exchange with the medium, 1/s."""
        return self.nutrient.perfusion

    @property
    def geometry(self) -> str:
        """``"box"``, ``"radial"`` or ``"auto"``; always a box in two dimensions."""
        return self.nutrient.geometry if self.dimensions == 3 else "box"

    @property
    def roundness_limit(self) -> float:
        """Departure from a ball up to which shells are enough."""
        return self.nutrient.roundness_limit

    @property
    def time_tolerance(self) -> float:
        """Error of a transient step over the concentration."""
        return self.nutrient.time_tolerance

    @property
    def initial(self) -> str:
        """Where a transient field starts from: ``"medium"`` or ``"steady"``."""
        return self.nutrient.initial

    @property
    def highest(self) -> float:
        """The highest concentration that medium and sides ever have, mM."""
        return self.nutrient.highest

    def medium(self, time: float) -> float:
        """Return the concentration of the medium at a time in s, mM."""
        return self.nutrient.medium(time)

    def switches(self, begin: float, end: float) -> list[float]:
        """Return the times strictly between two times at which the medium is changed, s."""
        return self.nutrient.switches(begin, end)

    def sides(self, time: float) -> dict[str, Side]:
        """Return the condition on every face at a time, with the medium's value filled in."""
        from dataclasses import replace

        medium = self.medium(time)
        faces = ("r+", *_faces(self.dimensions))
        found = {face: _side(self.nutrient, face) for face in faces}
        return {
            face: side
            if side.type == "derivative" or side.value is not None
            else replace(side, value=medium)
            for face, side in found.items()
        }
