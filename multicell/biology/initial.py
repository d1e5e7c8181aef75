"""The population at the start of a run."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multicell import random
from multicell.biology.cycle import place_in_cycle, volume_ratio
from multicell.biology.draws import draw_cycle_times, draw_kinds, draw_lengths, draw_moduli, stages
from multicell.biology.plan import biology_plan
from multicell.cells import SPHERE, Cells, FloatArray, State
from multicell.random import Purpose

if TYPE_CHECKING:
    from multicell.scene.scene import Scene


def packed_ball(count: int) -> FloatArray:
    """Return (count, 3) sites of a hexagonal close packing, cut to a ball.

    Nearest neighbours are at distance 1. The sites are those nearest to a site of the lattice,
    in the order of their distance from it; their centroid is then moved to the origin.
    """
    # a close packing has sqrt(2) sites a unit volume; 2 more cover the surface of small balls
    reach = (3.0 * count / (4.0 * np.pi * np.sqrt(2.0))) ** (1.0 / 3.0) + 2.0
    half = int(np.ceil(reach / np.sqrt(2.0 / 3.0))) + 1
    i, j, k = np.ogrid[-half : half + 1, -half : half + 1, -half : half + 1]
    shape = np.broadcast_shapes(i.shape, j.shape, k.shape)
    x = np.broadcast_to(i + 0.5 * ((j + k) % 2), shape).ravel()
    y = np.broadcast_to(0.5 * np.sqrt(3.0) * (j + (k % 2) / 3.0), shape).ravel()
    z = np.broadcast_to(np.sqrt(2.0 / 3.0) * k, shape).ravel()
    sites = np.stack([x, y, z], axis=1)
    square = (sites**2).sum(axis=1)
    near = square <= reach**2
    sites, square = sites[near], square[near]
    # sites of one shell differ by rounding only: rank them by their coordinates
    order = np.lexsort((*sites.T, np.round(square, 6)))[:count]
    return np.asarray(sites[order] - sites[order].mean(axis=0))


def packed_disc(count: int) -> FloatArray:
    """Return (count, 3) sites of a hexagonal packing in the plane z = 0, cut to a disc."""
    half = int(np.ceil(np.sqrt(count))) + 2
    i, j = np.indices((2 * half + 1, 2 * half + 1)).reshape(2, -1) - half
    sites = np.stack([i + 0.5 * (j % 2), np.sqrt(0.75) * j, np.zeros(len(i))], axis=1)
    square = (sites**2).sum(axis=1)
    order = np.lexsort((*sites.T, np.round(square, 6)))[:count]
    return np.asarray(sites[order] - sites[order].mean(axis=0))


def row(count: int) -> FloatArray:
    """Return ``count`` sites along x at distance 1, their centroid at the origin: (count, 3)."""
    sites = np.zeros((count, 3))
    sites[:, 0] = np.arange(count) - 0.5 * (count - 1)
    return sites


def initial_cells(scene: Scene) -> Cells:
    """Return the cells that a run starts with.

    - ``scene``: its ``initial`` part says how many, how arranged, how far apart (centre distance
      over mean diameter), how much displaced at random, and at which stage of growth; ``cells`` and
      ``growth`` give size, moduli and cycle times

    Returns Cells: identities 0 ... n - 1 from the centre outwards, in a row along x; parent -1, all
    proliferating, centroid of the sites at the origin, pressure zero; with a table what it says
    (:func:`multicell.biology.tabled.tabled_cells`).
    """
    initial = scene.initial
    if initial.cells is not None:
        from multicell.biology.tabled import tabled_cells

        return tabled_cells(scene)
    plan = biology_plan(scene)
    ids = np.arange(initial.count, dtype=np.int64)
    kind = draw_kinds(plan, ids)
    phases = bool(plan.order)
    lengths = draw_lengths(plan, ids, kind) if phases else np.empty((initial.count, 0))
    cycle_time = lengths.sum(axis=1) if phases else draw_cycle_times(plan, ids, kind)
    progress = stages(plan, ids, kind, cycle_time)
    age = np.zeros(initial.count) if scene.growth is None else progress * cycle_time
    cells = Cells(
        id=ids,
        parent=np.full(initial.count, -1),
        position=np.zeros((initial.count, 3)),
        radius=np.ones(initial.count),
        young=draw_moduli(plan, ids, kind),
        poisson=np.full(initial.count, scene.cells.poisson),
        state=np.full(initial.count, State.PROLIFERATING, dtype=np.int8),
        age=age,
        cycle_time=cycle_time,
        pressure=np.zeros(initial.count),
        kind=kind,
    )
    volume = (
        place_in_cycle(plan, cells, lengths, progress) if phases else volume_ratio(plan, progress)
    )
    cells.radius = np.cbrt(plan.birth_volume * volume / SPHERE)
    cells.position = _positions(scene, ids, cells.radius)
    return cells


def _positions(scene: Scene, ids: NDArray[np.int64], radius: FloatArray) -> FloatArray:
    """Return the starting positions (n, 3), µm, of cells with these radii, (n,) µm."""
    diameter = 2.0 * float(radius.mean())
    flat = scene.dimensions == 2
    packed = packed_disc if flat else packed_ball
    if scene.initial.shape == "row":
        packed = row
    position = packed(len(ids)) * (scene.initial.spacing * diameter)
    if scene.initial.jitter > 0.0:
        z = random.normal(scene.seed, Purpose.PLACEMENT, 0, ids, 3)
        z[:, 2] *= not flat
        position = position + scene.initial.jitter * diameter * z
    return position
