"""EMT6/Ro spheroids: the scenes `emt6` and `emt6-rim` against rims, oxygen, consumption, growth.

Problem   balls of 740 um at rest in eight media: how deep cells live, how deep oxygen reaches, how
          much the rim consumes; and a spheroid that grows from 600 cells at 102 h of culture
Data      docs/data/emt6-{rims,po2,consumption}.csv (Mueller-Klieser, Freyer & Sutherland 1986),
          docs/data/emt6-growth.csv (Freyer & Sutherland 1986)
Fitted    emt6_ball.py by emt6_fit.py: five rules of death to all of the first three, and to each
          alone, which predicts the others; growth with the parameters of those fits
Cost      CPU time of one thread: runs 1 minute, rules 3, sets 3, profiles 2, growth some ten and
          0.6 GB of memory
Command   python docs/programs/emt6.py
          (all and the pictures; --only runs rules sets profiles growth)
"""

from __future__ import annotations

import argparse
import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
from emt6_ball import SOLUBILITY, Array, Tissue, ball, course
from emt6_fit import (
    DATA,
    FIELDS,
    GROWTH,
    PASTEUR,
    RULES,
    SETS,
    Measured,
    fit,
    growth_errors,
    measured,
    profile,
    rms,
    verdict,
)
from matplotlib.figure import Figure

import multicell as mc
from multicell.report.plots.style import BLUE, INK, QUIET, RED, save_figure, styled
from multicell.results.frame import Frame

DOCS = Path(__file__).parents[1]
PACKING = 0.76
"""Part of tissue that cells fill: amounts of tissue and of cells differ by this factor."""
FACTORS = np.array([0.25, 0.5, 0.7, 0.85, 1.18, 1.4, 2.0, 4.0])
SEEDS = 4


