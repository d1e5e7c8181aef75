"""WM793b melanoma spheroids: fitted to five of ten measured days, the other five predicted.

Data      docs/data/wm793b-5000-half.csv (Browning et al. 2021): spheroids of 5,000 cells
Model     a variant of wm983b_mechanisms.py in air, cells of three times the diameter
Search    as in wm983b_regimes.py, from the best point of WM983b
Predicted days 5, 10, 14, 18 and 24 (docs/data/wm793b-5000-rest.csv), which the fit did not use
Command   python docs/programs/wm793b.py --fit    fit and predictions, in wm793b-fit.json
          python docs/programs/wm793b.py          tables and the picture
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import greenspan
import numpy as np
import wm983b_mechanisms as mechanisms
import wm983b_nulls as nulls
import wm983b_regimes as regimes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.stats import chi2

import multicell as mc
from multicell.errors import MulticellError
from multicell.report.plots.style import BLUE, INK, QUIET, RED, save_figure, styled

Array = NDArray[np.float64]

DATA = regimes.HERE / "data" / "wm793b-5000-half.csv"
OTHERS = regimes.HERE / "data" / "wm793b-5000-rest.csv"
"""The days that are predicted."""
KEPT = regimes.HERE / "data" / "wm793b-fit.json"
MECHANISM = "relative"
"""Of those of WM983b the one whose oxygen in air is that measured."""
DAYS = np.array([4.0, 5.0, 7.0, 10.0, 12.0, 14.0, 16.0, 18.0, 21.0, 24.0])
SETS, DRAWS, SEEDS = 160, 8, (1, 2, 3)


def main() -> None:
    """Do what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fit", action="store_true")
    if parser.parse_args().fit:
        KEPT.write_text(json.dumps(fit()) + "\n")
    kept = json.loads(KEPT.read_text())
    show(kept)
    save_figure(draw(kept), regimes.HERE / "figures" / "wm793b.png")


def measured(path: Path = DATA) -> tuple[Array, Array, Array]:
    """Return days (k,), and means and deviations of single spheroids of three radii, (k, 3) um.

    A deviation is at least that of a cell.
    """
    lines = path.read_text().splitlines()
    rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    day = np.array([float(row["day"]) for row in rows])
    ratio = np.array([[float(row[name]) for name in ("R_um", "phi", "eta")] for row in rows])
    radii, days = nulls.lengths(ratio), np.unique(day)
    mean = np.array([radii[day == x].mean(axis=0) for x in days])
    sd = np.array([radii[day == x].std(axis=0, ddof=1) for x in days])
    return days, mean, np.maximum(sd, regimes.LEAST)


def scene() -> mc.Scene:
    """Return the scene in air until the last day."""
    length = {"duration": f"{DAYS[-1]:g} d", "output.every": f"{DAYS[-1]:g} d"}
    return mechanisms.variant(MECHANISM).with_changes(length)


def course(settings: dict[str, str], seed: int) -> Array:
    """Return the three radii on all days, (days, 3) um."""
    made = scene().with_changes({**settings, "seed": seed})
    return regimes.radii(made, DAYS)[:, :3]


def fit() -> dict[str, Any]:
    """Fit the variant; return what is kept of it."""
    began = time.monotonic()
    ranges, (days, mean, sd) = regimes.ranges_of(MECHANISM), measured()

    def settings(shares: Sequence[float]) -> dict[str, str]:
        pairs = zip(ranges, shares, strict=True)
        return {f.key: f.setting(f.value(float(share))) for f, share in pairs}

    def misfit(shares: Array) -> float:
        try:
            found = course(settings(shares), 1)[np.searchsorted(DAYS, days)]
        except MulticellError:
            return math.inf
        return float((((found - mean) / sd) ** 2).sum())

    first = regimes.start_of(ranges, regimes.read_kept())
    tried = regimes.search(misfit, first, 0.2, SETS)
    tried.sort(key=lambda pair: pair[0])
    # those that the data do not tell from the best, by the misfit that even the best has
    scale = max(tried[0][0] / max(mean.size - len(ranges), 1), 1.0)
    limit = tried[0][0] + scale * float(chi2.ppf(0.95, len(ranges)))
    region = [pair for pair in tried if pair[0] <= limit]
    draws = [settings(shares) for _, shares in regimes.spread_out(region, DRAWS)]
    best = settings(tried[0][1])
    return {
        "mechanism": MECHANISM,
        "best": best,
        "chi_squared": round(tried[0][0], 1),
        "tried": len(tried),
        "course": np.round(np.mean([course(best, seed) for seed in SEEDS], axis=0), 1).tolist(),
        "bands": [np.round(course(draw, 11 + k), 1).tolist() for k, draw in enumerate(draws)],
        "minutes": round((time.monotonic() - began) / 60, 1),
    }


