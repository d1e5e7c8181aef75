"""Cells that are driven from outside during a run: who they are, and how they are driven.

A motion that names cells by identity or by where they are at the start keeps a list of identities.
When such a cell divides, the first daughter (the smaller identity) takes its place, so that the
number of driven cells stays; when it is removed, its place is empty. A motion that names a type,
or all cells, needs no list.

Velocities act through whole coupling steps, which end where one begins or ends.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from multicell.cells import Cells, FloatArray, IntArray, Mask
from multicell.scene.driven import check_members

if TYPE_CHECKING:
    from multicell.biology.plan import BiologyPlan
    from multicell.mechanics.motion import Motion
    from multicell.mechanics.system import Mechanics

Named = Mapping[str, IntArray]
"""Identities of the cells of each motion that keeps a list, by its path in the scene."""


def named_at_start(plan: BiologyPlan, cells: Cells) -> dict[str, IntArray]:
    """Return the cells of each motion that keeps a list."""
    check_members(plan.motions, plan.types, cells)
    return {
        f"motions.{name}": np.sort(cells.id[motion.members(plan.types, cells)])
        for name, motion in plan.motions.items()
        if motion.by_identity
    }


def pass_on(named: Named, cells: Cells, first: int) -> dict[str, IntArray]:
    """Return the lists after events.

    - ``first``: first identity that was free before: the daughters' identities count from there,
      two by two, the first daughter's first
    """
    if not named:
        return {}
    eldest = cells.id[(cells.id >= first) & ((cells.id - first) % 2 == 0)]
    mothers = cells.parent[cells.rows_of(eldest)]
    after = {}
    for path, ids in named.items():
        heirs = eldest[np.isin(mothers, ids)]
        after[path] = np.sort(np.concatenate([ids[cells.rows_of(ids) >= 0], heirs]))
    return after


def prescribed(
    plan: BiologyPlan, cells: Cells, named: Named, begin: float, end: float
) -> tuple[Mask, FloatArray] | None:
    """Return which cells are moved in a span of time, (n,), and all velocities, (n, 3) µm/s.

    The velocity of a cell that is not moved is zero. None if nothing is moved in the span.
    """
    shares = {name: motion.within(begin, end) for name, motion in plan.motions.items()}
    if not any(shares.values()):
        return None
    held, velocity = np.zeros(len(cells), dtype=np.bool_), np.zeros((len(cells), 3))
    for name, share in shares.items():
        if share > 0.0:
            chosen = driven(plan, cells, named, name)
            held |= chosen
            velocity[chosen] += share * np.array(plan.motions[name].velocity)
    return held, velocity


def driven(plan: BiologyPlan, cells: Cells, named: Named, name: str) -> Mask:
    """Return which cells a motion drives now, (n,)."""
    motion = plan.motions[name]
    if motion.by_identity:
        return np.isin(cells.id, named.get(f"motions.{name}", ()))
    return motion.members(plan.types, cells)


def columns(
    plan: BiologyPlan, cells: Cells, named: Named, system: Mechanics, motion: Motion
) -> dict[str, float]:
    """Return the force that each prescribed motion takes at a moment, along each axis, nN.

    Of all cells that it moves together; zero while it does not act. The work is not counted.

    - ``motion``: of all cells at that moment; the mechanics are made ready for it
    """
    from multicell.mechanics.prescribed import outside_force

    counts = vars(system.work).copy()
    system.begin(motion)
    force = outside_force(system, motion.begin, cells.position)
    vars(system.work).update(counts)
    found: dict[str, float] = {}
    for name, law in plan.motions.items():
        total = np.zeros(3)
        if law.within(motion.begin, motion.begin):
            total = force[driven(plan, cells, named, name)].sum(axis=0)
        parts = zip("xyz", total, strict=True)
        found |= {f"force_{name}_{axis}": float(part) for axis, part in parts}
    return found
