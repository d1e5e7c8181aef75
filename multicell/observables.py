"""Numbers that describe a population: size, necrotic core, viable rim, radial profiles.

All functions take a state and return plain numbers or arrays; none of them changes a state.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import Cells, FloatArray, IntArray, State
from multicell.frame import Field, Frame

Mask = NDArray[np.bool_]

SUMMARY_UNITS: Final[Mapping[str, str]] = {
    "time": "s",
    "diameter": "um",
    "necrotic_radius": "um",
    "viable_rim": "um",
    "hypoxic_radius": "um",
    "largest_pressure": "kPa",
    "volume_released": "um^3",
    "wall": "s",
    "ledger": "amol",
    "integrator.largest_local_error": "um",
    "fields.spacing": "um",
    "fields.layer": "um",
    "fields.discretisation_error": "mM",
    "separation.time": "s",
    "separation.force": "nN",
}
"""Units of the dimensional entries of a summary; everything else is a count or a ratio."""


def centre(cells: Cells) -> FloatArray:
    """Return the centroid of all cells, weighted by volume: (3,), µm.

    Raises
    ------
    ValueError
        If there are no cells.
    """
    if len(cells) == 0:
        raise ValueError("a population of no cells has no centre")
    return np.average(cells.position, axis=0, weights=cells.volume)


def distances(cells: Cells, origin: FloatArray) -> FloatArray:
    """Return the distance of every cell's centre from ``origin``: (n,), µm."""
    return np.asarray(np.linalg.norm(cells.position - origin, axis=1))


def sphere_radius(cells: Cells, origin: FloatArray, mask: Mask | None = None) -> float:
    """Return the radius of the uniform ball with the cells' radius of gyration about ``origin``.

    A uniform ball of radius R has the mean square distance 3/5 R² from its centre, so that
    R² = 5/3 Σ V_i (|x_i - origin|² + 3/5 r_i²) / Σ V_i. The second term is the cell's own
    extent, which makes the formula exact for a single cell too. Cells that stick out count
    little and gaps between cells do not count at all.

    Parameters
    ----------
    cells
        The population.
    origin : (3,) µm
        Point from which distances are taken.
    mask : (n,) bool
        Cells to take; all of them when absent.

    Returns
    -------
    float
        Radius in µm; 0 if no cell is taken.
    """
    chosen = cells if mask is None else cells.take(mask)
    if len(chosen) == 0:
        return 0.0
    square = distances(chosen, origin) ** 2 + 0.6 * chosen.radius**2
    return float(np.sqrt(5.0 / 3.0 * np.average(square, weights=chosen.volume)))


def diameter(cells: Cells) -> float:
    """Return the diameter of the population in µm (:func:`sphere_radius`), 0 without cells."""
    return 2.0 * sphere_radius(cells, centre(cells)) if len(cells) else 0.0


def necrotic_radius(cells: Cells) -> float:
    """Return the radius of the necrotic core in µm, 0 if no cell is necrotic.

    The formula of :func:`sphere_radius` over necrotic cells about the centre of all cells; a
    core that is hollow, because its oldest cells were removed, is measured somewhat too large.
    """
    dead = cells.state == State.NECROTIC
    return sphere_radius(cells, centre(cells), dead) if dead.any() else 0.0


def viable_rim(cells: Cells) -> float:
    """Return the thickness of the layer outside the necrotic core in µm."""
    return 0.5 * diameter(cells) - necrotic_radius(cells)


def hypoxic_radius(cells: Cells, concentration: FloatArray, threshold: float) -> float:
    """Return the radius within which cells lack a nutrient, in µm; 0 if none does.

    The formula of :func:`sphere_radius` over the cells below the threshold, dead ones too.

    Parameters
    ----------
    cells
        The population.
    concentration : (n,) mM
        At the cells.
    threshold : mM
        Below it cells rest.
    """
    lacking = concentration < threshold
    return sphere_radius(cells, centre(cells), lacking) if lacking.any() else 0.0


def state_counts(cells: Cells) -> dict[str, int]:
    """Return the number of cells in each state, by the state's name in lower case."""
    counts = np.bincount(cells.state, minlength=len(State))
    return {state.name.lower(): int(counts[state]) for state in State}


def heterotypic_fraction(cells: Cells, contacts: IntArray) -> float:
    """Return the part of all contacts that join cells of different types, NaN without contacts.

    Parameters
    ----------
    cells
        All cells.
    contacts : (m, 2)
        Identities of the cells of each pair in contact.
    """
    order = np.argsort(cells.id)
    place = np.searchsorted(cells.id[order], contacts)
    present = np.isin(contacts, cells.id).all(axis=1)
    kind = cells.kind[order[np.minimum(place[present], max(len(cells) - 1, 0))]]
    return float((kind[:, 0] != kind[:, 1]).mean()) if len(kind) else float("nan")


