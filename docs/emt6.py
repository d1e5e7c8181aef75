"""EMT6/Ro spheroids: the scenes `emt6` and `emt6-rim` against measured growth and viable rims.

Problem   a spheroid grows from 600 cells at 102 h of culture to 561 h; balls of 740 um at rest in
          eight media, and how deep cells live in them
Data      docs/data/emt6-growth.csv (Freyer & Sutherland 1986), docs/data/emt6-rims.csv
          (Mueller-Klieser, Freyer & Sutherland 1986), with their standard deviations
Fitted    ten parameters of docs/emt6_ball.py, by docs/emt6_fit.py: to all data (the scenes), and
          to every second rim with the growth of the first week, which predicts the rest
Cost      CPU time of one thread: rims 7 s, fit 1.5 minutes, profiles 4 minutes, growth some ten
          minutes and 0.6 GB of memory
Command   python docs/emt6.py            (all and the pictures; --only rims fit profiles growth)
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import numpy as np
from emt6_ball import Array, Tissue, course, rim
from emt6_fit import (
    DATA,
    EARLY,
    HALVES,
    RANGES,
    RULES,
    Measured,
    deviations,
    fit,
    fit_rule,
    growth_errors,
    measured,
    profile,
)
from matplotlib.figure import Figure

import multicell as mc

HERE = Path(__file__).parent
PACKING = 0.76
"""Part of tissue that cells fill in the run of growth: tissue and cells differ by this factor."""
BEFORE = np.array([63.0, 63.0, 63.0, 63.0, 82.0, 135.0, 313.0, 370.0])
"""Rims of the scene emt6 before it was fitted to them; the last one starved nowhere in 370 um."""
FACTORS = np.array([0.25, 0.5, 0.7, 0.85, 1.18, 1.4, 2.0, 4.0, 8.0, 16.0, 32.0])
RED, BLUE, GREY = "#b5432f", "#2f6fb0", "#888888"


def main() -> None:
    """Compute what is asked for, and draw what there is."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parts = ["rims", "fit", "profiles", "growth"]
    parser.add_argument("--only", nargs="+", choices=[*parts, "pictures"], default=parts)
    only, data = parser.parse_args().only, measured()
    known = Tissue.of(mc.load_scene("emt6"), PACKING)
    tell("scene emt6 as a ball along its radius", known, data)
    if "fit" in only:
        rules(data)
        fits(data)
    if "profiles" in only:
        profiles(data, known)
    if "growth" in only:
        growth()
    rims = run_rims(data)
    draw_rims(data, rims, HERE / "figures" / "emt6-rims.png")
    draw_growth(data, known, HERE / "figures" / "emt6.png")
    draw_profiles(HERE / "figures" / "emt6-profiles.png")


def run_rims(data: Measured) -> Array:
    """Return the rims of the scene emt6-rim in all conditions, from real runs, and tell of them."""
    scene, found = mc.load_scene("emt6-rim"), []
    for oxygen, glucose in data.conditions:
        changes = {"nutrients.oxygen.boundary": oxygen, "nutrients.glucose.boundary": glucose}
        found.append(mc.run(scene.with_changes(changes)).summary()["viable_rim"])
    rims = np.array(found)
    for name, values in (("before", BEFORE), ("scene emt6-rim", rims)):
        off = (values - data.rims) / data.deviations
        told = f"{name}: rims {np.round(values, 1).tolist()} um"
        print(told, f"off by {np.round(off, 1).tolist()} sd, rms {rms(off):.2f}", flush=True)
    return rims


def rms(values: Array) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def tell(name: str, tissue: Tissue, data: Measured) -> None:
    """Print parameters and errors of a tissue."""
    off = deviations(tissue, data)
    cells, diameters = growth_errors(tissue, data, np.inf)
    early = data.hours <= EARLY
    print(name, {key: float(f"{getattr(tissue, key):.3g}") for key in RANGES})
    halves = ", ".join(f"half '{half}' {rms(off[rows]):.2f}" for half, rows in HALVES.items())
    print(f"  rims off by {np.round(off, 1).tolist()} sd: rms {rms(off):.2f}; {halves}")
    print(
        f"  logarithmic error, early and late: cells {rms(cells[early]):.2f}, "
        f"{rms(cells[~early]):.2f}; diameter {rms(diameters[early]):.2f}, "
        f"{rms(diameters[~early]):.2f}; at {data.hours[-1]:g} h {cells[-1]:+.2f} and "
        f"{diameters[-1]:+.2f}",
        flush=True,
    )


