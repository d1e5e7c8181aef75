"""Orders, stability limits and cost of the methods of Osborne (2024) for Chaste.

Chain     eleven cells in a row at 0.9 of the rest distance, linear springs of stiffness 15 between
          neighbours, drag 1: linear, so that every method's error has a closed form, by its
          stability function R(hλ) for each eigenvalue λ
Growth    four cells that grow to some seventy in 50 h in 2D and 3D, cycles of 7 to 17 h, births at
          multiples of 1/16 h, daughters 0.3 apart, generalised linear springs (stiffness 15,
          decay 5) between all cells; medians of three seeds
Error     largest distance of a cell from the reference at the full hours, in cell diameters
Theirs    forward Euler, midpoint, RK3, RK4, backward Euler, Adams-Moulton 2 with fixed steps, and
          steps that are shortened where a cell moves further than a threshold. The paper's numbers
          are not public: its statements are compared
Cost      eight minutes
Command   python docs/programs/osborne2024.py             (--tables: from what is stored)
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from osborne2024_problems import (
    CHAIN,
    CHAIN_END,
    OURS,
    STABILITY,
    Step,
    chain,
    chain_errors,
    grow,
    packaged,
    threshold,
)
from papers import DOCS, order, pick, reached, solve, table
from picture_origins import record

from multicell.integrators.registry import METHODS
from multicell.report.plots.style import blank, save_figure, styled

DATA = DOCS / "chart-data" / "osborne2024.csv"
STEPS = 2.0 ** -np.arange(4, 12)
FIXED = {"euler": (5, 7, 9, 11, 12, 13), "heun": range(6, 11), "rk4": range(6, 10),
         "backward-euler": (5, 7)}  # fmt: skip
"""Powers of 1/2 that are steps in hours."""
TOLERANT = ("rk4-adaptive", "dopri5", "rkc2", "auto", "cvode", "rosenbrock")
MOVES = {"threshold Euler": (1, (1e-1, 1e-2, 1e-3)), "threshold RK4": (4, (1e-1, 3e-2, 1e-2, 3e-3))}
"""Stages and thresholds in cell diameters of Chaste's adaptive steps, at most 1/16 h long."""
SEEDS, EARLY = 3, 24
FIRST_EULER = 1.0 / 200.0
"""Step in hours of the forward Euler method in Osborne et al. (2017)."""


def measure() -> pd.DataFrame:
    """Solve everything; one row a solution, medians over the seeds."""
    rows: list[dict[str, Any]] = []
    place, values, vectors = chain()
    start = np.zeros((len(place), 3))
    start[:, 0] = place
    for name, method in OURS.items():
        for step in STEPS:
            times = np.arange(0.0, CHAIN_END + 0.5 * step, step)
            found = solve(CHAIN, start, times, method, step)
            decay = np.exp(times[: len(found.path), None] * values)
            right = place / 0.9 + (decay * (vectors.T @ (place - place / 0.9))) @ vectors.T
            away = np.abs(found.path[..., 0] - right).max() if not found.problem else np.inf
            rows.append({"problem": "chain", "method": name, "setting": step, "error": away,
                         "evaluations": found.cost, "seconds": found.cpu})  # fmt: skip
    cases: list[tuple[str, float, Step]] = [
        *((m, 2.0**-k, packaged(m, 2.0**-k)) for m, powers in FIXED.items() for k in powers),
        ("euler", FIRST_EULER, packaged("euler", FIRST_EULER)),
        *((m, t, packaged(m, t)) for m in TOLERANT for t in 10.0 ** -np.arange(2.0, 6.6)),
        *((m, a, threshold(n, 1 / 16, a)) for m, (n, moves) in MOVES.items() for a in moves),
        ("shifted", 1e-8, packaged("dopri5", 1e-12)),
    ]
    for dimensions in (2, 3):
        exact = [grow(seed, dimensions, packaged("dopri5", 1e-12))[0] for seed in range(SEEDS)]
        for method, setting, advance in cases:
            shift = setting if method == "shifted" else 0.0
            runs = [grow(seed, dimensions, advance, shift) for seed in range(SEEDS)]
            far = np.array([
                [np.linalg.norm(a - b, axis=1).max() for a, b in zip(run[0], known, strict=True)]
                for run, known in zip(runs, exact, strict=True)
            ])  # fmt: skip
            rows.append({"problem": f"growth in {dimensions}D", "method": method,
                         "setting": setting, "error": np.median(far.max(axis=1)),
                         "early": np.median(far[:, :EARLY].max(axis=1)),
                         "evaluations": np.median([run[1] for run in runs]),
                         "seconds": np.median([run[2] for run in runs])})  # fmt: skip
            print(dimensions, method, setting, rows[-1]["error"], flush=True)
    return pd.DataFrame(rows)


