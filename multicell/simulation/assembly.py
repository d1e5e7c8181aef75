"""Mechanics of a scene, and cells that coincide and are moved apart before it begins."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from multicell import random
from multicell.integrators.auto import ChosenWork
from multicell.mechanics import neighbours
from multicell.mechanics.system import Mechanics
from multicell.scene import pairs
from multicell.scene.domain import walls

if TYPE_CHECKING:
    from multicell.cells import Cells
    from multicell.scene.scene import Scene


def mechanics_of(scene: Scene, threads: int) -> Mechanics:
    """Return the mechanics that a scene asks for."""
    friction = scene.friction
    return Mechanics(
        scene.contact,
        scene.drag.viscosity,
        threads,
        bond_strength=0.0 if scene.adhesion is None else scene.adhesion.strength,
        friction=(0.0, 0.0) if friction is None else (friction.normal, friction.tangential),
        surface_energies=pairs.surface_energies(scene),
        walls=walls(scene),
        compression=pairs.compression(scene),
        work=ChosenWork(),
    )


def apart_at_start(scene: Scene, cells: Cells) -> Cells:
    """Return cells of which none coincide: between centres at one place no force has a direction.

    Each but one of them moves by a millionth of its radius along a random direction; the
    contact forces do the rest.
    """
    if len(cells) < 2:
        return cells
    # a thousand cells at one place are half a million pairs: those behind the first are only named
    first = np.sort(np.unique(cells.position, axis=0, return_index=True)[1])
    near = neighbours.neighbour_pairs(cells.position[first], 1e-9 * float(cells.radius.min()))
    later = np.delete(np.arange(len(cells)), first)
    moved = np.union1d(later, first[near[:, 1]])
    if len(moved):
        cells = cells.copy()
        axis = random.directions(
            scene.seed, random.Purpose.SEPARATION, 0, cells.id[moved], scene.dimensions
        )
        cells.position[moved] += 1e-6 * cells.radius[moved, None] * axis
    return cells
