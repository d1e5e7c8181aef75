"""Signals that neither fields nor cells carry: the time, and what neighbours make."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from multicell.behaviours.catalogue import CONTACTS, CROWDED
from multicell.results.observables import contact_rows
from multicell.vectors import lengths

if TYPE_CHECKING:
    from multicell.biology.plan import BiologyPlan
    from multicell.cells import Cells, FloatArray, IntArray


def other_signals(
    plan: BiologyPlan, cells: Cells, contacts: IntArray, time: float
) -> dict[str, FloatArray]:
    """Return the signals besides fields that the responses of a plan need, name -> (n,).

    - ``contacts``, (m, 2): identities of the cells that touched at the end of the last motion. Of
      cells that were born since, those count that overlap.
    - ``time``: simulated time, s
    """
    out = {}
    if "time" in plan.elsewhere:
        out["time"] = np.full(len(cells), time)
    counted = plan.elsewhere - {"time"}
    if not counted:
        return out
    pairs = np.concatenate([contact_rows(cells, contacts), _of_newborn(cells)])
    first, second = np.concatenate([pairs, pairs[:, ::-1]]).T
    names = list(plan.types)
    for name in sorted(counted):
        who, weight = np.ones(len(first), dtype=bool), None
        if name == "crowding":
            weight = _overlap(cells, first, second) ** 2 / CROWDED
        elif name == "dead neighbours":
            who = cells.dead[second]
        elif name == "neighbours":
            who = ~cells.dead[second]
        else:
            kind = names.index(name.removeprefix(CONTACTS))
            who = (cells.kind[second] == kind) & ~cells.dead[second]
        out[name] = np.bincount(first[who], weight, minlength=len(cells)).astype(float)
    return out


def _overlap(cells: Cells, first: IntArray, second: IntArray) -> FloatArray:
    """Return the overlap of pairs of cells over the sum of their radii, (m,), zero if apart."""
    distance = lengths(cells.position[first] - cells.position[second])
    reach = cells.radius[first] + cells.radius[second]
    return np.asarray(np.maximum(1.0 - distance / reach, 0.0))


def _of_newborn(cells: Cells) -> IntArray:
    """Return the pairs that overlap of which one cell has just been born, (m, 2) rows."""
    born = np.flatnonzero((cells.age == 0.0) & (cells.parent >= 0) & ~cells.dead)
    if not born.size:
        return np.empty((0, 2), dtype=np.int64)
    from scipy.spatial import cKDTree

    reach = cells.radius[born] + float(cells.radius.max())
    near = cKDTree(cells.position).query_ball_point(cells.position[born], reach)
    first = np.repeat(born, [len(rows) for rows in near])
    second = np.concatenate([np.asarray(rows, dtype=np.int64) for rows in near])
    distance = lengths(cells.position[first] - cells.position[second])
    newborn = np.isin(second, born)
    # a pair of two newborn cells is found from both sides
    keep = (distance < cells.radius[first] + cells.radius[second]) & (first != second)
    keep &= ~newborn | (first < second)
    return np.stack([first[keep], second[keep]], axis=1)
