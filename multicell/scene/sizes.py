"""Sizes of cells that follow from a scene."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from multicell.cells import SPHERE

if TYPE_CHECKING:
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
