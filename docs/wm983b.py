"""WM983b melanoma spheroids: one seeding fitted, two others predicted.

Problem   spheroids of 2,500, 5,000 and 10,000 cells in wells of still medium, from day 3 to day 21:
          radius R, and the inhibited and the necrotic radius over it, phi and eta
Data      docs/data/wm983b-5000.csv (Browning et al., eLife 10, 2021, e73020), one row a spheroid
Model     the scene `wm983b` with cells of twice the diameter (`multicell.coarsen`)
Fitted    seven parameters to the means of 5,000 cells; deviations are those of single spheroids
Beside    Greenspan's model (docs/programs/greenspan.py), five parameters, same data and likelihood,
          and courses without a model: `null_models`
Command   python docs/wm983b.py --fit                 the fit, kept in docs/data/wm983b-fit.json
          python docs/wm983b.py --predict 2500 10000  from what is kept (--json for programs)
          python docs/wm983b.py                       tables and the picture, from what is kept
          python docs/wm983b.py --switched            radii after a change from air to 2 %,
                                                      by the fit of wm983b_regimes.py
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

import multicell as mc
from multicell.report.plots.style import BLUE, QUIET, RED, save_figure, styled

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "programs"))
import greenspan  # noqa: E402

Array = NDArray[np.float64]
KEPT = HERE / "data" / "wm983b-fit.json"
FITTED = 5000
COARSE = 2
SEEDS = (1, 2)
NAMES = ("radius", "inhibited_ratio", "necrotic_ratio")
DAYS = np.array([3.0, 4.0, 5.0, 7.0, 10.0, 12.0, 14.0, 16.0, 18.0, 21.0])
LEAST, FLOOR = 8.0, 0.03
"""Smallest deviation of a radius, um, and that over R of what is 0 in all spheroids of a day."""
SEEDINGS = (2500, 5000, 10000)
BUDGET = 100
FREE = {
    "initial.count": "log 250:700",
    "growth.phases.G1.duration": "20:90 h",
    "nutrients.oxygen.uptake_per_volume": "log 0.02:0.06 mM/s",
    "nutrients.oxygen.quiescence": "log 0.018:0.05 mM",
    "nutrients.oxygen.necrosis": "log 0.004:0.0179 mM",
    "death.damage_time": "1.5:6 d",
    "death.lysis_time": "log 4:40 d",
}


def main() -> None:
    """Do what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fit", action="store_true")
    parser.add_argument("--predict", nargs="+", type=int, metavar="CELLS")
    parser.add_argument("--coarse", type=float, default=COARSE, help="width of cells, of --predict")
    parser.add_argument("--switched", action="store_true")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    if options.switched:
        show_switched(as_json=options.json)
    elif options.fit:
        fit()
    elif options.predict:
        found = predict(options.predict, json.loads(KEPT.read_text())["best"], options.coarse)
        if options.json:
            print(json.dumps({n: by_day(course) for n, course in found.items()}))
        else:
            for seeding, course in found.items():
                show(f"{seeding} cells", course)
                print("  rms / sd of R, phi R, eta R, all:", rated(seeding, radii(course)))
    else:
        pictures()


def show_switched(*, as_json: bool) -> None:
    """Print outer, inhibited and necrotic radius in um on the days after the switch."""
    import wm983b_regimes

    found = wm983b_regimes.switched_days()
    if as_json:
        print(json.dumps(found))
        return
    print("  day   outer  inhibited  necrotic / um")
    for day, row in found.items():
        print(f"  {day:>3s} {row[0]:7.1f} {row[1]:10.1f} {row[2]:9.1f}")


def specimens(seeding: int) -> Array:
    """Return day, R in um, phi and eta of single spheroids, (m, 4)."""
    lines = (HERE / "data" / f"wm983b-{seeding}.csv").read_text().splitlines()
    rows = csv.reader(line for line in lines if not line.startswith("#"))
    return np.array([[float(value) for value in row] for row in rows if row[0] != "day"])


def means(single: Array) -> tuple[Array, Array, Array]:
    """Return days (k,), and means and deviations over the spheroids of a day, (k, 3)."""
    days = np.unique(single[:, 0])
    groups = [single[single[:, 0] == day, 1:] for day in days]
    sd = np.array([group.std(axis=0, ddof=1) for group in groups])
    return days, np.array([group.mean(axis=0) for group in groups]), np.where(sd > 0, sd, FLOOR)