def rules(data: Measured) -> None:
    """Fit each rule of death to all rims."""
    for name, free in RULES.items():
        best, off = fit_rule(data, free)
        told = {key: float(f"{getattr(best, key):.3g}") for key in free if hasattr(best, key)}
        print(f"{name}: {len(free)} parameters {told}, thresholds {best.thresholds}")
        print(f"  off by {np.round(off, 1).tolist()} sd: rms {rms(off):.2f}", flush=True)


def fits(data: Measured) -> None:
    """Fit to all data, and to each half of the rims with early growth to predict the rest."""
    best, squares = fit(data, list(range(len(data.rims))), np.inf)
    tell(f"fitted to all data, squares {squares:.1f}", best, data)
    for half, rows in HALVES.items():
        best, squares = fit(data, rows, EARLY, starts=12)
        tell(f"fitted to half '{half}' and growth to {EARLY:g} h, {squares:.1f}", best, data)


def profiles(data: Measured, near: Tissue) -> None:
    """Write the least sum of squares over each parameter to a table."""
    everything = list(range(len(data.rims)))
    best, squares = fit(data, everything, np.inf, near=near)
    lines = ["parameter, value, squares above the least"]
    for name in RANGES:
        found = profile(data, best, name, FACTORS)
        lines.append(f"{name}, {getattr(best, name):.5g}, 0")
        lines += [f"{name}, {value:.5g}, {there - squares:.3f}" for value, there in found]
        print(f"profile of {name}: {len(found)} fits", flush=True)
    (DATA / "emt6-profiles.csv").write_text("\n".join(lines) + "\n")


def growth() -> None:
    """Grow one spheroid to the last measurement, and write its course to a table."""
    changes = {
        "duration": "460 h", "coupling_step": "30 min", "stop_cells": None, "output.every": "24 h"
    }  # fmt: skip
    result = mc.run(mc.load_scene("emt6").with_changes(changes))
    write_course(result.history)


def write_course(history: dict[str, Array]) -> None:
    """Write every sixth hour of a history to a table."""
    rows = ["time / h, cells, proliferating, diameter / um, viable_rim / um, packing_ratio"]
    hours = history["time"] / 3600.0
    for k in np.flatnonzero(np.isclose(hours % 6.0, 0.0)):
        names = ("cells", "proliferating", "diameter", "viable_rim", "packing_ratio")
        row = (f"{history[name][k]:.5g}" for name in names)
        rows.append(f"{102.0 + hours[k]:g}, {', '.join(row)}")
    (DATA / "emt6-run.csv").write_text("\n".join(rows) + "\n")


def table(name: str) -> dict[str, list[str]]:
    """Return the columns of a table of docs/data as text."""
    rows = list(csv.DictReader((DATA / name).read_text().splitlines(), skipinitialspace=True))
    return {key: [row[key] for row in rows] for key in rows[0]}


def draw_rims(data: Measured, rims: Array, path: Path) -> None:
    """Draw rims over glucose, measured and computed."""
    figure = Figure(figsize=(10, 4.2), layout="constrained")
    glucose, several = np.array([g for _, g in data.conditions[:4]]), np.geomspace(0.6, 20.0, 60)
    tissue = Tissue.of(mc.load_scene("emt6-rim"), PACKING)
    for number, axes in enumerate(figure.subplots(1, 2, sharey=True)):
        rows = slice(4 * number, 4 * number + 4)
        oxygen = data.conditions[rows][0][0]
        axes.errorbar(
            glucose, data.rims[rows], data.deviations[rows], fmt="o", color=RED, ms=7, capsize=4,
            label="measured",
        )  # fmt: skip
        fine = [rim(tissue, oxygen, float(g)) for g in several]
        axes.plot(several, fine, color=BLUE, lw=1, label="along the radius")
        axes.plot(glucose, rims[rows], "s", color=BLUE, ms=6, label="runs of emt6-rim")
        axes.plot(glucose, BEFORE[rows], "x", color=GREY, ms=8, label="before: thresholds of each")
        axes.set(xscale="log", xlabel="glucose in the medium (mM)", ylim=(0, 390))
        axes.set_title(f"{'5' if number == 0 else '20'} % O₂ ({oxygen:g} mM)")
        axes.set_xticks(glucose, [f"{g:g}" for g in glucose])
        axes.minorticks_off()
        axes.grid(alpha=0.3)
        if number == 0:
            axes.set_ylabel("viable rim (µm)")
            axes.legend(loc="upper left")
    figure.savefig(path, dpi=110)


