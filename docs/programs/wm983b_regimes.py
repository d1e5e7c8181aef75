"""WM983b melanoma spheroids in air and in 2 % oxygen, fitted together, and the switch predicted.

Data      docs/data/wm983b-oxygen.csv: means of radii over spheroids of a day, and deviations
Model     the variants of wm983b_mechanisms.py, each fitted to air and 2 % oxygen at once
Search    CMA-ES (Hansen 2016, arXiv:1604.00772) on the places of all parameters in their ranges
Predicted spheroids that go from air to 2 % oxygen on day 2, whose data no fit has seen
Command   python docs/programs/wm983b_regimes.py --fit less relative   fits, in wm983b-regimes.json
          python docs/programs/wm983b_regimes.py                       tables and the picture
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import wm983b_mechanisms as mechanisms
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.stats import chi2
from wm983b_mechanisms import BEGIN, MECHANISMS

import multicell as mc
from multicell.calibration.fitting.problem import free_of
from multicell.errors import MulticellError
from multicell.measured.data import read_data
from multicell.measured.table import read_measurements
from multicell.report.plots.style import BLUE, QUIET, RED, save_figure, styled

Array = NDArray[np.float64]

HERE = Path(__file__).parent.parent
KEPT = HERE / "data" / "wm983b-regimes.json"
REGIMES = ("air", "hypoxia")
RADII = ("radius", "inhibited_radius", "necrotic_radius")
COLUMNS = ("outer", "inhibited", "necrotic")
LEAST = 8.0
"""Smallest standard deviation of a radius, um: that of a cell."""
DAYS = np.array([2.0, 3.0, 4.0, 6.0, 8.0])
FIRST, FURTHER = 240, 75
"""Sets of parameters that are tried for the first mechanism, and from its best for each other."""
DRAWS, SEEDS, SEARCHED = 10, (1, 2, 3, 4), (1, 2)
BLIND = ("less", "relative")
"""Mechanisms fitted before the data of the switch were read, one of which predicts it."""


@dataclass(frozen=True)
class Own:
    """A parameter that is no key of a scene, between two numbers."""

    key: str
    low: float
    high: float

    def value(self, share: float) -> float:
        """Return the value at a share of the range."""
        return self.low + share * (self.high - self.low)

    def setting(self, value: float) -> float:
        """Return the value as it is kept."""
        return round(value, 4)


def main() -> None:
    """Do what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fit", nargs="*", choices=[*MECHANISMS], metavar="MECHANISM")
    wanted = parser.parse_args().fit
    if wanted is None:
        pictures()
        return
    for name in wanted or MECHANISMS:
        keep(name, fit(name))


def measured(regime: str) -> tuple[Array, Array, Array]:
    """Return days (k,), and means and deviations (um) of the three radii, (k, 3)."""
    return measured_columns(regime, COLUMNS)


def measured_columns(regime: str, columns: Sequence[str]) -> tuple[Array, Array, Array]:
    """Return days (k,), and means and deviations (um) of some columns, (k, m)."""
    file = "wm983b-switched.csv" if regime == "switched" else "wm983b-oxygen.csv"
    lines = (HERE / "data" / file).read_text().splitlines()
    rows = csv.DictReader(line for line in lines if not line.startswith("#"))
    chosen = [row for row in rows if row["regime"] == regime]
    mean = np.array([[float(row[f"{name}_um"]) for name in columns] for row in chosen])
    sd = np.array([[float(row[f"{name}_sd_um"]) for name in columns] for row in chosen])
    return np.array([float(row["day"]) for row in chosen]), mean, np.maximum(sd, LEAST)


def fit(name: str) -> dict[str, Any]:
    """Fit a mechanism to both regimes; return what is kept of it."""
    begin, cpu = time.monotonic(), time.process_time()
    scene, ranges = mechanisms.variant(name), ranges_of(name)
    kept = read_kept()

    def settings(shares: Sequence[float]) -> dict[str, str]:
        pairs = zip(ranges, shares, strict=True)
        return {f.key: f.setting(f.value(float(share))) for f, share in pairs}

    def misfit(shares: Array) -> float:
        return chi_squared(scene, settings(shares))

    first, begin_at = start_of(ranges, kept), MECHANISMS[name].begin
    known = bool(kept)
    width = 0.12 if known else 0.25
    if begin_at:
        first, width = np.array([begin_at[f.key] for f in ranges]), 0.04
    tried = search(misfit, first, width, FURTHER if known else FIRST)
    tried.sort(key=lambda pair: pair[0])
    least, best = tried[0][0], settings(tried[0][1])
    # those that the data do not tell from the best, by the misfit that even the best has
    data = sum(measured(regime)[1].size for regime in REGIMES)
    scale = max(least / max(data - len(ranges), 1), 1.0)
    limit = least + scale * float(chi2.ppf(0.95, len(ranges)))
    region = [(value, shares) for value, shares in tried if value <= limit]
    draws = [settings(s) for _, s in spread_out(region, DRAWS)]
    inside = np.array([shares for _, shares in region])
    return {
        "best": best,
        "shares": dict(zip((f.key for f in ranges), np.round(tried[0][1], 4), strict=True)),
        "chi_squared": round(least, 1),
        "tried": len(tried),
        "within": len(region),
        "ranges": {
            f.key: [
                f.setting(f.value(float(end))) for end in (inside[:, k].min(), inside[:, k].max())
            ]
            for k, f in enumerate(ranges)
        },
        "draws": draws,
        "minutes": round((time.monotonic() - begin) / 60, 1),
        "cpu": round(time.process_time() - cpu),
        "courses": {regime: best_course(name, best, regime) for regime in (*REGIMES, "switched")},
        "bands": {
            regime: [course(name, draw, regime, 11 + k) for k, draw in enumerate(draws)]
            for regime in (*REGIMES, "switched")
        },
    }


