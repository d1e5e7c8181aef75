"""Sizes of cells that follow from a scene."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from multicell.cells import SPHERE

if TYPE_CHECKING:
    from multicell.mechanics.brownian import BrownianPaths
    from multicell.scene.scene import Scene


def division_volume(scene: Scene) -> float:
    """Return the volume at which a cell divides, µm³."""
    return float(SPHERE * scene.cells.division_radius**3)


def birth_volume(scene: Scene) -> float:
    """Return the volume of a newborn cell, half the division volume, µm³."""
    return 0.5 * division_volume(scene)


def birth_radius(scene: Scene) -> float:
    """Return the radius of a cell of half the division volume, µm."""
    return float(scene.cells.division_radius / np.cbrt(2.0))


def typical_radius(scene: Scene) -> float:
    """Return the radius half-way (geometrically) between birth and division, µm.

    Where all cells are as at birth and none grows, it is the birth radius.
    """
    if scene.growth is None and scene.initial.stage == "birth" and scene.initial.cells is None:
        return birth_radius(scene)
    return math.sqrt(birth_radius(scene) * scene.cells.division_radius)


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
    way = _FINE * birth_radius(scene)
    return scene.coupling_step if not scale else way**2 / (2.0 * scale * law.diffusion)


def brownian_paths(scene: Scene) -> BrownianPaths | None:
    """Return the paths of a scene's cells by Brownian motion; nothing is loaded without."""
    if scene.motility is None or scene.motility.diffusion is None:
        return None
    from multicell.mechanics.brownian import BrownianPaths

    longest = internal_step(scene)
    return BrownianPaths(scene.seed, scene.dimensions, scene.coupling_step, longest)
