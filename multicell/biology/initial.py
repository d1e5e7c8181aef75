"""The population at the start of a run, and the traits that every cell draws for itself."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multicell import random
from multicell.biology.cycle import placed, scale
from multicell.biology.growth import birth_volume
from multicell.cells import SPHERE, Cells, FloatArray, State
from multicell.random import Purpose

if TYPE_CHECKING:
    from multicell.scene.scene import Scene


def packed_ball(count: int) -> FloatArray:
    """Return ``count`` sites of a hexagonal close packing, cut to a ball.

    Nearest neighbours are at distance 1. The sites are those nearest to a site of the lattice,
    in the order of their distance from it; their centroid is then moved to the origin.

    Returns
    -------
    (count, 3) float64
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
    """Return ``count`` sites of a hexagonal packing in the plane z = 0, cut to a disc.

    Like :func:`packed_ball` in two dimensions.

    Returns
    -------
    (count, 3) float64
    """
    half = int(np.ceil(np.sqrt(count))) + 2
    i, j = np.indices((2 * half + 1, 2 * half + 1)).reshape(2, -1) - half
    sites = np.stack([i + 0.5 * (j % 2), np.sqrt(0.75) * j, np.zeros(len(i))], axis=1)
    square = (sites**2).sum(axis=1)
    order = np.lexsort((*sites.T, np.round(square, 6)))[:count]
    return np.asarray(sites[order] - sites[order].mean(axis=0))


def draw_kinds(scene: Scene, ids: NDArray[np.int64]) -> NDArray[np.int16]:
    """Return the type of each cell at the start, (n,): the scene's fractions, mixed at random.

    The numbers of cells are the fractions rounded, not drawn: only who is what is random.
    """
    if len(scene.types) < 2:
        return np.zeros(len(ids), dtype=np.int16)
    share = np.cumsum([kind.fraction for kind in scene.types.values()])
    ends = np.round(share / share[-1] * len(ids))
    place = np.empty(len(ids))
    place[np.argsort(random.uniform(scene.seed, Purpose.KIND, 0, ids)[:, 0])] = np.arange(len(ids))
    return np.searchsorted(ends, place, side="right").astype(np.int16)


def draw_moduli(
    scene: Scene, step: int, ids: NDArray[np.int64], kind: NDArray[np.int16]
) -> FloatArray:
    """Return Young's moduli of new cells, (n,), kPa: see :func:`scattered`."""
    cells = scene.cells
    drawn = scattered(scene.seed, Purpose.MODULI, step, ids, cells.young, cells.young_variation)
    own = [part.young for part in scene.types.values()]
    if not any(own):
        return drawn
    ratio = np.array([1.0 if young is None else young / cells.young for young in own])
    return np.asarray(drawn * ratio[kind])


def draw_cycle_times(
    scene: Scene, step: int, ids: NDArray[np.int64], kind: NDArray[np.int16]
) -> FloatArray:
    """Return cycle times of new cells, (n,), s; infinite in a scene without growth."""
    growth = scene.growth
    if growth is None:
        return np.full(len(ids), np.inf)
    drawn = scattered(
        scene.seed, Purpose.CYCLE, step, ids, growth.cycle_time, growth.cycle_variation
    )
    return drawn * scale(scene, kind) if scene.types else drawn


def scattered(
    seed: int, purpose: Purpose, step: int, ids: NDArray[np.int64], mean: float, variation: float
) -> FloatArray:
    """Return positive numbers that scatter normally about ``mean``, (n,).

    The normal distribution with coefficient of variation ``variation`` is cut on both sides at
    three standard deviations, or at 90 % of the mean where that is nearer (variations above 0.3,
    whose spread is then somewhat narrower than asked). The cut is symmetric: the mean stays.
    """
    if variation == 0.0:
        return np.full(len(ids), mean)
    z = random.truncated_normal(seed, purpose, step, ids, min(3.0, 0.9 / variation))
    return np.asarray(mean * (1.0 + variation * z))


def initial_cells(scene: Scene) -> Cells:
    """Return the cells that a run starts with.

    Parameters
    ----------
    scene
        Its ``initial`` part says how many, how arranged, how far apart (centre distance over mean
        diameter), how much displaced at random, and at which stage of growth; ``cells`` and
        ``growth`` give size, moduli and cycle times.

    Returns
    -------
    Cells
        Identities 0 ... n - 1 from the centre outwards, parent -1, all proliferating, centroid of
        the sites at the origin, pressure zero.
    """
    initial = scene.initial
    ids = np.arange(initial.count, dtype=np.int64)
    kind = draw_kinds(scene, ids)
    cycle_time = draw_cycle_times(scene, 0, ids, kind)
    progress = _stages(scene, ids)
    age = np.zeros(initial.count) if scene.growth is None else progress * cycle_time
    cells = Cells(
        id=ids,
        parent=np.full(initial.count, -1),
        position=np.zeros((initial.count, 3)),
        radius=np.ones(initial.count),
        young=draw_moduli(scene, 0, ids, kind),
        poisson=np.full(initial.count, scene.cells.poisson),
        state=np.full(initial.count, State.PROLIFERATING, dtype=np.int8),
        age=age,
        cycle_time=cycle_time,
        pressure=np.zeros(initial.count),
        kind=kind,
    )
    volume = 1.0 + progress
    if scene.growth is not None and scene.growth.phases:
        volume = placed(scene, cells, progress)
    cells.radius = np.cbrt(birth_volume(scene) * volume / SPHERE)
    cells.position = _positions(scene, ids, 2.0 * float(cells.radius.mean()))
    return cells


def _stages(scene: Scene, ids: NDArray[np.int64]) -> FloatArray:
    """Return the part of its cycle that each cell has behind it at the start, (n,).

    In a growing population with cycle time T ages have the density 2 ln2 / T 2^(-a/T), more
    young cells than old ones (Powell, J. gen. Microbiol. 15 (1956) 492).
    """
    if scene.initial.stage == "birth":
        return np.zeros(len(ids))
    u = random.uniform(scene.seed, Purpose.STAGE, 0, ids)[:, 0]
    return u if scene.initial.stage == "uniform" else -np.log2(1.0 - 0.5 * u)


def _positions(scene: Scene, ids: NDArray[np.int64], diameter: float) -> FloatArray:
    """Return the starting positions (n, 3), µm, of cells of a mean ``diameter`` in µm."""
    flat = scene.dimensions == 2
    packed = packed_disc if flat else packed_ball
    position = packed(len(ids)) * (scene.initial.spacing * diameter)
    if scene.initial.jitter > 0.0:
        z = random.normal(scene.seed, Purpose.PLACEMENT, 0, ids, 3)
        z[:, 2] *= not flat
        position = position + scene.initial.jitter * diameter * z
    return position
