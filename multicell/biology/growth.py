"""Growth of volume, limited by nutrient and pressure, and loss of volume after death.

Growth is of second order in the coupling step, from rates that are known anyway. Within a coupling
step the factors of growth are those of its beginning, f₀. When it has ended those of its end are
known, f₁: the trapezoidal rule gives Δt (f₀ + f₁)/2 in place of Δt f₀. So each cell notes Δt (f₁ -
f₀)/2, the time for which it has yet to grow (:attr:`multicell.cells.Cells.lag`), and makes half of
that good in each of the next steps. All of it at once would be the method of Adams and Bashforth,
which is stable for half of the steps that Euler's is; half of it is stable for three quarters of
them (z-transform: for |λ| Δt < 3/2), and only the lag is larger.

A cell that dies has grown until its own time within the step, and shrunk since
(:func:`multicell.biology.states.die`).

Growth stays between none and twice that of the rates at the beginning of its step: what a cell
that hardly grows has grown too much stays noted. Decisions to rest fall on the end of the step
that is nearest to their time (:func:`multicell.biology.states.deciding`), and are not counted.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from multicell.biology.responding import combine_responses
from multicell.cells import Cells, FloatArray, IntArray, Mask, Signals, State, rows_before

if TYPE_CHECKING:
    from multicell.biology.plan import BiologyPlan
    from multicell.scene.parts import Death


_GROWING = int(State.PROLIFERATING)  # numbers compare with arrays faster than names do
_SHARE = 0.5  # of the lag that is made good in a step
_REMAINS = 1e-3
"""Part of the volume at which dead cells are removed, which stays until the step ends and they are.

