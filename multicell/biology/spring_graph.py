"""Find which springs there are in a run: at the start, and after divisions and deaths.

A spring keeps the identities of its two cells. When one of them divides, the daughter takes the
spring over whose centre is nearer to the other end; where both divide, the nearest two. When one
dies the spring is gone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import Cells, FloatArray, IntArray
from multicell.scene.springs import pairs_at_start

if TYPE_CHECKING:
    from multicell.biology.plan import BiologyPlan


@final
@dataclass(frozen=True, eq=False)
class Springs:
    """The springs at one time, sorted by table and identities.

    Attributes
    ----------
    table : (m,) int64
        Place of the table that a spring belongs to in the scene.
    pair : (m, 2) int64
        Identities of its cells, the smaller one first.
    rest : (m,), µm
        Length at rest.
    """

    table: IntArray = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    pair: IntArray = field(default_factory=lambda: np.empty((0, 2), dtype=np.int64))
    rest: FloatArray = field(default_factory=lambda: np.empty(0))

    def __len__(self) -> int:
        return len(self.rest)

    def take(self, index: NDArray[Any]) -> Springs:
        """Return some of the springs."""
        return Springs(self.table[index], self.pair[index], self.rest[index])

    def to_plain(self) -> dict[str, list[Any]]:
        """Return them as plain values."""
        if not len(self):
            return {}
        return {
            "table": self.table.tolist(),
            "pair": self.pair.ravel().tolist(),
            "rest": self.rest.tolist(),
        }

    @classmethod
    def of(cls, plain: Mapping[str, list[Any]]) -> Springs:
        """Return the springs that :meth:`to_plain` returned down."""
        if not plain:
            return cls()
        table, pair, rest = (np.array(plain[name]) for name in ("table", "pair", "rest"))
        return cls(table.astype(np.int64), pair.astype(np.int64).reshape(-1, 2), rest.astype(float))


def springs_at_start(plan: BiologyPlan, cells: Cells) -> Springs:
    """Return the springs that a run starts with.

    Raises
    ------
    SceneError
        For a cell that is not there.
    """
    tables, pairs, rests = [], [], []
    for number, (name, law) in enumerate(plan.springs.items()):
        pair = pairs_at_start(plan.springs, name, cells)
        tables.append(np.full(len(pair), number))
        pairs.append(pair)
        rest = _lengths(cells, pair) if law.rest is None else np.full(len(pair), law.rest)
        rests.append(rest)
    return Springs(np.concatenate(tables), np.concatenate(pairs), np.concatenate(rests))


def for_mechanics(
    plan: BiologyPlan, cells: Cells, springs: Springs
) -> tuple[IntArray, FloatArray] | None:
    """Return rows of the cells of each spring, and stiffness and length at rest; None without."""
    if not len(springs):
        return None
    return cells.rows_of(springs.pair), np.stack([_stiffness(plan, springs), springs.rest], axis=1)


def without_dead(springs: Springs, cells: Cells) -> Springs:
    """Return the springs between living cells."""
    if not len(springs):
        return springs
    rows = cells.rows_of(springs.pair)
    gone = ((rows < 0) | cells.dead[rows]).any(axis=1)
    return springs.take(np.flatnonzero(~gone)) if gone.any() else springs


def tensions(plan: BiologyPlan, springs: Springs, cells: Cells) -> FloatArray:
    """Return the tension of each spring, (m,) nN, negative where it is compressed."""
    longer = _lengths(cells, springs.pair) - springs.rest
    return np.asarray(_stiffness(plan, springs) * longer)


def after_divisions(springs: Springs, before: Cells, after: Cells) -> Springs:
    """Return the springs after divisions; those of cells that are gone are left out."""
    born = np.flatnonzero(before.rows_of(after.id) < 0)
    if not len(born) or not len(springs):
        return without_dead(springs, after)
    born = born[np.lexsort((after.id[born], after.parent[born]))]
    # two rows of daughters, in the order of their mothers' identities
    mothers, daughters = after.parent[born[::2]], np.stack([born[::2], born[1::2]], axis=1)
    divided = np.isin(springs.pair, mothers)
    pair = springs.pair.copy()
    pair[divided.any(axis=1)] = _nearest(after, mothers, daughters, pair[divided.any(axis=1)])
    pair = np.sort(pair, axis=1)
    order = np.lexsort((pair[:, 1], pair[:, 0], springs.table))
    return without_dead(Springs(springs.table, pair, springs.rest).take(order), after)


def _nearest(after: Cells, mothers: IntArray, daughters: IntArray, pairs: IntArray) -> IntArray:
    """Return the identities of the nearest cells that stand for the ends of each spring, (m, 2).

    Pairs of which an end is gone are left as they are.
    """
    place = np.minimum(np.searchsorted(mothers, pairs), len(mothers) - 1)
    divided = mothers[place] == pairs
    # two cells for each end: its daughters, or twice the cell itself
    rows = np.where(divided[..., None], daughters[place], after.rows_of(pairs)[..., None])
    first, second = after.position[rows[:, 0]], after.position[rows[:, 1]]
    away = np.square(first[:, :, None] - second[:, None, :]).sum(axis=3)
    i, j = np.unravel_index(away.reshape(-1, 4).argmin(axis=1), (2, 2))
    every = np.arange(len(pairs))
    found = np.stack([after.id[rows[every, 0, i]], after.id[rows[every, 1, j]]], axis=1)
    gone = np.any(rows < 0, axis=(1, 2), keepdims=True)[..., 0]
    return np.where(gone, pairs, found)


def columns(plan: BiologyPlan, springs: Springs, cells: Cells) -> dict[str, float]:
    """Return what the history tells of springs: their number, and the largest tension, nN."""
    tension = tensions(plan, springs, cells)
    return {"springs": len(springs), "largest_tension": float(tension.max(initial=0.0))}


def _lengths(cells: Cells, pair: IntArray) -> FloatArray:
    """Return the distances between the cells of pairs of identities, (m,) µm."""
    i, j = cells.rows_of(pair).T
    return np.asarray(np.linalg.norm(cells.position[j] - cells.position[i], axis=1))


def _stiffness(plan: BiologyPlan, springs: Springs) -> FloatArray:
    return np.array([law.stiffness for law in plan.springs.values()])[springs.table]
