"""Input of mechanics from biology: radii, receptors and forces between two times."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from multicell.behaviours.catalogue import SURFACE_ENERGY
from multicell.biology.active_forces import diffusion_of, push
from multicell.biology.driven import Named, prescribed
from multicell.biology.responding import value_of
from multicell.biology.surface import surface_force
from multicell.cells import Cells, FloatArray, IntArray, Signals, contact_rows, stokes_drag
from multicell.mechanics.motion import Motion
from multicell.population.extents import Extent, centre, distances

if TYPE_CHECKING:
    from multicell.biology.plan import BiologyPlan


def motion_of(
    plan: BiologyPlan,
    cells: Cells,
    radius: FloatArray,
    begin: float,
    end: float,
    *,
    signals: Signals,
    gradients: Signals,
    contacts: IntArray,
    named: Named | None = None,
) -> Motion:
    """Return the motion of cells between two times as mechanics needs it.

    - ``cells``: at ``begin``, n of them
    - ``radius``, (n,), µm: at ``end``
    - ``gradients``, name -> (n, 3), mM/µm: of the fields that chemotaxis follows, at the cells
    - ``contacts``, (m, 2): identities of the cells that have touched
    """
    length = end - begin
    rate = (radius - cells.radius) / length if length > 0.0 else np.zeros(len(cells))
    given = prescribed(plan, cells, named or {}, begin, end) if plan.motions else None
    held, velocity = given or (None, None)
    touching = contact_rows(cells, contacts) if plan.contact.remembers else None
    pushed = push(plan, cells, begin, gradients, signals)
    for further in (inflow_drag(plan, cells, radius, length), surface_force(plan, cells, begin)):
        if further is not None:
            pushed = np.zeros((len(cells), 6)) if pushed is None else pushed
            pushed[:, :3] += further
    young = cells.young
    stiffness = value_of(plan, "Young's modulus", 1.0, signals, cells, early=True)
    if stiffness is not None:
        young = young * stiffness
    sticky = value_of(plan, SURFACE_ENERGY, 1.0, signals, cells, early=True)
    return Motion(
        cells.radius,
        rate,
        young,
        cells.poisson,
        begin,
        end,
        bonds=bonds(plan, cells, signals, begin, end),
        push=pushed,
        kind=cells.kind if plan.types else None,
        touching=None if touching is None else np.sort(touching, axis=1),
        held=held,
        velocity=velocity,
        newborn=cells.age < length,
        diffusion=diffusion_of(plan, cells),
        sticky=sticky,
    )


def bonds(
    plan: BiologyPlan, cells: Cells, signals: Signals, begin: float, end: float
) -> FloatArray | None:
    """Return receptors and ligands at ``begin`` and their rates up to ``end``, (n, 4), or None.

    At ``begin`` they are those of the cells. At ``end`` they are the type's course at that time,
    times the factors of the concentrations that it finds at ``begin``. Between the two times they
    run linearly, so that a course with a kink between two coupling times is cut there.
    """
    if plan.receptors is None:
        return None
    now = np.stack([cells.receptor, cells.ligand], axis=1)
    then = bond_levels(plan, cells, signals, end)
    rate = (then - now) / (end - begin) if end > begin else np.zeros_like(now)
    return np.ascontiguousarray(np.hstack([now, rate]))


def bond_levels(plan: BiologyPlan, cells: Cells, signals: Signals, time: float) -> FloatArray:
    """Return the receptors and ligands that cells have at a time in these conditions, (n, 2).

    Concentrations that are not known yet have no effect.
    """
    levels = np.array([part.bonds(time) for part in plan.types.values()])[cells.kind]
    for column, behaviour in enumerate(("receptors", "ligands")):
        response = value_of(plan, behaviour, 1.0, signals, cells, early=True)
        if response is not None:
            levels[:, column] *= response
    return np.asarray(levels)


def inflow_velocity(
    cells: Cells, radius: FloatArray, dt: float, dimensions: int, removal: float
) -> FloatArray | None:
    """Return the velocity of the medium at each cell, (n, 3) µm/s; None where it is at rest.

    What a dead cell loses leaves the tissue as fluid, and tissue takes its place. Stokes drag
    against a medium at rest would hold up that inflow, and a core would come apart in place of
    closing. So the medium moves as an incompressible one with these sinks does: div u = -q, about
    the centre of all cells. With Q(r) the volume of tissue that is lost within r per time,

        u = -Q(r) / (4πr²) in space, -Q(r) / (2πr) in a plane,

    which keeps the part of space that cells fill. A cell that loses v makes room for v over that
    part.

    - ``radius``, (n,), µm: of the cells after a time ``dt`` in s
    - ``removal``: part of their volume with which cells vanish; its loss is spread over the rest
    """
    d = dimensions
    lost = np.where(cells.dead, cells.radius**d - radius**d, 0.0)
    lost = np.maximum(lost, 0.0)  # the dead may swell, which their contacts see to
    if not dt > 0.0 or not lost.any():
        return None
    origin = centre(cells, d)
    far = distances(cells, origin)
    order = np.argsort(far, kind="stable")
    within = np.empty(len(cells))
    within[order] = np.cumsum(lost[order]) - lost[order]  # no cell moves itself
    rate = within / (1.0 - removal) / Extent(cells, d, origin).packing_ratio() / dt
    # volumes of balls and areas of discs over those of the unit ball or disc: hence 1/d
    inward = np.divide(rate, d * far**d, out=np.zeros(len(cells)), where=far > 0.0)
    return -inward[:, None] * (cells.position - origin)


def inflow_drag(
    plan: BiologyPlan, cells: Cells, radius: FloatArray, dt: float
) -> FloatArray | None:
    """Return the force of the moving medium on each cell, 6πηr u: (n, 3) nN, or None."""
    if plan.inflow == 0.0 or plan.death is None:
        return None
    removal = plan.death.removal_fraction
    velocity = inflow_velocity(cells, radius, dt, plan.dimensions, removal)
    if velocity is None:
        return None
    return stokes_drag(plan.inflow) * cells.radius[:, None] * velocity