def main() -> None:
    """Compute what is asked for, and draw what there is."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parts = ["runs", "rules", "sets", "profiles", "growth"]
    parser.add_argument("--only", nargs="+", choices=[*parts, "pictures"], default=parts)
    only, data = parser.parse_args().only, measured()
    known = Tissue.of(mc.load_scene("emt6"), PACKING)
    tell("scenes, along the radius", known, data)
    if "rules" in only:
        rules(data, known)
    if "sets" in only:
        sets(data, known)
    if "profiles" in only:
        profiles(data, known)
    if "growth" in only:
        growth(data, known)
    if {"runs", "pictures"} & set(only):
        save_figure(draw_rest(data, known, runs(data)), DOCS / "figures" / "emt6-rims.png")
    save_figure(draw_growth(data, known), DOCS / "figures" / "emt6.png")
    save_figure(draw_profiles(), DOCS / "figures" / "emt6-profiles.png")


def tell(name: str, tissue: Tissue, data: Measured, squares: float | None = None) -> None:
    """Print the errors of a tissue in one row."""
    rims, each, used = verdict(tissue, data)
    chi = "" if squares is None else f"chi2 {squares:.1f}, "
    pressure = ", ".join(f"{off:.1f}" for off in each)
    print(f"{name}: {chi}rims {rims:.2f} sd, pO2 {pressure} mmHg, consumption {100 * used:.0f} %",
          flush=True)  # fmt: skip


def shown(tissue: Tissue, free: list[str]) -> str:
    """Return parameters in words."""
    return "  " + ", ".join(f"{name} {getattr(tissue, name):.3g}" for name in free)


def rules(data: Measured, near: Tissue) -> None:
    """Fit each rule of death, with and without the Pasteur effect, to all that was measured."""
    best: dict[str, Tissue] = {}
    for rule in ("either", "ATP", "lactate", "time", "damage"):
        delayed = rule in ("time", "damage")
        for effect in (PASTEUR,) if delayed else ((), PASTEUR):
            free = [*FIELDS, *effect, *RULES[rule]]
            start = replace(best["ATP"], harm=1.0) if delayed else near
            start = replace(start, rule=rule, pasteur=start.pasteur if effect else 0.0)
            best[rule], squares = fit(data, start, free)
            name = f"{rule}{' + Pasteur' if effect else ''}, {len(free)} free"
            tell(name, best[rule], data, squares)
            print(shown(best[rule], free), flush=True)
    for rule in ("time", "damage"):  # how long cells may be short of ATP before they die
        late = best[rule]
        for hours in (3.0, 6.0, 12.0, 24.0):
            free = [*FIELDS, *PASTEUR, "least"]
            late, squares = fit(data, replace(late, harm=hours), free, starts=2, tries=200)
            tell(f"{rule}, {hours:g} h", late, data, squares)


def sets(data: Measured, near: Tissue) -> None:
    """Fit each set of data alone, and two of them; judge by all."""
    for rule in ("ATP", "damage", "lactate"):
        free = [*FIELDS, *PASTEUR, *RULES[rule]]
        for used in (*((one,) for one in SETS), SETS[:2], SETS[::2], SETS[1:], SETS):
            best, squares = fit(data, replace(near, rule=rule), free, used, starts=3, tries=300)
            tell(f"{rule}, fitted to {' and '.join(used)}", best, data, squares)


def profiles(data: Measured, near: Tissue) -> None:
    """Write the least sum of squares over each parameter to a table."""
    free = [*FIELDS, *PASTEUR, *RULES["lactate"]]
    best, squares = fit(data, near, free, starts=0, tries=0)
    lines = ["parameter, value, squares above the least"]
    for name in free:
        found = profile(data, best, free, name, FACTORS)
        lines.append(f"{name}, {getattr(best, name):.5g}, 0")
        lines += [f"{name}, {value:.5g}, {there - squares:.3f}" for value, there in found]
        print(f"profile of {name}: {len(found)} fits", flush=True)
    (DATA / "emt6-profiles.csv").write_text("\n".join(lines) + "\n")


def runs(data: Measured) -> dict[str, Array]:
    """Return results of real runs of emt6-rim, and print how far they are off.

    Rims and consumption over media and seeds (from the second on with cells shifted at random), and
    the oxygen over depth in the media of the profiles, (um, mmHg).
    """
    scene, rims, used = mc.load_scene("emt6-rim"), [], []
    for seed in range(SEEDS):
        for oxygen, glucose in data.media:
            result = mc.run(_at(scene, oxygen, glucose, seed))
            cells, outer = result.frames[-1].cells, 0.5 * result.summary()["diameter"]
            rims.append(result.summary()["viable_rim"])
            rim_volume = 4.0 / 3.0 * np.pi * (outer**3 - (outer - rims[-1]) ** 3)
            taken = _uptake(scene, result.frames[-1])[~cells.dead].sum()
            used.append(taken / rim_volume)
    found = {"rims": np.reshape(rims, (SEEDS, -1)), "used": np.reshape(used, (SEEDS, -1))}
    off = (found["rims"][0] - data.rims) / data.deviations
    print(f"runs: rims {np.round(found['rims'][0], 1).tolist()} um, sd over seeds "
          f"{np.round(found['rims'][1:].std(axis=0, ddof=1), 1).tolist()}, off by "
          f"{np.round(off, 1).tolist()} sd, rms {rms(off):.2f}")  # fmt: skip
    ratio = found["used"][0] / data.consumption
    print(f"runs: consumption over measured {np.round(ratio, 2).tolist()}")
    for (oxygen, glucose, radius), (depth, pressure) in data.pressures.items():
        scene_there = _at(scene, oxygen, glucose, 0)
        count = round(scene.initial.count * (radius / 370.0) ** 3)
        frame = mc.run(scene_there.with_changes({"initial.count": count})).frames[-1]
        found[f"{oxygen:g}"] = _over_depth(scene_there, frame, radius)
        there = np.interp(depth, *found[f"{oxygen:g}"])
        print(f"runs: pO2 at {oxygen:g} mM off by {rms(there - pressure):.1f} mmHg rms, "
              f"{np.round(there, 1).tolist()}", flush=True)  # fmt: skip
    return found


def _at(scene: mc.Scene, oxygen: float, glucose: float, seed: int) -> mc.Scene:
    return scene.with_changes({
        "nutrients.oxygen.boundary": oxygen, "nutrients.glucose.boundary": glucose,
        "seed": scene.seed + seed, "initial.jitter": 0.2 if seed else 0.0,
    })  # fmt: skip


def _uptake(scene: mc.Scene, frame: Frame) -> Array:
    """Return the oxygen that each living cell takes up, amol/s."""
    o, found = scene.nutrients["oxygen"], frame.concentrations
    most = o.uptake_per_volume * o.uptake_on["glucose"].factor(found["glucose"])
    share = found["oxygen"] / (o.half_saturation + found["oxygen"])
    return np.asarray(frame.cells.volume * most * share)


def _over_depth(scene: mc.Scene, frame: Frame, radius: float) -> Array:
    """Return depths (um) and oxygen (mmHg) of a frame's field on shells and the medium, (2, n)."""
    field, o = frame.fields["oxygen"], scene.nutrients["oxygen"]
    r = np.append((np.arange(field.values.size) + 0.5) * field.spacing, radius + o.layer)
    return np.stack([radius - r, np.append(field.values, o.boundary) / SOLUBILITY])[:, ::-1]