def mean_radii(seeding: int) -> tuple[Array, Array]:
    """Return means of three radii and their deviations, at least `LEAST`, (days, 3) um."""
    _, mean, sd = means(radii(specimens(seeding)))
    return mean, np.maximum(sd, LEAST)


def null_models(seeding: int) -> dict[str, Array]:
    """Return the three radii without a model of cells, (days, 3) um, by name.

    The first two know what the fit knows. The line knows the two other seedings, and persistence
    the seeding itself, but for the day in question: on the first day it has nothing, nan.
    """
    known, own = mean_radii(FITTED)[0], mean_radii(seeding)[0]
    low, high = (n for n in SEEDINGS if n != seeding)
    share = np.log(seeding / low) / np.log(high / low)
    line = mean_radii(low)[0] * (1 - share) + mean_radii(high)[0] * share
    return {
        "as 5,000": known,
        "5,000, other days": np.stack(
            [np.interp(DAYS + delay(seeding), DAYS, column) for column in known.T], axis=1
        ),
        "line through the other two": np.maximum(line, 0.0),
        "as on the day before": np.vstack([np.full((1, 3), np.nan), own[:-1]]),
    }


def delay(seeding: int) -> float:
    """Return by how many days tissue of other seedings is older: growth of 5,000 at first."""
    early = DAYS <= 10.0
    rate = np.polyfit(DAYS[early], np.log(mean_radii(FITTED)[0][early, 0] ** 3), 1)[0]
    return float(np.log(seeding / FITTED) / rate)


def radii(found: Array) -> Array:
    """Return R, phi R and eta R of an array whose last columns are R, phi and eta."""
    found = found.copy()
    found[..., -2:] *= found[..., -3, None]
    return found


def coarse(width: float = COARSE) -> mc.Scene:
    """Return the scene of 5,000 cells seeded, with larger and fewer cells."""
    return mc.coarsen("wm983b", width)


def fit() -> None:
    """Fit the parameters to the means of one seeding, and keep what predictions need."""
    days, mean, sd = means(specimens(FITTED))
    table = {"time / d": days}
    for k, (name, unit) in enumerate(zip(NAMES, (" / um", "", ""), strict=True)):
        table |= {f"{name}{unit}": mean[:, k], f"{name} sd{unit}": sd[:, k]}
    begin = time.monotonic()
    found = mc.fit(
        coarse(),
        table,
        FREE,
        seeds=1,
        repeats=8,
        budget=BUDGET,
        output=HERE.parent / "build" / "wm983b",
    )
    kept = {
        "best": dict(found.best.settings),
        "intervals": {name: [i.low, i.high] for name, i in found.intervals().items()},
        "draws": draws_of(found, 12),
        "chi_squared": found.best.chi_squared,
        "minutes": (time.monotonic() - begin) / 60,
    }
    ensembles = {}
    for seeding in SEEDINGS:
        tasks = [(seeding, draw, 1 + k, COARSE) for k, draw in enumerate(kept["draws"])]
        courses = run_all(tasks)
        ensembles[seeding] = np.round(courses, 4).tolist()
    kept["ensembles"] = ensembles
    KEPT.write_text(json.dumps(kept) + "\n")
    print(f"chi squared {kept['chi_squared']:.1f} of {mean.size} data, {kept['minutes']:.0f} min")
    for key, value in kept["best"].items():
        print(f"  {key} = {value}")