def tables(data: pd.DataFrame) -> str:
    """Return the tables of orders, limits and costs."""
    values = chain()[1]
    rows, chained = [], data[data["problem"] == "chain"].replace(np.inf, np.nan)
    for name, function in STABILITY.items():
        z = np.linspace(0.0, 10.0, 100001)[1:]
        size = np.abs(function(-z))
        grows = size > 1.0 + 1e-12
        limit = z[grows.argmax()] / -values.min() if grows.any() else np.inf
        own = pick(chained, method=name).dropna(subset=["error"])
        below = own[(own["setting"] < 0.5 * limit) & (own["error"] > 1e-12)]
        exact = chain_errors(name, STEPS)
        fine = (exact > 1e-12) & (0.5 * limit > STEPS)
        # stored steps are rounded
        powers = np.round(-np.log2(own["setting"].to_numpy(float)))
        ratio = own["error"].to_numpy() / chain_errors(name, 2.0**-powers)
        close = ratio[own["setting"].to_numpy() < limit]
        rows.append([name, OURS.get(name, "–"), limit, order(STEPS[fine], exact[fine]),
                     order(below["setting"], below["error"]) if len(below) else np.nan,
                     f"{close.min():.4f} to {close.max():.4f}" if len(close) else "–"])  # fmt: skip
    head = ["theirs", "ours", "limit / h", "order", "order, ours", "ours / closed form"]
    parts = ["Chain of eleven cells", table(head, rows)]
    for problem in ("growth in 2D", "growth in 3D"):
        grown = data[data["problem"] == problem]
        shifted = pick(grown, method="shifted").iloc[0]
        first = pick(grown, method="euler", setting=FIRST_EULER).iloc[0]
        parts.append(
            f"{problem}: a shift of {shifted['setting']:g} becomes {shifted['early']:.1g} by "
            f"{EARLY} h and {shifted['error']:.1g} by 50 h. Forward Euler at 1/200 h: error "
            f"{first['early']:.2g} by {EARLY} h, {first['evaluations']:.0f} evaluations"
        )
        rows = []
        for method in (*FIXED, *TOLERANT, *MOVES):
            own = pick(grown, method=method)
            small = own[own["early"] < 0.1]
            fixed = method in FIXED and len(small) > 2
            rows.append([method, order(small["setting"], small["early"]) if fixed else np.nan, *(
                reached(own["early"], own[what], error)
                for what in ("evaluations", "seconds") for error in (1e-1, 1e-2, 1e-3)
            )])  # fmt: skip
        head = ["method", "order", *(f"{what} at {error:g}" for what in ("evaluations", "CPU s")
                                     for error in (0.1, 0.01, 0.001))]  # fmt: skip
        parts.append(table(head, rows))
    return "\n\n".join(parts)


@styled
def draw(data: pd.DataFrame) -> Figure:
    """Return the figure: closed forms and ours over the step, and error over evaluations."""
    figure = blank("The methods of Osborne 2024: closed forms and multicell",
                   "Largest error of a cell in cell diameters. Left: lines are closed forms, "
                   "circles multicell. Others: by 24 h, medians of three seeds",
                   (14.0, 6.2))  # fmt: skip
    axes = figure.subplots(1, 3)
    figure.subplots_adjust(left=0.06, right=0.985, top=0.8, bottom=0.25, wspace=0.2)
    shades = ("#0072b2", "#e69f00", "#a04000", "#cc79a7", "#0d4a3a", "#6b7a86")
    for (name, _), colour in zip(STABILITY.items(), shades, strict=True):
        axes[0].plot(STEPS, chain_errors(name, STEPS), color=colour, label=f"{name}, closed form")
        own = pick(data, problem="chain", method=name)
        if len(own):
            axes[0].plot(own["setting"], own["error"], "o", mfc="none", color=colour,
                         label=f"{OURS[name]}, ours")  # fmt: skip
    axes[0].set(xscale="log", yscale="log", ylim=(1e-13, 1e2), xlabel="step / h", ylabel="error")
    axes[0].set_title("chain")
    for axis, problem in zip(axes[1:], ("growth in 2D", "growth in 3D"), strict=True):
        for method in (*FIXED, *TOLERANT):
            own = pick(data, problem=problem, method=method)
            own = own.sort_values("setting", ascending=False)
            axis.plot(own["early"], own["evaluations"], "-", lw=1.2, ms=4, label=method,
                      marker=METHODS[method].marker, color=METHODS[method].colour)  # fmt: skip
        for method, marker in zip(MOVES, "os", strict=True):
            own = pick(data, problem=problem, method=method)
            axis.plot(own["early"], own["evaluations"], f"{marker}:", mfc="none", color="black",
                      label=f"{method} (Chaste)")  # fmt: skip
        axis.set(xscale="log", yscale="log", xlabel="error")
        axis.set_title(problem)
    axes[1].set_ylabel("evaluations")
    for axis, spot, columns in ((axes[0], 0.05, 3), (axes[1], 0.45, 4)):
        figure.legend(*axis.get_legend_handles_labels(), ncols=columns, fontsize=9,
                      loc="lower left", bbox_to_anchor=(spot, 0.0))  # fmt: skip
    return figure


def main() -> None:
    """Measure, or read what is stored; print tables and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tables", action="store_true", help="from what is stored")
    if not parser.parse_args().tables:
        measure().to_csv(DATA, index=False, float_format="%.6g", lineterminator="\n")
    data = pd.read_csv(DATA)
    print(tables(data))
    picture = DOCS / "figures" / "osborne2024.png"
    save_figure(draw(data), picture)
    record(picture, "python docs/programs/osborne2024.py", {*OURS.values(), *FIXED, *TOLERANT})


if __name__ == "__main__":
    main()
