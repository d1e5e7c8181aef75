"""What cells would find of a field on other grids, and the errors that follow from it.

All estimates solve for a copy of the field; the field itself is not changed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, final

import numpy as np

from multicell.errors import NutrientFailed
from multicell.nutrient.choosing.own_dip import own_dip
from multicell.nutrient.field import NutrientField
from multicell.scene.scales import MAX_NODES

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.nutrient.parameters import FieldParameters


_LEAST_RATIO: Final = 1.5
"""Ratio of two spacings below which their solutions say nothing on the error."""


_NEARLY: Final = 1e-9


@final
@dataclass(frozen=True, eq=False)
class Load:
    """What the cells ask of a field, and when.

    Attributes
    ----------
    position : (n, 3), µm
    radius : (n,), µm
    capacity : (n,), amol/s
        Largest uptake.
    production : (n,), amol/s, or None
        Secretion.
    begin, end : float, s
        Of the coupling step.
    """

    position: FloatArray
    radius: FloatArray
    capacity: FloatArray
    production: FloatArray | None
    begin: float
    end: float


@final
@dataclass(frozen=True, eq=False)
class Trial:
    """A field as it would be on another grid.

    Attributes
    ----------
    spacing : float, µm
        Of its grid; at most what was asked for.
    nodes : int
    iterations : int
        Of conjugate gradients; of shells, which are solved directly, Newton's.
    around : (n,), mM
        What each cell finds, without the dip that it makes itself.
    """

    spacing: float
    nodes: int
    iterations: int
    around: FloatArray


def on_grid(parameters: FieldParameters, geometry: str, spacing: float) -> FieldParameters:
    """Return the parameters of a field with a geometry, ``"box"`` or ``"radial"``, and spacing."""
    # cubes do not have the side of shells
    sides = parameters.nutrient.sides
    there = {face: x for face, x in sides.items() if face != "r+" or geometry == "radial"}
    nutrient = replace(parameters.nutrient, geometry=geometry, sides=there)
    return replace(parameters, nutrient=nutrient, spacing=spacing)


def trial(field: NutrientField, parameters: FieldParameters, load: Load) -> Trial:
    """Solve for a copy of a field with other parameters, such as :func:`on_grid` gives.

    A steady field is solved for at the end of the step. A transient one takes one implicit step
    from what it is at the beginning; see :func:`remembered`.

    Raises
    ------
    NutrientFailed
        As for :meth:`NutrientField.solve`.
    """
    other = _copied(field, parameters, load)
    if other.parameters.regime == "steady":
        iterations = _solved(other, load)
    else:
        iterations = _leapt(other, load)
    return Trial(other.layout.spacing, _nodes(other), iterations, _around(other, load))


def _copied(field: NutrientField, parameters: FieldParameters, load: Load) -> NutrientField:
    other = NutrientField(field.name, parameters)
    other.well_mixed = field.well_mixed
    if field.laid:
        other.restore(field.field(), load.begin)
    return other


def _nodes(field: NutrientField) -> int:
    return int(field.field().values.size)


def _around(field: NutrientField, load: Load) -> FloatArray:
    """Return what each cell finds without its own dip, (n,) mM."""
    taken = field.uptake(load.position, load.capacity)
    if load.production is not None:
        taken = taken - load.production
    diffusion = field.parameters.nutrient.diffusion
    dip = own_dip(field.layout, load.position, taken, diffusion)
    return np.asarray(field.sample(load.position) + dip)


def _solved(field: NutrientField, load: Load) -> int:
    report = field.solve(
        load.position, load.capacity, production=load.production, radius=load.radius,
        time=load.end,
    )  # fmt: skip
    return max(report.cg, report.newton)


def _leapt(field: NutrientField, load: Load) -> int:
    """Take one implicit step over the whole time of a load."""
    demand = {field.name: (load.capacity, load.production)}
    report = field.group.leap(
        load.position, demand, radius=load.radius, begin=load.begin, end=load.end
    )[field.name]
    return max(report.cg, report.newton)


def remembered(field: NutrientField, load: Load, since: float) -> tuple[NutrientField, Load]:
    """Return a transient field from which one long step leads to where it is at a step's end.

    The errors of a grid add up over the steps of a transient field, and one step of its own knows
    of the last alone. With the rate s at the end of the step, a field c has c = a + T s with
    a = c - T s: one implicit step from a, as long as the time T since the medium last changed. All
    that a grid gets wrong in that time shows in it. T is shorter where a would be below zero.

    Parameters
    ----------
    field
        At the beginning of the step; before the first solve, the medium.
    load
        The step.
    since : float, s

    Returns
    -------
    field
        A copy that holds a.
    load
        The long step.
    """
    other, dt = _copied(field, field.parameters, load), load.end - load.begin
    if not other.laid:
        other.group.fill(load.position, radius=load.radius, time=load.begin)
    layout, before = other.layout, other.values
    _leapt(other, load)
    if other.layout is not layout:
        before = other.layout.carried(before, layout, other.level(load.end))
    after = other.values
    rate = (after - before) / dt
    rises = rate > 0.0
    longest = float((after[rises] / rate[rises]).min(initial=np.inf))
    length = max(dt, min(load.end - since, longest))
    other.values = np.maximum(after - length * rate, 0.0)  # rounding alone is below zero
    return other, replace(load, begin=load.end - length)


def spacing_error(
    field: NutrientField, parameters: FieldParameters, load: Load, coarsest: float
) -> tuple[float, Trial]:
    """Estimate the error at the cells that the spacing of some parameters makes.

    The scheme is of second order: from a second solution with about twice the spacing, or half of
    it where that would be coarser than ``coarsest``, the error follows by Richardson's
    extrapolation: |c_h - c_H| / ((H/h)² - 1) on the finer of the two grids. Own dips of cells are
    left out: see :mod:`multicell.nutrient.choosing.own_dip`.

    Parameters
    ----------
    field, load
    parameters
        See :func:`on_grid`.
    coarsest : float, µm
        Spacing beyond which cells share cubes, and the scheme has no order.

    Returns
    -------
    error : float, mM
        The largest at any cell.
    Trial
        With the spacing.

    Raises
    ------
    NutrientFailed
        As for :func:`trial`.
    """
    found = trial(field, parameters, load)
    if 2.0 * found.spacing <= coarsest * (1.0 + _NEARLY):
        coarse = trial(field, replace(parameters, spacing=2.0 * found.spacing), load)
        ratio = coarse.spacing / found.spacing
        if ratio >= _LEAST_RATIO:
            return apart(found, coarse) / (ratio**2 - 1.0), found
    finer = trial(field, replace(parameters, spacing=0.5 * found.spacing), load)
    ratio = found.spacing / finer.spacing
    if ratio < _LEAST_RATIO:
        raise NutrientFailed(
            f"no grid of {field.name} has half the spacing of {found.spacing:g} um",
            "Give the field a spacing in place of a tolerance",
        )
    return apart(found, finer) * ratio**2 / (ratio**2 - 1.0), found


def apart(one: Trial, other: Trial) -> float:
    """Return by how much at most a cell finds something else on one grid than on another, mM."""
    return float(np.abs(one.around - other.around).max(initial=0.0))


def lag(
    field: NutrientField, parameters: FieldParameters, load: Load, levels: tuple[float, float]
) -> float:
    """Return how far a field is from its steady state one coupling step after a change, mM.

    Largest difference at any cell between the field marched for as long as the step, under error
    control in time, and its steady state, both on the same grid and in a medium that does not
    change.

    Parameters
    ----------
    field
        From which the march begins; before the first solve from the first of ``levels`` everywhere.
    parameters, load
        See :func:`trial`.
    levels : mM
        Of the field before the first solve, and of the medium.

    Raises
    ------
    NutrientFailed
        As for :meth:`NutrientField.advance`.
    """
    start, level = levels
    still = replace(parameters.nutrient, media=None)
    object.__setattr__(still, "boundary", level)  # a finite medium's may be beyond the bounds
    found = []
    for regime in ("transient", "steady"):
        other = _copied(field, replace(parameters, nutrient=still, regime=regime), load)
        other.well_mixed = None
        if regime == "steady":
            _solved(other, load)
        else:
            if not other.laid:
                other.group.fill(load.position, radius=load.radius, time=load.begin)
                other.values = other.layout.filled(start)
            other.advance(
                load.position, load.capacity, production=load.production, radius=load.radius,
                begin=load.begin, end=load.end,
            )  # fmt: skip
        found.append(other.sample(load.position))
    return float(np.abs(found[0] - found[1]).max(initial=0.0))


def finest_grid(trial: Trial, axes: int) -> float:
    """Return the spacing at which a grid like that of a trial has the most nodes allowed, µm.

    Parameters
    ----------
    trial
    axes
        Number of axes of the grid: 1 of shells, 2 or 3.
    """
    # counts of nodes are rounded up to sizes that suit the transforms, by up to a tenth an axis
    share: float = (trial.nodes / MAX_NODES) ** (1.0 / axes)
    return 1.1 * trial.spacing * share
