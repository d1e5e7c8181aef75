"""The traits that every cell draws for itself besides its durations: type and modulus."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multicell import random
from multicell.biology.durations import scattered
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
    """Return Young's moduli of new cells, (n,), kPa: ``durations.scattered``."""
    cells = scene.cells
    drawn = scattered(scene.seed, Purpose.MODULI, step, ids, cells.young, cells.young_variation)
    own = [part.young for part in scene.types.values()]
    if not any(own):
        return drawn
    ratio = np.array([1.0 if young is None else young / cells.young for young in own])
    return np.asarray(drawn * ratio[kind])
