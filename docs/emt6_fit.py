"""Fit of the EMT6/Ro tissue of docs/emt6_ball.py to rims and growth, and what the data leave open.

Least squares on logarithms of the parameters, from many starts. Beside the data stand what is known
of the parameters otherwise (``KNOWN``), and the Crabtree effect as it was measured in single cells.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from emt6_ball import Array, Tissue, course, rim
from scipy.optimize import least_squares

DATA = Path(__file__).parent / "data"
RANGES = {
    "oxygen": (0.003, 0.1), "glucose": (0.005, 0.3), "crabtree": (0.05, 20.0),
    "half": (0.02, 10.0), "layer": (5.0, 250.0), "least": (1e-3, 0.3),
    "growth_half": (0.01, 1.0), "cycle": (10.0, 32.0), "lysis": (15.0, 1000.0),
    "cell": (1500.0, 6000.0),
}  # fmt: skip
"""Free parameters and how far they may go; units as in :class:`Tissue`."""
KNOWN = {
    "oxygen": (0.015, 0.7), "glucose": (0.06, 0.7), "layer": (50.0, 0.7), "half": (0.3, 1.0),
    "cycle": (20.0, 0.25), "lysis": (100.0, 0.7), "cell": (3200.0, 0.2),
}  # fmt: skip
"""Weak knowledge: a size, and the standard deviation of its logarithm (0.7 is a factor of 2)."""
CRABTREE = (1.9, 0.2)
"""Respiration at 0.4 over that at 5.5 mM glucose: nearly a factor of 2 (Casciari et al. 1992)."""
HALVES = {"one": [0, 2, 5, 7], "other": [1, 3, 4, 6]}
"""Rims by row of the table: every second one at 5 % O2, the others at 20 %."""
EARLY = 280.0


@dataclass(frozen=True)
class Measured:
    """All data: rims by condition, growth by time."""

    conditions: list[tuple[float, float]]
    rims: Array
    deviations: Array
    hours: Array
    cells: Array
    diameters: Array
    scatter: tuple[float, float]
    start: float


def measured() -> Measured:
    """Return what stands in the tables of docs/data."""
    rims, growth = _table("emt6-rims.csv"), _table("emt6-growth.csv")
    o, g = rims["nutrients.oxygen.boundary / mM"], rims["nutrients.glucose.boundary / mM"]
    late = growth["time / h"] > growth["start / h"]
    return Measured(
        list(zip(o.tolist(), g.tolist(), strict=True)), rims["viable_rim / um"],
        rims["viable_rim sd / um"], growth["time / h"][late], growth["proliferating"][late],
        growth["diameter / um"][late],
        (growth["proliferating sd / %"][0] / 100.0, growth["diameter sd / %"][0] / 100.0),
        float(growth["start / h"][0]),
    )  # fmt: skip


def _table(name: str) -> dict[str, Array]:
    """Return the columns of numbers of a table."""
    lines = [x for x in (DATA / name).read_text().splitlines() if not x.startswith("#")]
    rows = list(csv.DictReader(lines, skipinitialspace=True))
    return {
        key: np.array([float(row[key]) for row in rows]) for key in rows[0] if key != "label"
    }  # fmt: skip


def deviations(tissue: Tissue, data: Measured) -> Array:
    """Return computed less measured rims in standard deviations of the experiment."""
    found = np.array([rim(tissue, *condition) for condition in data.conditions])
    return (found - data.rims) / data.deviations


def growth_errors(tissue: Tissue, data: Measured, until: float) -> tuple[Array, Array]:
    """Return computed over measured numbers of cells and diameters, as logarithms."""
    use = data.hours <= until
    times, cells, diameters, _ = course(tissue, float(data.hours[use][-1]) - data.start)
    at = data.hours[use] - data.start
    return (
        np.log(np.interp(at, times, np.maximum(cells, 1.0)) / data.cells[use]),
        np.log(np.interp(at, times, diameters) / data.diameters[use]),
    )


def residuals(tissue: Tissue, data: Measured, rows: list[int], until: float) -> Array:
    """Return all that is squared and summed."""
    cells, diameters = growth_errors(tissue, data, until)
    respired = [1.0 + tissue.crabtree * tissue.half / (tissue.half + g) for g in (0.4, 5.5)]
    known = [np.log(getattr(tissue, name) / x) / s for name, (x, s) in KNOWN.items()]
    return np.nan_to_num(
        np.concatenate([
            deviations(tissue, data)[rows], cells / data.scatter[0], diameters / data.scatter[1],
            [(respired[0] / respired[1] - CRABTREE[0]) / CRABTREE[1]], known,
        ]), nan=100.0,
    )  # fmt: skip


def tissue_at(place: Array, fixed: dict[str, float] | None = None) -> Tissue:
    """Return the tissue with these logarithms of the parameters that are not fixed."""
    fixed = fixed or {}
    free = [name for name in RANGES if name not in fixed]
    values = dict(zip(free, np.exp(place).tolist(), strict=True)) | fixed
    return replace(
        Tissue(**values), start=(3.0 / (4.0 * np.pi) * 600.0 * values["cell"]) ** (1 / 3)
    )


def fit(
    data: Measured, rows: list[int], until: float, *, starts: int = 8, tries: int = 300,
    fixed: dict[str, float] | None = None, near: Tissue | None = None,
) -> tuple[Tissue, float]:  # fmt: skip
    """Return the best tissue and its sum of squares: from many starts, or from one near by."""
    free = [name for name in RANGES if name not in (fixed or {})]
    low, high = np.log(np.array([RANGES[name] for name in free])).T

    def function(place: Array) -> Array:
        return residuals(tissue_at(place, fixed), data, rows, until)

    if near is None:
        places = low + (high - low) * np.random.default_rng(0).random((tries, len(free)))
        places = sorted(places, key=lambda x: float(np.square(function(x)).sum()))[:starts]
    else:
        places = [np.clip(np.log([getattr(near, n) for n in free]), low + 1e-6, high - 1e-6)]
    best = min(
        (
            least_squares(function, x, bounds=(low, high), diff_step=2e-3, max_nfev=60)
            for x in places
        ),
        key=lambda found: float(found.cost),
    )
    return tissue_at(best.x, fixed), 2.0 * float(best.cost)


def profile(
    data: Measured, best: Tissue, name: str, factors: Array
) -> list[tuple[float, float]]:  # fmt: skip
    """Return values of a parameter, and the least sum of squares that the others reach there."""
    found, everything = [], list(range(len(data.rims)))
    for side in (factors[factors >= 1.0], factors[factors < 1.0][::-1]):
        near = best
        for factor in side:
            value = float(getattr(best, name) * factor)
            low, high = RANGES[name]
            if not low <= value <= high:
                break
            near, squares = fit(data, everything, np.inf, fixed={name: value}, near=near)
            found.append((value, squares))
    return sorted(found)


RULES = {
    "either is short": ("oxygen", "glucose", "layer", "no", "ng"),
    "either is short, Crabtree": ("oxygen", "glucose", "layer", "no", "ng", "crabtree", "half"),
    "too little ATP": ("oxygen", "glucose", "layer", "least"),
    "too little ATP, Crabtree": ("oxygen", "glucose", "layer", "least", "crabtree", "half"),
    "too little ATP, Crabtree and Pasteur": (
        "oxygen", "glucose", "layer", "least", "crabtree", "half", "pasteur", "pasteur_half",
    ),
}  # fmt: skip
"""When cells die, and the parameters that are fitted to the rims alone."""
MORE = {"no": (1e-4, 0.05), "ng": (1e-3, 3.0), "pasteur": (0.05, 5.0), "pasteur_half": (3e-3, 1.0)}
PASTEUR = (1.4, 0.1)
"""Uptake of glucose at 0.023 over that at 0.21 mM of oxygen (Casciari et al. 1992)."""


def fit_rule(data: Measured, names: tuple[str, ...], starts: int = 8) -> tuple[Tissue, Array]:
    """Return the best tissue of a rule, and its rims' deviations, fitted to all rims."""
    ranges = RANGES | MORE
    low, high = np.log(np.array([ranges[name] for name in names])).T

    def made(place: Array) -> Tissue:
        given = dict(zip(names, np.exp(place).tolist(), strict=True))
        ends = (given.pop("no"), given.pop("ng")) if "no" in given else None
        values = {"crabtree": 0.0, "half": 1.0, "least": 1.0} | given
        return Tissue(**values, thresholds=ends)

    def function(place: Array) -> Array:
        tissue, known = made(place), []
        if "crabtree" in names:
            most = [1.0 + tissue.crabtree * tissue.half / (tissue.half + g) for g in (0.4, 5.5)]
            known.append((most[0] / most[1] - CRABTREE[0]) / CRABTREE[1])
        if "pasteur" in names:
            h = tissue.pasteur_half
            most = [1.0 + tissue.pasteur * h / (h + o) for o in (0.023, 0.21)]
            known.append((most[0] / most[1] - PASTEUR[0]) / PASTEUR[1])
        return np.nan_to_num(np.concatenate([deviations(tissue, data), known]), nan=100.0)

    places = low + (high - low) * np.random.default_rng(0).random((400, len(names)))
    places = sorted(places, key=lambda x: float(np.square(function(x)).sum()))[:starts]
    found = [
        least_squares(function, x, bounds=(low, high), diff_step=2e-3, max_nfev=80) for x in places
    ]
    best = made(min(found, key=lambda one: float(one.cost)).x)
    return best, deviations(best, data)
