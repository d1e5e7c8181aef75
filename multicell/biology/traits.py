"""The traits that every cell draws for itself: type, modulus, cycle time, stage of its cycle."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multicell import random
from multicell.biology.cycle import scale
from multicell.cells import FloatArray
from multicell.random import Purpose

if TYPE_CHECKING:
    from multicell.scene.scene import Scene


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


def stages(scene: Scene, ids: NDArray[np.int64]) -> FloatArray:
    """Return the part of its cycle that each cell has behind it at the start, (n,).

    In a growing population with cycle time T ages have the density 2 ln2 / T 2^(-a/T), more
    young cells than old ones (Powell, J. gen. Microbiol. 15 (1956) 492).
    """
    if scene.initial.stage == "birth":
        return np.zeros(len(ids))
    u = random.uniform(scene.seed, Purpose.STAGE, 0, ids)[:, 0]
    return u if scene.initial.stage == "uniform" else -np.log2(1.0 - 0.5 * u)
