"""The fixed domain of a scene: whether it fits, how cubes fill a box, and who is outside.

Light: nothing here loads a grid or a kernel, so that a scene can be read and explained at once.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from multicell.contact.law import compliance
from multicell.errors import SceneError, StepFailed
from multicell.scene.pairs import largest_adhesion
from multicell.scene.sizes import division_radii

if TYPE_CHECKING:
    from multicell.cells import Cells, FloatArray, IntArray
    from multicell.mechanics.sphere import Sphere
    from multicell.mechanics.walls import Walls
    from multicell.scene.parts import Domain
    from multicell.scene.scene import Scene


_FINER = 4.0
"""How much finer than asked for a grid may be so that cubes fill the box."""

_WHOLE = 1e-10
"""Part of a side by which a number of whole cubes may miss it: rounding of its ends."""


def check_domain(scene: Scene, factor: float) -> None:
    """Raise ``SceneError`` for a box that does not fit to the scene's dimensions and cells.

    - ``factor``: the largest that responses put on surface energies
    """
    if scene.domain is None:
        return
    if scene.death is not None and scene.death.inflow:
        hint = "Walls would stop the medium: leave out inflow, or the domain."
        raise SceneError("death.inflow", "has no meaning in a domain", hint)
    widest = 2.0 * division_radii(scene)[1]
    if scene.domain.radius is not None:
        if scene.domain.radius < 0.5 * widest:
            problem = f"is {scene.domain.radius:g} um, must be at least {0.5 * widest:g} um"
            raise SceneError("domain.radius", problem, "A cell that divides must fit in.")
        return
    for axis in "xyz"[: scene.dimensions]:
        ends = getattr(scene.domain, axis)
        if ends is None:
            hint = f"For example {axis} = ['-100 um', '100 um']."
            raise SceneError(f"domain.{axis}", "is missing: a domain has all sides", hint)
        if axis not in scene.domain.periodic and ends[1] - ends[0] < widest:
            problem = f"is {ends[1] - ends[0]:g} um long, must be at least {widest:g} um"
            raise SceneError(f"domain.{axis}", problem, "A cell that divides must fit in.")
    if scene.domain.periodic:
        _check_periodic(scene, scene.domain, factor)


def _check_periodic(scene: Scene, domain: Domain, factor: float) -> None:
    """Raise ``SceneError`` for axes too short to repeat, and for parts that need a centre."""
    for axis in domain.periodic:
        if axis not in "xyz"[: scene.dimensions]:
            raise SceneError("domain.periodic", f"has {axis}, which 2 dimensions do not have")
        low, high = getattr(domain, axis)
        least = 2.0 * _interaction_range(scene, factor)
        if high - low < least:
            problem = f"is {high - low:g} um long, must be at least {least:.4g} um to repeat"
            hint = "No cell may be in reach of two images of another one."
            raise SceneError(f"domain.{axis}", problem, hint)
        for name, nutrient in scene.nutrients.items():
            for face in sorted({axis, axis + "-", axis + "+"} & set(nutrient.sides)):
                problem = f"has no meaning: space repeats along {axis}"
                raise SceneError(f"nutrients.{name}.sides.{face}", problem, "Leave it out.")
    for part in ("pull", "surface"):
        if getattr(scene, part) is not None:
            problem = "has no meaning where space repeats: tissue has neither centre nor rim there"
            raise SceneError(part, problem, "Leave it out, or domain.periodic.")
    if scene.compression is not None and len(set(domain.periodic)) < 3:
        hint = "Let all axes repeat, or none."
        raise SceneError("compression", "is not computed between walls where space repeats", hint)


def _interaction_range(scene: Scene, factor: float) -> float:
    """Return the largest distance at which two cells of a scene may act on each other, µm."""
    swelling = 1.0 if scene.death is None else scene.death.swelling
    largest = division_radii(scene)[1] * swelling ** (1.0 / 3.0)
    kinds = scene.types.values()
    young = min((kind.young or scene.cells.young for kind in kinds), default=scene.cells.young)
    softest = 0.5 / float(compliance(young, scene.cells.poisson))
    law = largest_adhesion(scene, factor)
    return 2.0 * float(law.list_radius(np.array([largest]), softest)[0])


def sides(domain: Domain) -> list[float]:
    """Return the lengths of the box along its axes, µm: two in two dimensions."""
    ends = (domain.x, domain.y, domain.z)
    return [high - low for low, high in (end for end in ends if end is not None)]


def filling(lengths: Sequence[float], spacing: float) -> tuple[int, ...] | None:
    """Return how many cubes of one size fill a box along each axis, at least two.

    Of all sizes up to ``spacing``, and not below a quarter of it, the largest is taken that fits
    into every length a whole number of times; None if there is none.

    - ``lengths``, µm
    - ``spacing``, float, µm
    """
    shortest = min(lengths)
    widest = min(spacing, 0.5 * shortest)
    least = math.ceil(shortest / widest * (1.0 - 1e-12))
    most = math.floor(_FINER * shortest / widest * (1.0 + 1e-12))
    number = np.arange(least, most + 1, dtype=float)
    counts = np.rint(np.asarray(lengths)[:, None] * number / shortest)
    missed = np.abs(counts * (shortest / number) / np.asarray(lengths)[:, None] - 1.0)
    fits = np.flatnonzero((missed <= _WHOLE).all(axis=0))
    return tuple(int(n) for n in counts[:, fits[0]]) if len(fits) else None


_WORTH_TELLING = 0.75
"""Part of the spacing that was asked for below which a grid that fits is reported."""


def finer(lengths: Sequence[float], spacing: float) -> str:
    """Return in words how much finer than asked for cubes are that fill a box; else nothing."""
    counts = filling(lengths, spacing)
    edge = lengths[0] / counts[0] if counts else spacing
    if edge >= _WORTH_TELLING * spacing:
        return ""
    size = " x ".join(f"{length:g}" for length in lengths)
    return (
        f"{edge:.4g} um instead of {spacing:.4g} um, {(spacing / edge) ** len(lengths):.3g} times "
        f"as many nodes: nothing between fits into all sides of {size} um a whole number of times"
    )


def walls(scene: Scene) -> Walls | Sphere | None:
    """Return the walls of a scene; where there are none, nothing is loaded."""
    domain = scene.domain
    if domain is None:
        return None
    young = scene.cells.young if domain.young is None else domain.young
    poisson = scene.cells.poisson if domain.poisson is None else domain.poisson
    soft = float(compliance(young, poisson))
    if domain.radius is not None:
        from multicell.mechanics.sphere import Sphere

        # an incompressible gel: E = 3 G
        return Sphere(domain.radius, soft, domain.stiffness and domain.stiffness / 3.0)
    from multicell.mechanics.walls import Walls

    low, high = domain.sides()
    return Walls(low, high, soft) if np.isfinite(low).any() else None


def check_start(scene: Scene, cells: Cells) -> None:
    """Raise ``SceneError`` for a cell that starts outside the scene's domain."""
    found = None if scene.domain is None else strayed(scene.domain, cells.position)
    if found is not None:
        cell, side = found
        place = ", ".join(f"{x:g}" for x in cells.position[cell])
        problem = f"is too small: cell {cells.id[cell]} starts at ({place}) um, beyond side {side}"
        hint = "Widen the domain, or start with fewer cells."
        key = side[0] if scene.box is not None else "radius"
        raise SceneError(f"domain.{key}", problem, hint)