def growth(data: Measured, near: Tissue) -> None:
    """Fit growth along the radius, grow one spheroid to 480 h, and write its course to a table."""
    best, squares = fit(data, near, list(GROWTH), ("growth",), starts=3, tries=20)
    print(f"growth along the radius: chi2 {squares:.1f}\n{shown(best, list(GROWTH))}")
    changes = {
        "duration": "378 h", "coupling_step": "30 min", "stop_cells": None, "output.every": "24 h"
    }  # fmt: skip
    history = mc.run(mc.load_scene("emt6").with_changes(changes)).history
    rows = ["time / h, cells, proliferating, diameter / um, viable_rim / um, packing_ratio"]
    hours = history["time"] / 3600.0
    for k in np.flatnonzero(np.isclose(hours % 6.0, 0.0)):
        names = ("cells", "proliferating", "diameter", "viable_rim", "packing_ratio")
        row = (f"{history[name][k]:.5g}" for name in names)
        rows.append(f"{data.start + hours[k]:g}, {', '.join(row)}")
    (DATA / "emt6-run.csv").write_text("\n".join(rows) + "\n")


def table(name: str) -> dict[str, list[str]]:
    """Return the columns of a table of docs/data as text."""
    rows = list(csv.DictReader((DATA / name).read_text().splitlines(), skipinitialspace=True))
    return {key: [row[key] for row in rows] for key in rows[0]}


@styled
def draw_rest(data: Measured, known: Tissue, found: dict[str, Array]) -> Figure:
    """Draw rims and consumption over glucose, and oxygen over depth: measured and computed."""
    figure = Figure(figsize=(13, 4.8), layout="constrained")
    glucose, several = np.array([g for _, g in data.media[:4]]), np.geomspace(0.6, 20.0, 40)
    first, second, third = figure.subplots(1, 3)
    for k, colour in enumerate((RED, BLUE)):
        rows, oxygen = slice(4 * k, 4 * k + 4), data.media[4 * k][0]
        label = f"{'5' if k == 0 else '20'} % O₂"
        fine = [ball(known, oxygen, float(g)) for g in several]
        first.errorbar(
            glucose, data.rims[rows], data.deviations[rows], fmt="o", color=colour, ms=7,
            capsize=4, label=f"{label}, measured",
        )  # fmt: skip
        first.plot(several, [one.rim for one in fine], color=colour, lw=1)
        first.plot(glucose, found["rims"][0][rows], "s", color=colour, ms=6, mfc="white",
                   label=f"{label}, runs")  # fmt: skip
        second.plot(glucose, 1e3 * data.consumption[rows], "o", color=colour, ms=7)
        second.plot(several, [1e3 * one.consumption for one in fine], color=colour, lw=1)
        second.plot(glucose, 1e3 * found["used"][0][rows], "s", color=colour, ms=6,
                    mfc="white")  # fmt: skip
    for (oxygen, g, radius), (depth, pressure) in data.pressures.items():
        colour = RED if oxygen < 0.1 else BLUE
        fine = np.linspace(-110.0, 300.0 if oxygen > 0.1 else 120.0, 200)
        third.plot(depth, pressure, "o", color=colour, ms=7, label=f"{g:g} mM glucose")
        third.plot(fine, ball(known, oxygen, g, radius).pressure(fine), color=colour, lw=1)
        shells = found[f"{oxygen:g}"]
        there = (shells[0] > fine[0]) & (shells[0] < fine[-1])
        third.plot(*shells[:, there], "s", color=colour, ms=3, mfc="white")
    for axes, label, top in ((first, "viable rim (µm)", 390.0),
                             (second, "O₂ consumption of the rim (µM/s)", 32.0)):  # fmt: skip
        axes.set(xscale="log", xlabel="glucose in the medium (mM)", ylabel=label, ylim=(0, top))
        axes.set_xticks(glucose, [f"{g:g}" for g in glucose])
        axes.minorticks_off()
    third.set(xlabel="depth below the surface (µm)", ylabel="oxygen (mmHg)", ylim=(0, 155))
    first.legend(loc="upper left", fontsize=10)
    third.legend(fontsize=10)
    return figure


