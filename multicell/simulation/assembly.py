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
from multicell.vectors import wrapped

if TYPE_CHECKING:
    from multicell.cells import Cells
    from multicell.scene.scene import Scene


def mechanics_of(scene: Scene, threads: int) -> Mechanics:
    """Return the mechanics that a scene asks for."""
    friction = scene.friction
    law, entries = pairs.law_by_types(scene)
    return Mechanics(
        law,
        scene.drag.viscosity,
        threads,
        bond_strength=0.0 if scene.adhesion is None else scene.adhesion.strength,
        friction=(0.0, 0.0) if friction is None else (friction.normal, friction.tangential),
        pair_table=entries,
        walls=walls(scene),
        compression=pairs.compression(scene),
        period=None if scene.domain is None else scene.domain.period,
        work=ChosenWork(),
    )


def apart_at_start(scene: Scene, cells: Cells) -> Cells:
    """Return cells of which none coincide: between centres at one place no force has a direction.

    Each but one of them moves by a millionth of its radius along a random direction; the
    contact forces do the rest.
    """
    if len(cells) < 2 or not scene.contact.acts:
        return cells
    # a thousand cells at one place are half a million pairs: those behind the first are only named
    period, place = None if scene.domain is None else scene.domain.period, cells.position
    if period is not None:
        place = wrapped(place, period)
    first = np.sort(np.unique(place, axis=0, return_index=True)[1])
    cutoff = 1e-9 * float(cells.radius.min())
    if period is None:
        near = neighbours.neighbour_pairs(place[first], cutoff)
    else:
        half = np.full(len(first), 0.5 * cutoff)
        near = neighbours.build_periodic(place[first], half, period).pairs()
    later = np.delete(np.arange(len(cells)), first)
    moved = np.union1d(later, first[near[:, 1]])
    if len(moved):
        cells = cells.copy()
        axis = random.directions(
            scene.seed, random.Purpose.SEPARATION, 0, cells.id[moved], scene.dimensions
        )
        cells.position[moved] += 1e-6 * cells.radius[moved, None] * axis
    return cells