A cell that is lysed in a small part of the step would be none before: forces need a radius.
"""


def growth_factor(
    plan: BiologyPlan, signals: Signals, pressure: FloatArray, cells: Cells | None = None
) -> FloatArray:
    """Return how fast cells would grow here, as a fraction of unlimited growth, (n,).

    The factor combines all responses of the growth rate (:mod:`multicell.biology.responding`).
    Those of the short forms: Monod's c / (K + c) of nutrients that growth needs, and of the ATP
    made in place of c where the scene has ``energy`` limit it, I / (I + c) of those that inhibit
    it, and min(1, max(0, 1 - p / p_crit)): pressure slows growth linearly and stops it at the
    critical pressure, tension does not speed it up (J. Monod, Annu. Rev. Microbiol. 3 (1949) 371;
    A. N. Malmi-Kakkada et al., Phys. Rev. X 8 (2018) 021025). It describes the surroundings only;
    which cells do grow is decided in :func:`growing`.

    Concentrations are in mM, the ``pressure`` of the neighbours in kPa, tension negative. Without
    ``cells`` responses of single types, or to the age or size of a cell, are left out.
    """
    pressure = np.asarray(pressure, dtype=np.float64)
    if plan.growth is None:
        return np.zeros_like(pressure)
    known = plan.responses.get("growth rate", ())
    if cells is None:
        known = tuple(part for part in known if part.is_local)
    return combine_responses(known, 1.0, signals, cells, pressure)


def growing(plan: BiologyPlan, cells: Cells, phase: NDArray[np.int8] | None = None) -> Mask:
    """Return which cells grow as their surroundings allow, (n,).

    This alone decides it: for volumes, for what is made good, and for the clock of the cycle.

    - ``phase``, (n,): where cells have come to within a step; None: as their column says
    """
    living = cells.state == _GROWING
    if not plan.phased:
        return np.asarray(living)
    return np.asarray(living & plan.grows[cells.phase if phase is None else phase])


def volumes_after(plan: BiologyPlan, cells: Cells, factor: FloatArray, dt: float) -> FloatArray:
    """Return the volume of each cell after a time ``dt``.

    Proliferating cells grow by the scene's law (:mod:`multicell.behaviours.growth_laws`), so that
    one that nothing limits doubles in its cycle time; quiescent cells keep their volume. Necrotic
    cells shrink as V' = -V / lysis_time, after they have swollen, where the scene has them swell,
    as V' = V ln(swelling) / swelling_time; apoptotic ones as V' = -V / apoptosis_time.
    All is integrated exactly for the given factor. Growth may pass the division volume within the
    step: the excess goes to the daughters.

    - ``dt``: length of the step, s
    """
    volume = cells.volume
    law = plan.law
    if law is not None and not plan.phased:
        birth, grow = plan.birth_volumes(cells.kind), growing(plan, cells)
        if law.constant:
            volume += np.where(grow, dt * (factor * birth / cells.cycle_time), 0.0)
        else:
            share = np.where(grow, dt * factor / cells.cycle_time, 0.0)
            volume = np.where(grow, law.volume_after(volume, share, birth), volume)
    if plan.death is not None and np.count_nonzero(cells.dead):
        dead = cells.dead.nonzero()[0]
        birth, state = plan.birth_volumes(cells.kind[dead]), cells.state[dead]
        volume[dead] = shrunk(plan.death, birth, volume[dead], state, cells.age[dead], dt)
    return volume


def shrunk(
    death: Death,
    birth: float | FloatArray,
    volume: FloatArray,
    state: NDArray[np.int8],
    since: Any,
    dt: Any,
) -> FloatArray:
    """Return the volumes of dead cells after ``dt`` s, a time ``since`` death, (n,) µm³.

    - ``birth``, (n,) or one for all, ``volume``, (n,): at birth and now, µm³
    - ``state``, (n,): values of :class:`multicell.cells.State`
    """
    lost = _necrotic_factor(death, np.broadcast_to(since, state.shape), dt)
    left = volume * np.where(state == State.NECROTIC, lost, np.exp(-dt / death.apoptosis_time))
    remains = _REMAINS * death.removal_fraction * birth
    return np.maximum(left, np.minimum(volume, remains))


def _necrotic_factor(death: Death, since: FloatArray, dt: Any) -> FloatArray:
    """Return the volume of necrotic cells after ``dt`` over that now, a time ``since`` death."""
    if death.swelling == 1.0:
        return np.broadcast_to(np.exp(-dt / death.lysis_time), since.shape)
    swelling = np.clip(death.swelling_time - since, 0.0, dt)
    rate = np.log(death.swelling) / death.swelling_time
    return np.asarray(np.exp(rate * swelling - (dt - swelling) / death.lysis_time))


def corrected_factor(plan: BiologyPlan, cells: Cells, factor: FloatArray, dt: float) -> FloatArray:
    """Return the factor at which cells grow in a step of ``dt`` s, with the growth made good, (n,).

    ``factor``, (n,): that of the step's beginning; see
    :func:`growth_factor`.
    """
    if dt <= 0.0 or not np.count_nonzero(cells.lag):
        return factor
    most = np.abs(factor)
    extra = np.minimum(np.maximum(_SHARE / dt * cells.lag, -most), most)
    return np.where(growing(plan, cells), factor + extra, factor)


def lag_after(
    plan: BiologyPlan,
    began: Cells,
    before: FloatArray,
    cells: Cells,
    now: FloatArray,
    dt: float,
    row: IntArray | None = None,
) -> FloatArray:
    """Return for how long each cell has yet to grow after a step, (n,) s of unlimited growth.

    - ``began``, ``before``: the cells of the step's beginning, and their factors
    - ``cells``, ``now``: those of its end, whose lag lacks this step, and their factors
    - ``dt``: its length, s
    - ``row``, (n,): the rows of the cells or their mothers then, where they are known
    """
    grew = growing(plan, began)
    if cells.id is not began.id:  # as in steps with divisions
        row = rows_before(began, cells) if row is None else row
        grew, before = grew.take(row), before.take(row)
    change = np.where(grew & growing(plan, cells), now - before, 0.0)
    return np.where(cells.dead, 0.0, cells.lag + 0.5 * dt * change)