def null_models(days: Array) -> dict[str, Array]:
    """Return radii on other days without a model of cells, (days, 3) um, by name."""
    known, mean, sd = measured()
    before = np.maximum(np.searchsorted(known, days, side="right") - 1, 0)
    ratio, deviation = mean / mean[:, :1], sd / mean[:, :1]
    ratio[:, 0], deviation[:, 0] = mean[:, 0], sd[:, 0]
    # its course begins with the data
    model = greenspan.fit(known, ratio, deviation, starts=3)
    both = np.unique(np.concatenate([known[:1], days]))
    found = nulls.lengths(model.course(both))[np.searchsorted(both, days)]
    return {
        "as on the day before": mean[before],
        "between measured days": nulls.between(days, known, mean),
        "Greenspan": found,
    }


def show(kept: dict[str, Any]) -> None:
    """Print how far the model and the null models are from data, in deviations."""
    print(f"chi squared {kept['chi_squared']} for {measured()[1].size} data; um")
    for path in (DATA, OTHERS):
        days, mean, _ = measured(path)
        bands, found = predicted(kept, days)
        for k, day in enumerate(days):
            low, high = bands[:, k].min(axis=0), bands[:, k].max(axis=0)
            ends = "  ".join(
                f"{x:5.0f} ({a:.0f} to {b:.0f}) measured {m:.0f}"
                for x, a, b, m in zip(found[k], low, high, mean[k], strict=True)
            )
            print(f"day {day:3g}  {ends}")
    print("rms of (model - mean) / sd     outer  inhibited  necrotic    all")
    days, mean, sd = measured()
    regimes.show("model, fitted days", (predicted(kept, days)[1] - mean) / sd, None)
    days, mean, sd = measured(OTHERS)
    inside = days < measured()[0][-1]
    for name, radii in {"model": predicted(kept, days)[1], **null_models(days)}.items():
        off = (radii - mean) / sd
        regimes.show(name, off, None)
        regimes.show("  between fitted days", off[inside], None)


def predicted(kept: dict[str, Any], days: Array) -> tuple[Array, Array]:
    """Return radii of what fits, (draws, days, 3), and of the best point, (days, 3) um."""
    place = np.searchsorted(DAYS, days)
    return np.array(kept["bands"])[:, place], np.array(kept["course"])[place]


@styled
def draw(kept: dict[str, Any]) -> Figure:
    """Draw three radii over days: means with deviations, model with its range, null models."""
    figure = Figure(figsize=(11.0, 4.0), layout="constrained")
    (bands, course), rivals = predicted(kept, DAYS), null_models(DAYS)
    marks = ((DATA, INK, "fitted"), (OTHERS, RED, "predicted"))
    for k, (ax, name) in enumerate(zip(figure.subplots(1, 3), regimes.COLUMNS, strict=True)):
        low, high = bands[..., k].min(axis=0), bands[..., k].max(axis=0)
        ax.fill_between(DAYS, low, high, color=BLUE, alpha=0.2, lw=0)
        ax.plot(DAYS, course[:, k], color=BLUE, label="model, range of what fits")
        ax.plot(DAYS, rivals["Greenspan"][:, k], "--", color=QUIET, label="Greenspan 1972")
        for path, color, title in marks:
            days, mean, sd = measured(path)
            ax.errorbar(
                days, mean[:, k], sd[:, k], fmt="o", ms=4, color=color, capsize=2, label=title
            )
        ax.set(title=f"{name} radius / µm", xlabel="day")
    figure.axes[0].legend(fontsize=9.5, loc="lower right")
    return figure


if __name__ == "__main__":
    main()
