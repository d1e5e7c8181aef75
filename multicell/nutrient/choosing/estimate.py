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
from multicell.nutrient.group import FieldGroup
from multicell.scene.scales import MAX_NODES

if TYPE_CHECKING:
    from collections.abc import Mapping

    from multicell.cells import FloatArray
    from multicell.nutrient.course import Demand
    from multicell.nutrient.parameters import FieldParameters

    Parameters = Mapping[str, FieldParameters]


_LEAST_RATIO: Final = 1.5
"""Ratio of two spacings below which their solutions say nothing on the error."""


_NEARLY: Final = 1e-9


@final
@dataclass(frozen=True, eq=False)
class Load:
    """What the cells ask of fields, and when.

    - ``position``, (n, 3), µm
    - ``radius``, (n,), µm
    - ``demand``, name -> (n,), amol/s, and (n,), amol/s, or None: largest uptake and secretion
    - ``begin``, ``end``, float, s: of the coupling step
    """

    position: FloatArray
    radius: FloatArray
    demand: Demand
    begin: float
    end: float


@final
@dataclass(frozen=True, eq=False)
class Trial:
    """Fields as they would be on another grid.

    - ``spacing``, float, µm: of their grid; at most what was asked for
    - ``nodes``, int
    - ``iterations``, int: of conjugate gradients; of shells, which are solved directly, Newton's
    - ``around``, (m, n), mM: what each cell finds of each field, without the dip that it makes
      itself. Those of fields with another tolerance than the first are multiplied so that they may
      have its errors.
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


def trial(fields: FieldGroup, parameters: Parameters, load: Load) -> Trial:
    """Solve for copies of fields with other parameters, such as :func:`on_grid` gives.

    Steady fields are solved for at the end of the step. Transient ones take one implicit step
    from what they are at the beginning; see :func:`remembered`.

    Raises NutrientFailed as for :meth:`FieldGroup.solve`.
    """
    other = copied(fields, parameters, load.begin)
    steady = other.first.parameters.regime == "steady"
    iterations = _solved(other, load) if steady else _leapt(other, load)
    first = other.first
    return Trial(first.layout.spacing, int(first.values.size), iterations, _around(other, load))


def copied(fields: FieldGroup, parameters: Parameters, time: float = 0.0) -> FieldGroup:
    """Return fields with the same values and media, and these parameters."""
    found = {}
    for name, field in fields.fields.items():
        found[name] = other = NutrientField(name, parameters[name])
        other.well_mixed = field.well_mixed
        if field.laid:
            other.restore(field.field(), time)
    return FieldGroup(found, fields.kinetics)


def _around(fields: FieldGroup, load: Load) -> FloatArray:
    """Return what each cell finds without its own dip, (m, n) mM; see :class:`Trial`."""
    first, rows = fields.first.parameters.nutrient.tolerance, []
    for name, field in fields.fields.items():
        capacity, production = load.demand[name]
        taken = field.uptake(load.position, capacity)
        if production is not None:
            taken = taken - production
        nutrient = field.parameters.nutrient
        dip = own_dip(field.layout, load.position, taken, nutrient.diffusion)
        share = first / nutrient.tolerance if first and nutrient.tolerance else 1.0
        rows.append(share * (field.sample(load.position) + dip))
    return np.array(rows)


def _solved(fields: FieldGroup, load: Load) -> int:
    reports = fields.solve(load.position, load.demand, radius=load.radius, time=load.end)
    return max(max(report.cg, report.newton) for report in reports.values())


def _leapt(fields: FieldGroup, load: Load) -> int:
    """Take one implicit step over the whole time of a load."""
    reports = fields.leap(
        load.position, load.demand, radius=load.radius, begin=load.begin, end=load.end
    )
    return max(max(report.cg, report.newton) for report in reports.values())


def remembered(fields: FieldGroup, load: Load, since: float) -> tuple[FieldGroup, Load]:
    """Return transient fields from which one long step leads to where they are at a step's end.

    The errors of a grid add up over the steps of a transient field, and one step of its own knows
    of the last alone. With the rate s at the end of the step, a field c has c = a + T s with
    a = c - T s: one implicit step from a, as long as the time T since the medium last changed. All
    that a grid gets wrong in that time shows in it. T is shorter where a would be below zero.

    - ``fields``: at the beginning of the step; before the first solve, the medium
    - ``load``: the step
    - ``since``, float, s

    Returns fields: copies that hold a; load: the long step.
    """
    own = {name: field.parameters for name, field in fields.fields.items()}
    other, dt = copied(fields, own, load.begin), load.end - load.begin
    if not other.first.laid:
        other.fill(load.position, radius=load.radius, time=load.begin)
    layout = other.first.layout
    before = {name: field.values for name, field in other.fields.items()}
    _leapt(other, load)
    length, rates = load.end - since, {}
    for name, field in other.fields.items():
        begun = before[name]
        if field.layout is not layout:
            begun = field.layout.carried(begun, layout, field.level(load.end))
        rates[name] = rate = (field.values - begun) / dt
        rises = rate > 0.0
        length = min(length, float((field.values[rises] / rate[rises]).min(initial=np.inf)))
    length = max(dt, length)
    for name, field in other.fields.items():
        field.values = np.maximum(field.values - length * rates[name], 0.0)  # rounding is below
    return other, replace(load, begin=load.end - length)


def spacing_error(
    fields: FieldGroup, parameters: Parameters, load: Load, coarsest: float
) -> tuple[float, Trial]:
    """Estimate the error at the cells that the spacing of some parameters makes.

    The scheme is of second order: from a second solution with about twice the spacing, or half of
    it where that would be coarser than ``coarsest``, the error follows by Richardson's
    extrapolation: |c_h - c_H| / ((H/h)² - 1) on the finer of the two grids. Own dips of cells are
    left out: see :mod:`multicell.nutrient.choosing.own_dip`.

    - ``parameters``: see :func:`on_grid`
    - ``coarsest``, float, µm: spacing beyond which cells share cubes, and the scheme has no order

    Returns error : float, mM: the largest at any cell; Trial: with the spacing.

    Raises NutrientFailed as for :func:`trial`.
    """
    found = trial(fields, parameters, load)
    if 2.0 * found.spacing <= coarsest * (1.0 + _NEARLY):
        coarse = trial(fields, _spaced(parameters, 2.0 * found.spacing), load)
        ratio = coarse.spacing / found.spacing
        if ratio >= _LEAST_RATIO:
            return apart(found, coarse) / (ratio**2 - 1.0), found
    finer = trial(fields, _spaced(parameters, 0.5 * found.spacing), load)
    ratio = found.spacing / finer.spacing
    if ratio < _LEAST_RATIO:
        raise NutrientFailed(
            f"no grid of {fields.names[0]} has half the spacing of {found.spacing:g} um",
            "Give the field a spacing in place of a tolerance",
        )
    return apart(found, finer) * ratio**2 / (ratio**2 - 1.0), found


def _spaced(parameters: Parameters, spacing: float) -> dict[str, FieldParameters]:
    return {name: replace(own, spacing=spacing) for name, own in parameters.items()}


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

    - ``field``: from which the march begins; before the first solve from the first of ``levels``
      everywhere
    - ``parameters``, ``load``: see :func:`trial`
    - ``levels``, mM: of the field before the first solve, and of the medium

    Raises NutrientFailed as for :meth:`NutrientField.advance`.
    """
    start, level = levels
    still = replace(parameters.nutrient, media=None)
    object.__setattr__(still, "boundary", level)  # a finite medium's may be beyond the bounds
    found = []
    for regime in ("transient", "steady"):
        own = replace(parameters, nutrient=still, regime=regime)
        group = copied(field.group, {field.name: own}, load.begin)
        other = group.first
        other.well_mixed = None
        if regime == "steady":
            _solved(group, load)
        else:
            if not other.laid:
                group.fill(load.position, radius=load.radius, time=load.begin)
                other.values = other.layout.filled(start)
            group.advance(
                load.position, load.demand, radius=load.radius, begin=load.begin, end=load.end
            )
        found.append(other.sample(load.position))
    return float(np.abs(found[0] - found[1]).max(initial=0.0))


def finest_grid(trial: Trial, axes: int) -> float:
    """Return the spacing at which a grid like that of a trial has the most nodes allowed, µm.

    - ``axes``: number of axes of the grid: 1 of shells, 2 or 3
    """
    # counts of nodes are rounded up to sizes that suit the transforms, by up to a tenth an axis
    share: float = (trial.nodes / MAX_NODES) ** (1.0 / axes)
    return 1.1 * trial.spacing * share
