"""Fits of the EMT6/Ro tissue of emt6_ball.py, and what each set of data says of the others.

Least squares on logarithms of the parameters, from many starts. Beside the data stand what is
reported of the parameters (``KNOWN``), and two effects as they were measured in single cells.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from emt6_ball import Array, Tissue, ball, course
from scipy.optimize import least_squares

DATA = Path(__file__).parents[1] / "data"
SETS = ("rims", "pO2", "consumption")
RANGES = {
    "oxygen": (0.005, 0.03), "glucose": (0.01, 0.2), "crabtree": (0.3, 10.0), "half": (0.03, 2.0),
    "layer": (25.0, 100.0), "diffusion": (1000.0, 2000.0), "least": (0.005, 0.3),
    "pasteur": (0.02, 15.0), "pasteur_half": (5e-4, 1.0), "lactate": (150.0, 2e4),
    "harm": (0.5, 100.0), "low_oxygen": (1e-4, 0.02), "low_glucose": (1e-3, 1.0),
    "growth_half": (0.01, 1.0), "cycle": (10.0, 32.0), "lysis": (15.0, 1000.0),
    "cell": (1500.0, 6000.0),
}  # fmt: skip
"""Parameters and how far they may go; units as in :class:`Tissue`."""
FIELDS = ("oxygen", "glucose", "crabtree", "half", "layer", "diffusion")
PASTEUR = ("pasteur", "pasteur_half")
RULES = {
    "either": ("low_oxygen", "low_glucose"), "ATP": ("least",), "time": ("least", "harm"),
    "damage": ("least", "harm"), "lactate": ("least", "lactate"),
}  # fmt: skip
"""Rules of death and their own parameters."""
GROWTH = ("growth_half", "cycle", "lysis", "cell")
KNOWN = {
    "glucose": (0.03, 0.25), "layer": (50.0, 0.5), "diffusion": (1330.0, 0.1),
    "cycle": (20.0, 0.25), "lysis": (100.0, 0.7), "cell": (3200.0, 0.2),
}  # fmt: skip
"""Reported: a size, and the standard deviation of its logarithm."""
MEASURED = {"crabtree": (0.4, 5.5, 1.9, 0.2), "pasteur": (0.023, 0.21, 1.4, 0.1)}
"""Uptake at the first concentration (mM) over that at the second, and its standard deviation:
respiration over glucose and uptake of glucose over oxygen (Casciari et al. 1992)."""
SCATTER = {"pO2": 4.0, "consumption": 0.15}
"""Of one point: mmHg, and of the logarithm."""


@dataclass(frozen=True)
class Measured:
    """All data: rims and consumption by medium, oxygen over depth, growth over time."""

    media: list[tuple[float, float]]
    rims: Array
    deviations: Array
    consumption: Array
    pressures: dict[tuple[float, float, float], tuple[Array, Array]]
    hours: Array
    cells: Array
    diameters: Array
    scatter: tuple[float, float]
    start: float


def measured() -> Measured:
    """Return the tables of docs/data."""
    rims, growth, used, found = map(
        _table, ("emt6-rims.csv", "emt6-growth.csv", "emt6-consumption.csv", "emt6-po2.csv")
    )
    o, g = rims["nutrients.oxygen.boundary / mM"], rims["nutrients.glucose.boundary / mM"]
    late = growth["time / h"] > growth["start / h"]
    radius = 370.0 * np.cbrt(found["initial.count"] / 9620.0)  # of balls of the scene emt6-rim
    media = np.stack([*list(found.values())[:2], np.round(radius)], axis=1)
    pressures = {}
    for key in dict.fromkeys(map(tuple, media.tolist())):
        rows = (media == key).all(axis=1)
        pressures[key] = found["depth / um"][rows], found["oxygen / mmHg"][rows]
    return Measured(
        list(zip(o.tolist(), g.tolist(), strict=True)), rims["viable_rim / um"],
        rims["viable_rim sd / um"], used["rim_uptake_oxygen / mM/s"], pressures,
        growth["time / h"][late], growth["proliferating"][late],
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


def errors(tissue: Tissue, data: Measured) -> dict[str, Array]:
    """Return computed less measured: rims in sd, pressures in mmHg, consumption as logarithms."""
    balls = [ball(tissue, *medium) for medium in data.media]
    rims = (np.array([one.rim for one in balls]) - data.rims) / data.deviations
    used = np.log(np.array([one.consumption for one in balls]) / data.consumption)
    found = [
        ball(tissue, oxygen, glucose, radius).pressure(depth) - there
        for (oxygen, glucose, radius), (depth, there) in data.pressures.items()
    ]
    return {"rims": rims, "pO2": np.concatenate(found), "consumption": used}


def verdict(tissue: Tissue, data: Measured) -> tuple[float, list[float], float]:
    """Return the errors: rims (rms, sd), each profile (rms, mmHg), consumption (the worst)."""
    off, at, each = errors(tissue, data), 0, []
    for depth, _ in data.pressures.values():
        each.append(rms(off["pO2"][at : at + len(depth)]))
        at += len(depth)
    return rms(off["rims"]), each, float(np.abs(np.expm1(off["consumption"])).max())


def rms(values: Array) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def growth_errors(tissue: Tissue, data: Measured) -> tuple[Array, Array]:
    """Return computed over measured numbers of cells and diameters, as logarithms."""
    times, cells, diameters, _ = course(tissue, float(data.hours[-1]) - data.start)
    at = data.hours - data.start
    return (
        np.log(np.interp(at, times, np.maximum(cells, 1.0)) / data.cells),
        np.log(np.interp(at, times, diameters) / data.diameters),
    )


def residuals(tissue: Tissue, data: Measured, sets: tuple[str, ...], free: list[str]) -> Array:
    """Return all that is squared and summed."""
    off = errors(tissue, data) if set(sets) & set(SETS) else {}
    parts = [off[name] / SCATTER.get(name, 1.0) for name in sets if name in off]
    if "growth" in sets:
        cells, diameters = growth_errors(tissue, data)
        parts += [cells / data.scatter[0], diameters / data.scatter[1]]
    for effect, (low, high, ratio, sd) in MEASURED.items():
        if effect in free:
            size = getattr(tissue, effect)
            half = tissue.half if effect == "crabtree" else tissue.pasteur_half
            found = [1.0 + size * half / (half + c) for c in (low, high)]
            parts.append(np.array([(found[0] / found[1] - ratio) / sd]))
    known = [(getattr(tissue, n), *KNOWN[n]) for n in free if n in KNOWN]
    parts.append(np.array([np.log(value / size) / sd for value, size, sd in known]))
    return np.nan_to_num(np.concatenate(parts), nan=30.0)


def fit(
    data: Measured, near: Tissue, free: list[str], sets: tuple[str, ...] = SETS, *,
    starts: int = 8, tries: int = 600, fixed: tuple[str, ...] = (),
) -> tuple[Tissue, float]:  # fmt: skip
    """Return the best tissue and its sum of squares, from ``near`` and from random starts."""
    known, free = free, [name for name in free if name not in fixed]
    low, high = np.log(np.array([RANGES[name] for name in free])).T

    def at(place: Array) -> Tissue:
        values = dict(zip(free, np.exp(place).tolist(), strict=True))
        if "cell" in values:
            values["start"] = (3.0 / (4.0 * np.pi) * 600.0 * values["cell"]) ** (1 / 3)
        return replace(near, **values)

    def function(place: Array) -> Array:
        return residuals(at(place), data, sets, known)

    places = low + (high - low) * np.random.default_rng(0).random((tries, len(free)))
    places = sorted(places, key=lambda x: float(np.minimum(function(x) ** 2, 50.0).sum()))[:starts]
    places.append(np.clip(np.log([getattr(near, n) for n in free]), low + 1e-6, high - 1e-6))
    best = min(
        (
            least_squares(function, x, bounds=(low, high), diff_step=3e-3, max_nfev=60)
            for x in places
        ),
        key=lambda found: float(found.cost),
    )
    return at(best.x), 2.0 * float(best.cost)


def profile(
    data: Measured, best: Tissue, free: list[str], name: str, factors: Array
) -> list[tuple[float, float]]:
    """Return values of a parameter, and the least sum of squares that the others reach there."""
    found = []
    for side in (factors[factors >= 1.0], factors[factors < 1.0][::-1]):
        near = best
        for factor in side:
            value = float(getattr(best, name) * factor)
            if not RANGES[name][0] <= value <= RANGES[name][1]:
                break
            near, squares = fit(
                data, replace(near, **{name: value}), free, starts=0, tries=0, fixed=(name,)
            )
            found.append((value, squares))
    return sorted(found)