def draws_of(found: mc.Fit, count: int) -> list[dict[str, str]]:
    """Return draws from the posterior as settings of the scene."""
    shares = found.some_sample()
    ranges = found.problem.ranges
    chosen = shares[:: len(shares) // count][:count]
    return [
        {f.key: f.setting(f.value(float(x))) for f, x in zip(ranges, row, strict=True)}
        for row in chosen
    ]


def predict(seedings: list[int], best: dict[str, str], width: float = COARSE) -> dict[int, Array]:
    """Return R, phi and eta on the days of the data, (days, 3) by seeding: means over seeds."""
    count = round(int(best["initial.count"]) * (COARSE / width) ** 3)
    settings = {**best, "initial.count": str(count)}
    courses = run_all([(n, settings, seed, width) for n in seedings for seed in SEEDS])
    means = np.array(courses).reshape(len(seedings), len(SEEDS), -1, 3).mean(axis=1)
    return dict(zip(seedings, means, strict=True))


def run_all(tasks: list[Any]) -> list[Array]:
    """Run scenes side by side: cells seeded, settings, seed and width of cells of each."""
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        return list(pool.map(course, tasks))


def course(task: tuple[int, dict[str, str], int, float]) -> Array:
    """Return R, phi and eta of one run on the days of the data, (days, 3)."""
    seeding, settings, seed, width = task
    count = round(int(settings["initial.count"]) * seeding / FITTED)
    result = mc.run(coarse(width).with_changes({**settings, "initial.count": count, "seed": seed}))
    history = result.history
    return np.stack([np.interp(DAYS * 86400, history["time"], history[n]) for n in NAMES], axis=1)


def by_day(course: Array) -> dict[str, list[float]]:
    """Return R, phi and eta by day, for JSON."""
    rows = np.round(course, 4).tolist()
    return {f"{day:g}": row for day, row in zip(DAYS, rows, strict=True)}


def show(title: str, course: Array) -> None:
    """Print a course."""
    print(f"{title}\n  day      R/um   phi    eta")
    for day, (radius, phi, eta) in zip(DAYS, course, strict=True):
        print(f"  {day:4g} {radius:8.1f}  {phi:.3f}  {eta:.3f}")


def pictures() -> None:
    """Print how well model and competitors do, and draw them with the data."""
    kept = json.loads(KEPT.read_text())
    other = greenspan.fit(*means(specimens(FITTED)))
    print(other)
    print("rms of (model - mean) / sd                R  phi R  eta R   all   spheroids in 95 %")
    bands, rivals = {}, {}
    for seeding in SEEDINGS:
        bands[seeding] = np.array(kept["ensembles"][str(seeding)])
        rivals[seeding] = other.course(DAYS, seeding / FITTED)
        band = radii(bands[seeding])
        courses = {"wm983b": band.mean(axis=0), "Greenspan": radii(rivals[seeding])}
        for name, course in (courses | null_models(seeding)).items():
            print(f"{seeding:6d} cells, {name:27s} {rated(seeding, course)}   ", end="")
            print(f"{covered(seeding, band):.0%}" if name == "wm983b" else "")
    save_figure(draw(bands, rivals), HERE / "figures" / "wm983b.png")


def rated(seeding: int, course: Array) -> str:
    """Return rms (model - mean) / sd of three radii (um) and of all, as text."""
    mean, sd = mean_radii(seeding)
    off = ((course - mean) / sd)[~np.isnan(course).any(axis=1)]
    return " ".join(f"{rms(part):6.2f}" for part in (*off.T, off))


def rms(off: Array) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(off**2)))


def covered(seeding: int, band: Array) -> float:
    """Return the part of all radii of single spheroids within 1.96 deviations of the model.

    The variance is that of the mean over the posterior and that of spheroids of a day.
    """
    single, (_, sd) = radii(specimens(seeding)), mean_radii(seeding)
    rows = np.searchsorted(DAYS, single[:, 0])
    spread = np.sqrt(band.var(axis=0) + sd**2)[rows]
    return float((np.abs(single[:, 1:] - band.mean(axis=0)[rows]) <= 1.96 * spread).mean())


@styled
def draw(bands: dict[int, Array], rivals: dict[int, Array]) -> Figure:
    """Draw R, phi and eta over days for all seedings."""
    figure = Figure(figsize=(11.0, 8.4), layout="constrained")
    axes = figure.subplots(3, len(SEEDINGS), sharex=True, sharey="row")
    titles = ("radius R / µm", "inhibited radius / R", "necrotic radius / R")
    for column, seeding in enumerate(SEEDINGS):
        predicted = "" if seeding == FITTED else ", predicted"
        axes[0, column].set_title(f"{seeding:,} cells seeded{predicted}", fontsize=12)
        axes[2, column].set_xlabel("day")
        for row, title in enumerate(titles):
            ax, values = axes[row, column], bands[seeding][:, :, row]
            low, high = np.quantile(values, [0.025, 0.975], axis=0)
            ax.fill_between(DAYS, low, high, color=BLUE, alpha=0.25, lw=0)
            ax.plot(DAYS, values.mean(axis=0), color=BLUE, label="multicell, 95 % of the fit")
            ax.plot(DAYS, rivals[seeding][:, row], "--", color=QUIET, label="Greenspan 1972")
            single = specimens(seeding)
            ax.plot(
                single[:, 0], single[:, 1 + row], "o", ms=2.5, color=RED, alpha=0.6,
                label="single spheroids", zorder=0,
            )  # fmt: skip
            if column == 0:
                ax.set_ylabel(title)
    axes[0, 0].legend(fontsize=9.5, loc="lower right")
    return figure


if __name__ == "__main__":
    main()