def ranges_of(name: str) -> Sequence[Any]:
    """Return the free parameters of a mechanism as a fit reads them."""
    table = read_measurements({"time / d": [1.0], "radius / um": [200.0]}, None, None)
    keys = free_of(mechanisms.free(name), read_data(table, mechanisms.variant(name)))[0]
    return [*keys, *(Own(key, *ends) for key, ends in MECHANISMS[name].own.items())]


def start_of(ranges: Sequence[Any], kept: dict[str, Any]) -> Array:
    """Return where a search begins: at the best of the fit that shares most of its parameters.

    What that one lacks begins where the next has it.
    """
    keys = {f.key for f in ranges}
    near = sorted(
        kept.values(), key=lambda each: (-len(keys & {*each["shares"]}), each["chi_squared"])
    )
    known = {key: place for each in reversed(near) for key, place in each["shares"].items()}
    return np.array([known.get(f.key, GUESS.get(f.key, 0.5)) for f in ranges])


GUESS = {
    "initial.count": 0.67,
    "growth.phases.G1.duration": 0.45,
    "nutrients.oxygen.uptake_per_volume": 0.85,
    "nutrients.oxygen.layer": 0.5,
    "nutrients.oxygen.quiescence": 0.4,
    "death.damage_time": 0.55,
    "death.lysis_time": 0.8,
    "death.repair_rate": 0.05,
    "nutrients.oxygen.growth_half_saturation": 0.3,
    "nutrients.oxygen.half_saturation": 0.4,
    "networks.pasteur.parameters.uptake": 0.85,
    "networks.pasteur.parameters.left": 0.95,
}
"""Where the first search begins in the ranges."""


def search(
    misfit: Callable[[Array], float], first: Array, width: float, most: int
) -> list[tuple[float, Array]]:
    """Return all points that were tried with their misfits, in the unit cube: CMA-ES."""
    import cma  # nothing else here needs it

    ends = {"bounds": [0, 1], "maxfevals": most, "seed": 1, "verbose": -9}
    strategy = cma.CMAEvolutionStrategy(first, width, ends)
    tried: list[tuple[float, Array]] = [(misfit(first), first)]
    while not strategy.stop():
        points = strategy.ask()
        found = [misfit(point) for point in points]
        strategy.tell(points, found)
        tried += zip(found, points, strict=True)
        print(len(tried), round(min(value for value, _ in tried), 1), flush=True)
    return tried


def spread_out(region: list[tuple[float, Array]], count: int) -> list[tuple[float, Array]]:
    """Return the best point and others of a region, each as far as can be from those before."""
    chosen = region[:1]
    while len(chosen) < min(count, len(region)):
        away = [min(float(np.linalg.norm(x - y)) for _, y in chosen) for _, x in region]
        chosen.append(region[int(np.argmax(away))])
    return chosen


def chi_squared(scene: mc.Scene, settings: dict[str, Any]) -> float:
    """Return the sum of squared deviations from both regimes; infinite where a run fails.

    Means of two runs are compared: whether a core begins before or after a day, one decides by
    chance.
    """
    total = 0.0
    for regime in REGIMES:
        days, mean, sd = measured(regime)
        one, begin = mechanisms.in_regime(scene, regime, settings), settings.get(BEGIN, 0.0)
        try:
            runs = [radii(one.with_changes({"seed": seed}), days, begin) for seed in SEARCHED]
        except MulticellError:
            return math.inf
        total += float((((np.mean(runs, axis=0)[:, :3] - mean) / sd) ** 2).sum())
    return total


def radii(scene: mc.Scene, days: Array, begin: float = 0.0) -> Array:
    """Return outer, inhibited, necrotic and hypoxic radius on given days of a run, um.

    The run begins on the day ``begin``.
    """
    history = mc.run(scene).history
    names = (*RADII, "hypoxic_radius_oxygen")
    times = (days - begin) * 86400
    return np.stack([np.interp(times, history["time"], history[name]) for name in names], axis=1)