def largest_pressure(cells: Cells) -> float:
    """Return the largest pressure of any cell in kPa, 0 without cells."""
    return float(cells.pressure.max()) if len(cells) else 0.0


def state_summary(time: float, cells: Cells) -> dict[str, Any]:
    """Return the part of a summary that follows from the cells alone.

    The units of its entries are those of :data:`SUMMARY_UNITS`.
    """
    return {
        "time": float(time),
        "cells": len(cells),
        "diameter": diameter(cells),
        "necrotic_radius": necrotic_radius(cells),
        "viable_rim": viable_rim(cells),
        "largest_pressure": largest_pressure(cells),
        "states": state_counts(cells),
    }


def history_row(time: float, step: int, cells: Cells, **extra: float) -> dict[str, float]:
    """Return one row of a run's history.

    Parameters
    ----------
    time, step
        Simulated time in s and number of coupling steps done.
    cells
        All cells.
    **extra
        More columns; a history keeps the columns of its first row.

    Returns
    -------
    dict
        ``time`` (s), ``step``, ``cells``, ``proliferating``, ``quiescent``, ``necrotic``,
        ``apoptotic``,
        ``diameter``, ``necrotic_radius``, ``viable_rim`` (µm), ``largest_pressure`` (kPa) and
        the extra columns, all as floats.
    """
    summary = state_summary(time, cells)
    states = summary.pop("states")
    row = {"time": summary.pop("time"), "step": step, **summary, **states, **extra}
    return {name: float(value) for name, value in row.items()}


@final
@dataclass(frozen=True, eq=False)
class RadialProfile:
    """Averages over spherical shells about the centre of a population.

    Attributes
    ----------
    edges : (b + 1,) float64, µm
        Boundaries of the shells.
    counts : (b,) int64
        Cells whose centre lies in the shell.
    fractions : state name -> (b,) float64
        Part of these cells that are in the state; NaN in a shell without cells.
    concentrations : nutrient name -> (b,) float64, mM
        Mean concentration at these cells; NaN in a shell without cells.
    pressure : (b,) float64, kPa
        Mean pressure of these cells; NaN in a shell without cells.
    """

    edges: FloatArray
    counts: IntArray
    fractions: Mapping[str, FloatArray]
    concentrations: Mapping[str, FloatArray]
    pressure: FloatArray

    @property
    def middles(self) -> FloatArray:
        """Radius half-way through each shell: (b,), µm."""
        return np.asarray(0.5 * (self.edges[1:] + self.edges[:-1]))


def radial_profile(frame: Frame, bins: int = 20) -> RadialProfile:
    """Return averages over ``bins`` shells of equal thickness that hold all cells.

    Raises
    ------
    ValueError
        If the frame has no cells or ``bins`` is below 1.
    """
    if bins < 1:
        raise ValueError(f"a profile needs at least 1 bin, got {bins}")
    cells = frame.cells
    radius = distances(cells, centre(cells))
    edges = np.linspace(0.0, max(float(radius.max()), float(cells.radius.max())), bins + 1)
    return RadialProfile(
        edges=edges,
        counts=np.histogram(radius, edges)[0],
        fractions={s.name.lower(): _means(radius, edges, cells.state == s) for s in State},
        concentrations={n: _means(radius, edges, c) for n, c in frame.concentrations.items()},
        pressure=_means(radius, edges, cells.pressure),
    )


def field_profile(field: Field, origin: FloatArray, edges: FloatArray) -> FloatArray:
    """Return the mean of a field over shells about ``origin``: (b,), in the field's unit.

    Parameters
    ----------
    field
        The field.
    origin : (3,) µm
        Common centre of the shells.
    edges : (b + 1,) µm
        Boundaries of the shells, increasing.

    Returns
    -------
    (b,) float64
        Means over the grid points; NaN in a shell that holds none.
    """
    if field.kind == "radial":
        return _means(field.axis(0) - field.origin[0], edges, field.values.ravel())
    axes = np.meshgrid(*(field.axis(k) - origin[k] for k in range(3)), indexing="ij", sparse=True)
    radius = np.sqrt(sum(axis**2 for axis in axes)).ravel()
    return _means(radius, edges, field.values.ravel())


def _means(radius: FloatArray, edges: FloatArray, values: NDArray[Any]) -> FloatArray:
    """Average ``values`` by shell; NaN where a shell is empty."""
    count = np.histogram(radius, edges)[0]
    total = np.histogram(radius, edges, weights=values.astype(float))[0]
    means = np.full(len(count), np.nan)
    np.divide(total, count, out=means, where=count > 0)
    return means
