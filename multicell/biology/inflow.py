"""The medium that drags the cells flows in to where dead cells lose volume.

What a dead cell loses leaves the tissue as fluid, and tissue takes its place. Stokes drag against a
medium at rest would hold up that inflow, and a core would come apart in place of closing. So the
medium moves as an incompressible one with these sinks does: div u = -q, about the centre of all
cells. With Q(r) the volume of tissue that is lost within r per time,

    u = -Q(r) / (4πr²) in space, -Q(r) / (2πr) in a plane,

which keeps the part of space that cells fill. A cell that loses v makes room for v over that part.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from multicell.cells import Cells, FloatArray, stokes_drag
from multicell.results.observables import Extent, centre, distances

if TYPE_CHECKING:
    from multicell.biology.plan import BiologyPlan


def inflow_velocity(
    cells: Cells, radius: FloatArray, dt: float, dimensions: int, removal: float
) -> FloatArray | None:
    """Return the velocity of the medium at each cell, (n, 3) µm/s; None where it is at rest.

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
