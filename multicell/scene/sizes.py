"""Sizes of cells that follow from a scene."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import SPHERE, FloatArray

if TYPE_CHECKING:
    from multicell.mechanics.brownian import BrownianPaths
    from multicell.scene.scene import Scene


def division_volume(scene: Scene) -> float:
    """Return the volume at which a cell divides whose type has no scale of its own, µm³."""
    return float(SPHERE * scene.cells.division_radius**3)


def birth_volume(scene: Scene) -> float:
    """Return half of that volume, µm³, with which such a cell is born."""
    return 0.5 * division_volume(scene)


def radius_scales(scene: Scene) -> list[float]:
    """Return the scale of each type on radii, in their order; of a scene without types one."""
    return [kind.division_radius_scale for kind in scene.types.values()] or [1.0]


def mean_scale(scene: Scene) -> float:
    """Return the scale on radii that gives the mean volume of the types as mixed at the start."""
    scales = np.array(radius_scales(scene))
    if (scales == 1.0).all():
        return 1.0
    share = [kind.fraction for kind in scene.types.values()]
    return float(np.cbrt(np.average(scales**3, weights=share)))


def birth_volumes(scene: Scene, kind: NDArray[np.integer]) -> float | FloatArray:
    """Return the volumes in µm³ with which cells of types are born, (n,) or one for all."""
    if not scene.types:
        return birth_volume(scene)
    scales = np.array(radius_scales(scene))
    return birth_volume(scene) * (1.0 if (scales == 1.0).all() else scales[kind] ** 3)


def division_radii(scene: Scene) -> list[float]:
    """Return the radius in µm at which cells divide, of the smallest type and of the largest."""
    scales = radius_scales(scene)
    return [scene.cells.division_radius * scale for scale in (min(scales), max(scales))]


def division_radius(scene: Scene) -> float:
    """Return the radius in µm at which a cell divides, of types the mean one by volume."""
    return scene.cells.division_radius * mean_scale(scene)


def birth_radius(scene: Scene) -> float:
    """Return the radius of a cell of half its division volume, µm, of types the mean one."""
    return float(division_radius(scene) / np.cbrt(2.0))


def typical_radius(scene: Scene) -> float:
    """Return the radius half-way (geometrically) between birth and division, µm.

    Where all cells are as at birth and none grows, it is the birth radius.
    """
    if scene.growth is None and scene.initial.stage == "birth" and scene.initial.cells is None:
        return birth_radius(scene)
    return math.sqrt(birth_radius(scene) * division_radius(scene))


_FINE: Final = 0.2
"""Part of the birth radius that a free cell diffuses in an internal step, where none is given."""


def internal_step(scene: Scene) -> float:
    """Return the longest time in s for which a force of Brownian motion is constant.

    It is given, or so short that the free cells that move most go a fifth of the birth radius along
    an axis in it (root mean square).
    """
    law = scene.motility
    assert law is not None
    assert law.diffusion is not None
    if law.diffusion_step is not None:
        return law.diffusion_step
    scale = max((kind.diffusion_scale for kind in scene.types.values()), default=1.0)
    way = _FINE * float(division_radii(scene)[0] / np.cbrt(2.0))
    return scene.coupling_step if not scale else way**2 / (2.0 * scale * law.diffusion)


def brownian_paths(scene: Scene) -> BrownianPaths | None:
    """Return the paths of a scene's cells by Brownian motion; nothing is loaded without."""
    if scene.motility is None or scene.motility.diffusion is None:
        return None
    from multicell.mechanics.brownian import BrownianPaths

    longest = internal_step(scene)
    return BrownianPaths(scene.seed, scene.dimensions, scene.coupling_step, longest)
