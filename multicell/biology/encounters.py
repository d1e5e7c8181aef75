"""Neighbours that die or become another type within a step, as the cells that touch them find them.

Signals that count neighbours are known at both ends of a step, for the states and types with which
it began. Who dies or changes counts as it is from that moment on, in each contact by the part of it
that there is then: one that begins or ends within the step does so linearly. That lets others die
or change, or at other times; a step is therefore repeated until nobody does. Nothing acts before
its time, so that each pass is right up to one more event in a row than the one before.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from multicell.behaviours.catalogue import CONTACTS
from multicell.biology.division import Turns, change_types, changing, mutate_as_found
from multicell.biology.exposure import Jumps
from multicell.cells import contact_rows

if TYPE_CHECKING:
    from multicell.biology.exposure import Exposure
    from multicell.biology.plan import BiologyPlan
    from multicell.biology.step import Decided
    from multicell.cells import FloatArray, IntArray

Respond = Callable[[Jumps | None], "tuple[Exposure, Decided]"]
"""Jumps of signals in a step -> the exposure of cells to them, and their decisions."""

_SAME: float = 1e-9  # of a step, to which times agree that are the same


def with_encounters(
    plan: BiologyPlan,
    respond: Respond,
    contacts: tuple[IntArray, IntArray],
    first: int,
    most: int,
) -> tuple[Exposure, Decided, int]:
    """Return a step in which cells find the deaths and changes of their neighbours within it.

    Also returns the number of these that have not settled.

    - ``contacts``, (m, 2) each: identities of cells that touched at both ends of the step
    - ``first``: identity of any first daughter
    - ``most``: passes
    """
    exposure, decided = respond(None)
    before = turns_of(plan, exposure, decided, first)
    if not len(before.row):
        return exposure, decided, 0
    pairs = _pairs(exposure, *contacts)
    for _ in range(most):
        exposure, decided = respond(_jumps(plan, exposure, pairs, before))
        turns = turns_of(plan, exposure, decided, first)
        unsettled = _changed(before, turns)
        if not unsettled:
            break
        before = turns
    return exposure, decided, unsettled


def turns_of(plan: BiologyPlan, exposure: Exposure, decided: Decided, first: int) -> Turns:
    """Return all deaths and changes of type in a step, in the order of their times.

    - ``first``: identity of any first daughter
    """
    cells = decided.cells
    died = np.flatnonzero(decided.died)
    kinds = cells.kind[died]
    part = 1.0 - cells.age[died] / exposure.length
    found = [Turns(died, part, kinds, kinds, np.ones(len(died), bool))]
    if changing(plan.acting):
        # daughters of another type than it seemed count as such from the end of the step on
        after, rows = mutate_as_found(plan, cells, exposure, first)
        exposure.cells = after
        change_types(plan, after, exposure, found)
        exposure.cells = cells
        for k in range(1, len(found) if rows.size else 0):
            kept = ~np.isin(found[k].row, rows)
            found[k] = _of_some(found[k], kept)
    joined = Turns._make(np.concatenate(column) for column in zip(*found, strict=True))
    return _of_some(joined, np.lexsort((joined.row, joined.part)))


def _of_some(turns: Turns, which: Any) -> Turns:
    return Turns._make(column[which] for column in turns)


def _changed(before: Turns, after: Turns) -> int:
    """Return the number of turns of a pass that are not those of the pass before."""
    most, both = max(len(before.row), len(after.row)), min(len(before.row), len(after.row))
    same = np.abs(before.part[:both] - after.part[:both]) <= _SAME
    for name in ("row", "becomes", "dies"):
        same &= getattr(before, name)[:both] == getattr(after, name)[:both]
    return most - int(np.count_nonzero(same))


Pairs = tuple["IntArray", "IntArray", "FloatArray", "FloatArray"]
"""Rows of cells and of neighbours, (k,), and the part of a contact they have at both ends."""


def _pairs(exposure: Exposure, begin: IntArray, end: IntArray) -> Pairs:
    """Return the cells that touch at either end of a step, in both orders.

    Daughters share the contacts of their mothers at its begin: of two, each counts as a half.
    """
    cells, began, row = exposure.cells, exposure.began, exposure.row
    now, then = (
        np.concatenate([pairs, pairs[:, ::-1]])
        for pairs in (contact_rows(cells, end), contact_rows(began, begin))
    )
    at, who = _matches(row, then[:, 0])
    which, whom = _matches(row, then[at, 1])
    who, part = who[which], 1.0 / np.bincount(row, minlength=len(began))[row[whom]]
    # one that was born as another type has never been counted as what its mother was
    part[began.kind[row[whom]] != cells.kind[whom]] = 0.0
    count = len(cells)
    key = np.concatenate([now[:, 0] * count + now[:, 1], who * count + whom])
    known, place = np.unique(key, return_inverse=True)
    at_begin = np.concatenate([np.zeros(len(now)), part])
    at_end = np.concatenate([np.ones(len(now)), np.zeros(len(part))])
    first, last = (np.bincount(place, end, len(known)) for end in (at_begin, at_end))
    return known // count, known % count, first.astype(float), last.astype(float)


def _matches(known: IntArray, wanted: IntArray) -> tuple[IntArray, IntArray]:
    """Return all pairs of equal values: places in ``wanted``, (k,), and in ``known``, (k,)."""
    order = np.argsort(known, kind="stable")
    low, high = (np.searchsorted(known[order], wanted, side) for side in ("left", "right"))
    which = np.repeat(np.arange(len(wanted)), high - low)
    rank = np.arange(len(which)) - (np.cumsum(high - low) - (high - low))[which]
    return which, order[low[which] + rank]


def _jumps(plan: BiologyPlan, exposure: Exposure, pairs: Pairs, turns: Turns) -> Jumps:
    """Return the jumps of the counts of neighbours when these die or change."""
    cell, neighbour, begin, end = pairs
    turn, pair = _matches(neighbour, turns.row)
    order = np.lexsort((turns.part[turn], cell[pair]))
    turn, pair = turn[order], pair[order]
    column = cell[pair]
    # the place of each among those of its cell
    slot = np.arange(len(column)) - np.searchsorted(column, column)
    shape = int(slot.max(initial=-1)) + 1, len(exposure.cells)

    def placed(values: FloatArray, empty: float) -> FloatArray:
        out = np.full(shape, empty)
        out[slot, column] = values
        return out

    first, last = {}, {}
    for name in sorted(plan.counted):
        size = _size(plan, name, turns)[turn]
        first[name], last[name] = (placed(size * share[pair], 0.0) for share in (begin, end))
    return Jumps(placed(turns.part[turn], 1.0), first, last)


def _size(plan: BiologyPlan, name: str, turns: Turns) -> FloatArray:
    """Return the change of a count of neighbours by each turn of one, (k,)."""
    if name == "neighbours":
        return -turns.dies.astype(float)
    if name == "dead neighbours":
        return turns.dies.astype(float)
    kind = list(plan.types).index(name.removeprefix(CONTACTS))
    after = (turns.becomes == kind) & ~turns.dies
    return np.asarray(after.astype(float) - (turns.kind == kind))