@styled
def draw_growth(data: Measured, known: Tissue) -> Figure:
    """Draw cells and diameter over time, measured and computed."""
    grown = {key: np.array(x, dtype=float) for key, x in table("emt6-run.csv").items()}
    times, living, diameters, _ = course(known, float(data.hours[-1]) - data.start)
    cells, sizes = growth_errors(known, data)
    print(f"growth along the radius: cells {np.round(cells, 2).tolist()}, diameter "
          f"{np.round(sizes, 2).tolist()} (logarithms)")  # fmt: skip
    used = data.hours <= grown["time / h"][-1]
    for name, there in (("proliferating", data.cells), ("diameter / um", data.diameters)):
        off = np.log(np.interp(data.hours, grown["time / h"], grown[name]) / there)[used]
        print(f"growth in the run: {name} off by {np.round(off, 2).tolist()}, rms {rms(off):.2f}")
    figure = Figure(figsize=(10, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    start = np.array([data.start])
    left.plot(np.append(start, data.hours), np.append(600.0, data.cells), "o", color=RED, ms=7,
              label="measured, EMT6/Ro")  # fmt: skip
    left.plot(grown["time / h"], grown["proliferating"], color=BLUE, lw=2, label="living, run")
    left.plot(grown["time / h"], grown["cells"], "--", color=BLUE, lw=1, label="with the dead, run")
    left.plot(data.start + times, living, ":", color=INK, lw=1.6, label="along the radius")
    right.plot(np.append(start, data.hours), np.append(154.0, data.diameters), "o", color=RED, ms=7)
    right.plot(grown["time / h"], grown["diameter / um"], color=BLUE, lw=2)
    right.plot(data.start + times, diameters, ":", color=INK, lw=1.6)
    for axes in (left, right):
        axes.set(xlabel="age of the culture (h)", xlim=(90, 575))
    left.set(ylabel="cells", yscale="log", title="Cells")
    right.set(ylabel="diameter (µm)", ylim=(0, 1400), title="Diameter")
    left.legend(loc="lower right")
    return figure


@styled
def draw_profiles() -> Figure:
    """Draw the least sum of squares over each parameter."""
    found = table("emt6-profiles.csv")
    names, values = np.array(found["parameter"]), np.array(found["value"], dtype=float)
    above = np.array(found["squares above the least"], dtype=float)
    figure = Figure(figsize=(12, 5.2), layout="constrained")
    for axes, name in zip(figure.subplots(2, 5, sharey=True).flat, LABELS, strict=True):
        rows = np.flatnonzero(names == name)
        rows = rows[np.argsort(values[rows])]
        axes.plot(values[rows], above[rows], "o-", color=BLUE, ms=4)
        for level in (1.0, 3.84):
            axes.axhline(level, color=QUIET, lw=0.8, ls="--")
        axes.set(xscale="log", ylim=(-0.3, 12))
        axes.set_title(LABELS[name], fontsize=11)
        ticks = np.geomspace(values[rows].min(), values[rows].max(), 3)
        axes.set_xticks(ticks, [f"{tick:.2g}" if tick < 100.0 else f"{tick:.0f}" for tick in ticks])
        axes.minorticks_off()
        for label, side in zip(axes.get_xticklabels(), ("left", "center", "right"), strict=True):
            label.set(ha=side, fontsize=10)
    figure.supylabel("χ² above the least")
    return figure


LABELS = {
    "oxygen": "uptake of O₂ (mM/s)", "glucose": "uptake of glucose (mM/s)",
    "crabtree": "Crabtree: effect", "half": "Crabtree: half (mM)", "layer": "layer (µm)",
    "diffusion": "diffusion of O₂ (µm²/s)", "pasteur": "Pasteur: effect",
    "pasteur_half": "Pasteur: half (mM)", "least": "ATP to live (mM/s)",
    "lactate": "lactate that kills × D",
}  # fmt: skip


if __name__ == "__main__":
    main()
