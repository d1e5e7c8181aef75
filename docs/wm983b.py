"""WM983b melanoma spheroids: one seeding fitted, two others predicted.

Problem   spheroids of 2,500, 5,000 and 10,000 cells in wells of still medium, from day 3 to day 21:
          radius R, and the inhibited and the necrotic radius over it, phi and eta
Data      docs/data/wm983b-5000.csv (Browning et al., eLife 10, 2021, e73020), one row a spheroid
Model     the scene `wm983b` with cells of twice the diameter (`multicell.coarsen`)
Fitted    eight parameters to the means of 5,000 cells; deviations are those of single spheroids
Beside    Greenspan's model (docs/greenspan.py), five parameters, the same data and likelihood
Command   python docs/wm983b.py --fit                 the fit, kept in docs/data/wm983b-fit.json
          python docs/wm983b.py --predict 2500 10000  from what is kept (--json for programs)
          python docs/wm983b.py                       tables and the picture, from what is kept
"""

from __future__ import annotations

import argparse
import csv
import json
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import greenspan
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

import multicell as mc

Array = NDArray[np.float64]

HERE = Path(__file__).parent
KEPT = HERE / "data" / "wm983b-fit.json"
FITTED = 5000
COARSE = 2
SEEDS = (1, 2)
NAMES = ("radius", "inhibited_ratio", "necrotic_ratio")
LABELS = ("R", "phi", "eta")
FLOOR = 0.03
"""Deviation of a ratio that is 0 in all spheroids of a day: the radius of a cell over R."""
FREE = {
    "initial.count": "log 200:900",
    "growth.phases.G1.duration": "10:50 h",
    "nutrients.oxygen.uptake_per_volume": "log 0.015:0.08 mM/s",
    "nutrients.oxygen.quiescence": "log 0.008:0.06 mM",
    "nutrients.oxygen.necrosis": "log 0.002:0.0079 mM",
    "death.damage_time": "2:8 d",
    "death.lysis_time": "log 2:40 d",
}


def main() -> None:
    """Do what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fit", action="store_true")
    parser.add_argument("--predict", nargs="+", type=int, metavar="CELLS")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    if options.fit:
        fit()
    elif options.predict:
        found = predict(options.predict, json.loads(KEPT.read_text())["best"])
        if options.json:
            print(json.dumps({n: by_day(course) for n, course in found.items()}))
        else:
            for seeding, course in found.items():
                show(f"{seeding} cells", course)
    else:
        pictures()


def measured(seeding: int = FITTED) -> tuple[Array, Array, Array, Array]:
    """Return days (k,), means and deviations (k, 3) of R, phi, eta, and all spheroids (m, 4)."""
    lines = (HERE / "data" / f"wm983b-{seeding}.csv").read_text().splitlines()
    rows = csv.reader(line for line in lines[1:] if not line.startswith("#"))
    single = np.array([[float(v) for v in row] for row in rows if row[0] != "day"])
    days = np.unique(single[:, 0])
    groups = [single[single[:, 0] == day, 1:] for day in days]
    sd = np.array([group.std(axis=0, ddof=1) for group in groups])
    sd[:, 1:] = np.where(sd[:, 1:] > 0, sd[:, 1:], FLOOR)
    return days, np.array([group.mean(axis=0) for group in groups]), sd, single
