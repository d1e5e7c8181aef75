"""The traits that every cell draws for itself besides its durations: type and modulus."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multicell import random
from multicell.biology.durations import scatter_about
from multicell.cells import FloatArray
from multicell.random import Purpose

if TYPE_CHECKING:
    from multicell.biology.plan import BiologyPlan
    from multicell.cells import Cells


def draw_kinds(plan: BiologyPlan, ids: NDArray[np.int64]) -> NDArray[np.int16]:
    """Return the type of each cell at the start, (n,): the scene's fractions, mixed at random.

    The numbers of cells are the fractions rounded, not drawn: only who is what is random.
    """
    if len(plan.types) < 2:
        return np.zeros(len(ids), dtype=np.int16)
    share = np.cumsum([kind.fraction for kind in plan.types.values()])
    ends = np.round(share / share[-1] * len(ids))
    place = np.empty(len(ids))
    place[np.argsort(random.uniform(plan.seed, Purpose.KIND, 0, ids)[:, 0])] = np.arange(len(ids))
    return np.searchsorted(ends, place, side="right").astype(np.int16)


def draw_moduli(plan: BiologyPlan, ids: NDArray[np.int64], kind: NDArray[np.int16]) -> FloatArray:
    """Return Young's moduli of new cells, (n,), kPa: ``durations.scattered``."""
    drawn = scatter_about(plan.seed, Purpose.MODULI, 0, ids, plan.young, plan.young_variation)
    return drawn if plan.young_ratio is None else np.asarray(drawn * plan.young_ratio[kind])


def drift(plan: BiologyPlan, daughters: Cells) -> None:
    """Let traits that daughters inherit drift: ln x changes by a normal number of the scene's sd.

    The mean of ln x stays, so that its variance grows by sd² in each generation. The normal
    distribution is cut at three standard deviations.
    """
    for place, (name, sd) in enumerate(plan.drift.items()):
        z = random.truncated_normal(plan.seed, Purpose.DRIFT, place, daughters.id, 3.0)
        setattr(daughters, name, getattr(daughters, name) * np.exp(sd * z))