def draw_growth(data: Measured, known: Tissue, path: Path) -> None:
    """Draw cells and diameter over time, measured and computed."""
    grown = {key: np.array(x, dtype=float) for key, x in table("emt6-run.csv").items()}
    times, living, diameters, _ = course(known, float(data.hours[-1]) - data.start)
    figure = Figure(figsize=(10, 4.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    start = np.array([data.start])
    left.plot(np.append(start, data.hours), np.append(600.0, data.cells), "o", color=RED, ms=7,
              label="measured, EMT6/Ro")  # fmt: skip
    left.plot(grown["time / h"], grown["proliferating"], color=BLUE, lw=2, label="living, run")
    left.plot(grown["time / h"], grown["cells"], "--", color=BLUE, lw=1, label="with the dead, run")
    left.plot(data.start + times, living, ":", color="black", lw=1.2, label="along the radius")
    right.plot(np.append(start, data.hours), np.append(154.0, data.diameters), "o", color=RED, ms=7)
    right.plot(grown["time / h"], grown["diameter / um"], color=BLUE, lw=2)
    right.plot(data.start + times, diameters, ":", color="black", lw=1.2)
    for axes in (left, right):
        axes.set(xlabel="age of the culture (h)", xlim=(90, 575))
        axes.grid(alpha=0.3)
    left.set(ylabel="cells", yscale="log", title="Cells")
    right.set(ylabel="diameter (µm)", ylim=(0, 1400), title="Diameter")
    left.legend(loc="lower right")
    figure.savefig(path, dpi=110)


def draw_profiles(path: Path) -> None:
    """Draw the least sum of squares over each parameter."""
    found = table("emt6-profiles.csv")
    names, values = np.array(found["parameter"]), np.array(found["value"], dtype=float)
    above = np.array(found["squares above the least"], dtype=float)
    figure = Figure(figsize=(11, 4.6), layout="constrained")
    for axes, name in zip(figure.subplots(2, 5, sharey=True).flat, RANGES, strict=True):
        rows = np.flatnonzero(names == name)
        rows = rows[np.argsort(values[rows])]
        axes.plot(values[rows], above[rows], "o-", color=BLUE, ms=4)
        for level in (1.0, 3.84):
            axes.axhline(level, color=GREY, lw=0.8, ls="--")
        axes.set(xscale="log", ylim=(-0.3, 12))
        axes.set_title(LABELS[name], fontsize=10)
        ticks = np.geomspace(values[rows].min(), values[rows].max(), 3)
        axes.set_xticks(ticks, [f"{tick:.2g}" if tick < 100.0 else f"{tick:.0f}" for tick in ticks])
        axes.minorticks_off()
        axes.grid(alpha=0.3)
    figure.supylabel("χ² above the least")
    figure.savefig(path, dpi=110)


LABELS = {
    "oxygen": "uptake of O₂ (mM/s)", "glucose": "uptake of glucose (mM/s)",
    "crabtree": "Crabtree: effect", "half": "Crabtree: half (mM)", "layer": "layer (µm)",
    "least": "ATP to live (mM/s)", "growth_half": "ATP, half growth (mM/s)",
    "cycle": "cycle (h)", "lysis": "lysis of core (h)", "cell": "tissue/cell (µm³)",
}  # fmt: skip


if __name__ == "__main__":
    main()
