"""Cell types of a scene: whether they fit together, and what they give each cell."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from multicell.biology.responding import value_of
from multicell.cells import Cells

if TYPE_CHECKING:
    from multicell.biology.plan import BiologyPlan
    from multicell.cells import FloatArray


def bonds(
    plan: BiologyPlan,
    cells: Cells,
    concentrations: Mapping[str, FloatArray],
    begin: float,
    end: float,
) -> FloatArray | None:
    """Return receptors and ligands at ``begin`` and their rates up to ``end``, (n, 4), or None.

    At ``begin`` they are those of the cells. At ``end`` they are the type's course at that time,
    times the factors of the concentrations that it finds at ``begin``. Between the two times they
    run linearly, so that a course with a kink between two coupling times is cut there.
    """
    if plan.adhesion is None:
        return None
    now = np.stack([cells.receptor, cells.ligand], axis=1)
    then = bond_levels(plan, cells, concentrations, end)
    rate = (then - now) / (end - begin) if end > begin else np.zeros_like(now)
    return np.ascontiguousarray(np.hstack([now, rate]))


def bond_levels(
    plan: BiologyPlan, cells: Cells, concentrations: Mapping[str, FloatArray], time: float
) -> FloatArray:
    """Return the receptors and ligands that cells have at a time in these conditions, (n, 2).

    Concentrations that are not known yet have no effect.
    """
    levels = np.array([part.bonds(time) for part in plan.types.values()])[cells.kind]
    for column, behaviour in enumerate(("receptors", "ligands")):
        response = value_of(plan, behaviour, 1.0, concentrations, cells, early=True)
        if response is not None:
            levels[:, column] *= response
    return np.asarray(levels)