def course(name: str, settings: dict[str, Any], regime: str, seed: int) -> list[list[float]]:
    """Return the radii of a regime on all days, um, (days, 4)."""
    scene = mechanisms.in_regime(mechanisms.variant(name), regime, {**settings, "seed": seed})
    return np.round(radii(scene, DAYS, settings.get(BEGIN, 0.0)), 1).tolist()


def best_course(name: str, settings: dict[str, Any], regime: str) -> list[list[float]]:
    """Return the same at the best point, the mean over seeds."""
    runs = [course(name, settings, regime, seed) for seed in SEEDS]
    return np.round(np.mean(runs, axis=0), 1).tolist()


def chosen(kept: dict[str, Any]) -> str:
    """Return the mechanism that fits best for the number of its parameters (Akaike), of the blind.

    By the means of fresh runs: the best single run of a search owes some of that to its seed.
    """
    known = [name for name in BLIND if name in kept]
    return min(known, key=lambda name: fresh_misfit(kept[name]) + 2 * len(kept[name]["best"]))


def fresh_misfit(found: dict[str, Any]) -> float:
    """Return the sum of squared deviations of fresh runs' means from both regimes."""
    return sum(float((off(found, regime) ** 2).sum()) for regime in REGIMES)


def off(found: dict[str, Any], regime: str) -> Array:
    """Return (mean of fresh runs - measured) / sd of the three radii, (days, 3)."""
    days, mean, sd = measured(regime)
    course = np.array(found["courses"][regime])[np.searchsorted(DAYS, days)]
    return (course[:, :3] - mean) / sd


def switched_days() -> dict[str, list[float]]:
    """Return outer, inhibited and necrotic radius after the switch by day, um, of new runs."""
    kept = read_kept()
    name = chosen(kept)
    rows = best_course(name, kept[name]["best"], "switched")
    days = zip(DAYS.tolist(), rows, strict=True)
    return {f"{day:g}": row[:3] for day, row in days if day > mechanisms.SWITCH}


def pictures() -> None:
    """Print how well models and null models do, and draw the model that was chosen."""
    import wm983b_nulls

    kept = read_kept()
    print("rms of (model - mean) / sd     outer  inhibited  necrotic    all   hypoxic")
    for name, found in kept.items():
        for regime in (*REGIMES, "switched"):
            days, mean, sd = measured_columns(regime, ("pimonidazole",))
            hypoxic = np.array(found["courses"][regime])[np.searchsorted(DAYS, days), 3:]
            show(f"{name}, {regime}", off(found, regime), rms((hypoxic - mean) / sd))
    days, mean, sd = measured("switched")
    for name, radii_after in wm983b_nulls.predictions(days).items():
        show(name, (radii_after - mean) / sd, None)
    save_figure(draw(kept[chosen(kept)]), HERE / "figures" / "wm983b-regimes.png")


def show(title: str, off: Array, hypoxic: float | None) -> None:
    """Print the rms of deviations (days, 3) of each radius and of all."""
    parts = "".join(f"{rms(part):9.2f}" for part in (*off.T, off))
    print(f"{title:28s}{parts}" + ("" if hypoxic is None else f"{hypoxic:9.2f}"))


def rms(values: Array) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(values**2)))


@styled
def draw(found: dict[str, Any]) -> Figure:
    """Draw three radii in three regimes: means with deviations, and the model with its range."""
    figure = Figure(figsize=(11.0, 4.2), layout="constrained")
    axes = figure.subplots(1, 3, sharey=True)
    titles = ("air, fitted", "2 % oxygen, fitted", "air, 2 % from day 2 on: predicted")
    for ax, regime, title in zip(axes, (*REGIMES, "switched"), titles, strict=True):
        days, mean, sd = measured(regime)
        bands, course = np.array(found["bands"][regime]), np.array(found["courses"][regime])
        for k, (name, color) in enumerate(zip(COLUMNS, (BLUE, QUIET, RED), strict=True)):
            low, high = bands[..., k].min(axis=0), bands[..., k].max(axis=0)
            ax.fill_between(DAYS, low, high, color=color, alpha=0.2, lw=0)
            ax.plot(DAYS, course[:, k], color=color, label=f"{name} radius")
            ax.errorbar(days, mean[:, k], sd[:, k], fmt="o", ms=4, color=color, capsize=2)
        ax.set(title=title, xlabel="day")
    axes[0].set_ylabel("radius / µm")
    axes[0].legend(fontsize=9.5)
    return figure


def read_kept() -> dict[str, Any]:
    """Return the stored parts of the fits, by mechanism."""
    return json.loads(KEPT.read_text()) if KEPT.exists() else {}


def keep(name: str, found: dict[str, Any]) -> None:
    """Keep a fit beside those of other mechanisms."""
    kept = read_kept()
    kept[name] = found
    KEPT.write_text(json.dumps(kept) + "\n")
    print(name, f"chi squared {found['chi_squared']:.1f}, {found['minutes']} min", flush=True)


if __name__ == "__main__":
    main()
