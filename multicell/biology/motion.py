"""What mechanics must know of a scene's cells between two times."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from multicell.biology import adhesion
from multicell.biology.active_forces import push
from multicell.biology.cycle import parting
from multicell.biology.driven import Named, prescribed
from multicell.biology.inflow import inflow_drag
from multicell.biology.responding import value_of
from multicell.biology.surface import surface_force
from multicell.cells import Cells, FloatArray
from multicell.mechanics.motion import Motion
from multicell.results.observables import contact_rows

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from multicell.biology.plan import BiologyPlan


def motion_of(
    plan: BiologyPlan,
    cells: Cells,
    radius: FloatArray,
    begin: float,
    end: float,
    *,
    concentrations: Mapping[str, FloatArray],
    gradients: Mapping[str, FloatArray],
    contacts: NDArray[np.int64],
    named: Named | None = None,
) -> Motion:
    """Return what mechanics must know of the cells between two times.

    - ``cells``: at ``begin``, n of them
    - ``radius``, (n,), µm: at ``end``
    - ``gradients``, name -> (n, 3), mM/µm: of the fields that chemotaxis follows, at the cells
    - ``contacts``, (m, 2): identities of the cells that have touched
    """
    length = end - begin
    rate = (radius - cells.radius) / length if length > 0.0 else np.zeros(len(cells))
    apart = parting(plan, cells, length)
    given = prescribed(plan, cells, named or {}, begin, end) if plan.motions else None
    held, velocity = given or (None, None)
    touching = contact_rows(cells, contacts) if plan.contact.remembers else None
    pushed = push(plan, cells, begin, gradients, end, named, concentrations)
    for further in (inflow_drag(plan, cells, radius, length), surface_force(plan, cells)):
        if further is not None:
            pushed = np.zeros((len(cells), 6)) if pushed is None else pushed
            pushed[:, :3] += further
    young = cells.young
    stiffness = value_of(plan, "Young's modulus", 1.0, concentrations, cells, early=True)
    if stiffness is not None:
        young = young * stiffness
    return Motion(
        cells.radius, rate, young, cells.poisson, begin, end,
        bonds=adhesion.bonds(plan, cells, concentrations, begin, end),
        push=pushed,
        kind=cells.kind if plan.types else None,
        touching=None if touching is None else np.sort(touching, axis=1),
        offset_pairs=None if apart is None else apart[0],
        offset=None if apart is None else apart[1],
        held=held, velocity=velocity,
    )  # fmt: skip