def check_inside(domain: Domain | None, ids: IntArray, position: FloatArray, time: float) -> None:
    """Raise ``StepFailed`` where a centre (n, 3) µm has left a domain at a time in s."""
    found = None if domain is None else strayed(domain, position)
    if domain is None or found is None:
        return
    cell, side = found
    where = position[cell, "xyz".index(side[0])]
    hint = "Give the walls a larger domain.young, let less push the cells, or widen the domain"
    problem = f"its centre left the domain through the side {side}, to {side[0]} = {where:g} um"
    raise StepFailed(time, problem, hint, int(ids[cell]))


def strayed(domain: Domain, position: FloatArray) -> tuple[int, str] | None:
    """Return the first cell whose centre is not in the domain, and beyond which side it is.

    - ``domain``: a centre on a side is inside; a gel yields to all
    - ``position``, (n, 3), µm
    """
    if domain.stiffness is not None:
        return None
    if domain.radius is not None:
        beyond = np.flatnonzero(~(np.square(position).sum(axis=1) <= domain.radius**2))
        if not len(beyond):
            return None
        place = position[beyond[0]]
        axis = int(np.abs(place).argmax())
        return int(beyond[0]), "xyz"[axis] + ("-" if place[axis] < 0.0 else "+")
    low, high = domain.sides()
    below, above = ~(position >= low), ~(position <= high)
    outside = below | above
    if not outside.any():
        return None
    cell, axis = (int(k[0]) for k in np.nonzero(outside))
    return cell, "xyz"[axis] + ("-" if below[cell, axis] else "+")
