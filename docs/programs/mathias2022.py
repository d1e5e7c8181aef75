"""Figures 3 to 5 of Mathias, Coulier and Hellander (2022): forward and backward Euler of CBMOS.

Problems  two daughters at 0.3 cell diameters; two adhering cells at 1.15; 19 cells that all divide
          at once; 400 cells of a hexagonal sheet at 0.8 of the rest distance
Laws      cubic, piecewise quadratic and generalised linear spring (GLS), drag coefficient 1
Error     of each coordinate: norm of its error over the trajectory / norm of the trajectory,
          trajectories interpolated linearly between steps; mean over the cells, sum over x and y
Points    chart-data/mathias2022-published.csv: every third step, means of the ten repetitions that
          lie behind the paper's figures in github.com/somathias/cbmos, tag exp-Mathias2022;
          chart-data/mathias2022-daughters.csv: figure 3, as that repository computes it
Cost      three minutes
Command   python docs/programs/mathias2022.py             (--tables: from what is stored)
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np
import pandas as pd
from mathias2022_problems import LAWS, inexact_euler, problems, trajectory_error
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from papers import DOCS, Array, mechanics, motion, order, pick, reached, solve, table
from picture_origins import record

from multicell.integrators.registry import METHODS
from multicell.report.plots.style import blank, save_figure, styled

DATA, PUBLISHED, DAUGHTERS = (
    DOCS / "chart-data" / f"mathias2022{part}.csv" for part in ("", "-published", "-daughters")
)
STEPS = 0.001 * 1.25 ** np.arange(0, 31, 3)
OVER_STEP = ("euler", "heun", "rk4", "backward-euler", "theirs")
"""Methods with fixed steps; "theirs" is the backward Euler of the paper, written anew."""
OVER_COST = ("euler", "backward-euler", "heun", "rk4", "rk4-adaptive", "dopri5", "rkc2", "auto",
             "cvode", "rosenbrock")  # fmt: skip
OUTPUTS = np.linspace(0.0, 1.0, 13) ** 2
"""Times / end at which trajectories are compared where the cost is measured."""
COLOURS = {"cubic": "#0072b2", "quadratic": "#e69f00", "GLS": "#6b7a86"}


def measure() -> pd.DataFrame:
    """Solve everything; one row a solution."""
    rows: list[dict[str, Any]] = []
    for problem, (start, end, dim) in problems().items():
        for law, contact in LAWS.items():
            at = np.linspace(0.0, end, 1001)[:-1]
            exact = solve(contact, start, at, "dopri5", 1e-10).path
            for method in OVER_STEP if law == "cubic" else ("euler", "backward-euler", "theirs"):
                for step in STEPS:
                    times, begun = np.arange(0.0, end, step), time.process_time()
                    if method == "theirs":
                        path, cost = inexact_euler(contact, start, times, dim)
                    else:
                        found = solve(contact, start, times, method, step)
                        path, cost = found.path, found.cost
                    whole = len(path) == len(times)
                    error = trajectory_error(times, path, at, exact, dim) if whole else np.nan
                    rows.append({"chart": "step", "problem": problem, "law": law, "method": method,
                                 "setting": step, "error": error, "evaluations": cost,
                                 "seconds": time.process_time() - begun})  # fmt: skip
        at = OUTPUTS * end
        exact = solve(LAWS["cubic"], start, at, "dopri5", 1e-12).path
        for method in OVER_COST:
            fixed = METHODS[method].control == "step"
            for setting in STEPS if fixed else 10.0 ** -np.arange(1.0, 7.1, 0.5):
                runs = [solve(LAWS["cubic"], start, at, method, setting) for _ in range(3)]
                whole = not runs[0].problem
                error = trajectory_error(at, runs[0].path, at, exact, dim) if whole else np.nan
                rows.append({"chart": "cost", "problem": problem, "law": "cubic", "method": method,
                             "setting": setting, "error": error, "evaluations": runs[0].cost,
                             "seconds": min(run.cpu for run in runs)})  # fmt: skip
        print(problem, "done", flush=True)
    return pd.DataFrame(rows)


def limit(start: Array, dim: int) -> float:
    """Return 2 / λ of a state under the cubic law: Euler's largest stable step, h."""
    system, size = mechanics(LAWS["cubic"]), len(start) * dim
    system.begin(motion(len(start), 0.0, 1.0))
    jacobian, ends = np.empty((size, size)), [np.empty_like(start), np.empty_like(start)]
    for k in range(size):
        for sign, out in zip((1.0, -1.0), ends, strict=True):
            moved = start.copy()
            moved[k // dim, k % dim] += sign * 1e-6
            system.velocity(0.0, moved, out)
        jacobian[k] = ((ends[0] - ends[1])[:, :dim] / 2e-6).ravel()
    return 2.0 / -float(np.linalg.eigvalsh(jacobian).min())


def limits(published: pd.DataFrame) -> str:
    """Return the table of stable steps, and of the steps where published errors leave order 1."""
    rows = []
    for problem, (start, end, dim) in problems().items():
        last = solve(LAWS["cubic"], start, [0.0, end], "dopri5", 1e-10).path[-1]
        given = pick(published, problem=problem, law="cubic")
        left = []
        for name in ("euler", "backward"):
            ratio = given[f"{name}_error"] / given["step"]
            off = given["step"][ratio > 2.0 * ratio.iloc[0]]
            left.append(float(off.iloc[0]) if len(off) else np.nan)
        rows.append([problem, limit(start, dim), limit(last, dim), *left])
    head = ["problem", "2/λ at the start", "2/λ at the end", "forward Euler", "backward Euler"]
    return table(head, rows)


def daughters(published: pd.DataFrame) -> str:
    """Return the table of figure 3: separations of two daughters, and how far ours are off."""
    start = problems()["daughters"][0]
    rows: list[list[Any]] = []
    for (law, method, step), given in published.groupby(["law", "method", "step"], sort=False):
        name = "euler" if method == "euler" else "backward-euler"
        times = np.arange(0.0, 1.0, step)
        path = solve(LAWS[law], start, times, name, step).path
        ours = np.linalg.norm(path[:, 1] - path[:, 0], axis=1)
        theirs = given["separation"].to_numpy()[: len(ours)]
        rows.append([law, name, step, ours[1], ours[-1], np.abs(ours - theirs).max()])
    head = ["law", "method", "step / h", "after a step", "at the end", "largest difference"]
    return table(head, rows)


def tables(data: pd.DataFrame, published: pd.DataFrame) -> str:
    """Return the tables of orders, of agreement with the paper and of costs."""
    title = "Stable steps in h, and the first published step of twice the error of order 1"
    parts = [title, limits(published)]
    names = list(dict.fromkeys(data["problem"]))
    rows = []
    for method in OVER_STEP:
        cells = []
        for problem in names:
            chosen = pick(data, chart="step", law="cubic", method=method, problem=problem)
            chosen = chosen[(chosen["setting"] < 0.02) & (chosen["error"] > 1e-9)]
            cells.append(order(chosen["setting"], chosen["error"]))
        rows.append([method, *cells])
    parts += ["Order, by regression over steps below 0.02 h", table(["method", *names], rows)]
    rows = []
    both = data[data["chart"] == "step"].merge(published, how="inner",
                                               on=["problem", "law", "row"])  # fmt: skip
    for method, column in (("euler", "euler_error"), ("theirs", "backward_error"),
                           ("backward-euler", "backward_error")):  # fmt: skip
        cells = []
        for problem in names:
            kept = pick(both, method=method, problem=problem)
            kept = kept[kept["error"] < 1.0]
            # theirs is taken against the same method at a step of 1e-4 h
            ratio = kept[column] / (1.0 - 1e-4 / kept["step"]) / kept["error"]
            cells.append(f"{ratio.min():.2f} to {ratio.max():.2f}")
        rows.append([method, *cells])
    parts += ["Published error / ours", table(["method", *names], rows)]
    for error in (1e-2, 1e-3):
        for what in ("evaluations", "seconds"):
            rows = []
            for method in (*OVER_COST, "theirs"):
                cells = []
                for problem in names:
                    chart = "step" if method == "theirs" else "cost"
                    own = pick(data, chart=chart, law="cubic", method=method, problem=problem)
                    own = own.dropna()
                    cells.append(reached(own["error"], own[what], error))
                rows.append([method, *(c * (1e3 if what == "seconds" else 1) for c in cells)])
            if what == "seconds":
                for name in ("euler", "backward"):
                    given = [pick(published, law="cubic", problem=problem) for problem in names]
                    cells = [reached(g[f"{name}_error"], g[f"{name}_seconds"], error) * 1e3
                             for g in given]  # fmt: skip
                    rows.append([f"{name}, published", *cells])
            unit = "CPU time in ms (published: wall)" if what == "seconds" else "Evaluations"
            title = f"{unit} for an error of {error:g}, cubic law"
            parts += [title, table(["method", *names], rows)]
    return "\n\n".join(parts)


@styled
def draw(data: pd.DataFrame, published: pd.DataFrame) -> Figure:
    """Return the figure: error over step, and time over error, ours over theirs."""
    figure = blank("CBMOS 2022 reproduced: lines are multicell, circles are published",
                   "Relative error of trajectories over the step (rows 1, 2), and CPU time over "
                   "it for the cubic law (row 3; published: wall time)", (14.0, 12.0))  # fmt: skip
    axes = figure.subplots(3, 4, sharey="row", sharex="row")
    figure.subplots_adjust(left=0.06, right=0.985, top=0.9, bottom=0.14, hspace=0.42, wspace=0.08)
    cases = (("euler", "euler", "forward"), ("backward-euler", "backward", "backward"))
    for column, problem in enumerate(dict.fromkeys(data["problem"])):
        mine, given = (pick(frame, problem=problem) for frame in (data, published))
        ours, costs = (pick(mine, chart=chart) for chart in ("step", "cost"))
        for row, (method, name, words) in enumerate(cases):
            axis = axes[row, column]
            for law, colour in COLOURS.items():
                for kind, dashes in ((method, "-"), ("theirs", ":"))[: row + 1]:
                    line = pick(ours, law=law, method=kind)
                    axis.plot(line["setting"], line["error"], dashes, color=colour)
                points = pick(given, law=law)
                axis.plot(points["step"], points[f"{name}_error"], "o", mfc="none", color=colour)
            for extra in ("heun", "rk4")[: 2 * (1 - row)]:
                line = pick(ours, method=extra)
                axis.plot(line["setting"], line["error"], "--", color=METHODS[extra].colour)
            axis.set(xscale="log", yscale="log", ylim=(1e-7, 20), xlabel="step / h")
            axis.set_title(f"{problem}, {words} Euler")
        axis, points = axes[2, column], pick(given, law="cubic")
        for method in OVER_COST:
            line = costs[(costs["method"] == method) & (costs["error"] < 0.3)]
            axis.plot(line["error"], line["seconds"], "-", lw=1.2, ms=4, label=method,
                      marker=METHODS[method].marker, color=METHODS[method].colour)  # fmt: skip
        for (_, name, words), marker in zip(cases, "os", strict=True):
            kept = points[points[f"{name}_error"] < 0.3]
            axis.plot(kept[f"{name}_error"], kept[f"{name}_seconds"], marker, mfc="none",
                      color="black", label=f"{words} Euler, published")  # fmt: skip
        axis.set(xscale="log", yscale="log", xlim=(3e-7, 2), xlabel="error")
        axis.set_title(f"{problem}, cost")
    for row, label in enumerate(("error", "error", "time / s")):
        axes[row, 0].set_ylabel(label)
    kinds: list[tuple[str, dict[str, Any]]] = [
        *((f"{law} law", {"color": colour}) for law, colour in COLOURS.items()),
        ("published", {"color": "black", "ls": "", "marker": "o", "mfc": "none"}),
        ("their Newton–GMRES, written anew", {"color": "black", "ls": ":"}),
        *((f"{name}, cubic law", {"color": METHODS[name].colour, "ls": "--"})
          for name in ("heun", "rk4")),
    ]  # fmt: skip
    lines = [Line2D([], [], label=label, **style) for label, style in kinds]
    figure.legend(handles=lines, title="rows 1 and 2", ncols=7, fontsize=9, loc="lower left",
                  bbox_to_anchor=(0.05, 0.055), alignment="left")  # fmt: skip
    figure.legend(*axes[2, 0].get_legend_handles_labels(), title="row 3", ncols=6, fontsize=9,
                  loc="lower left", bbox_to_anchor=(0.05, 0.0), alignment="left")  # fmt: skip
    return figure


def main() -> None:
    """Measure, or read what is stored; print tables and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tables", action="store_true", help="from what is stored")
    if not parser.parse_args().tables:
        measure().to_csv(DATA, index=False, float_format="%.4g", lineterminator="\n")
    data, published = (pd.read_csv(path) for path in (DATA, PUBLISHED))
    for frame, column in ((data, "setting"), (published, "step")):
        # the step's number on the papers' ladder: stored steps are rounded
        frame["row"] = np.round(np.log(frame[column] / 1e-3) / np.log(1.25)).astype(int)
    title = "Separation of two daughters, in cell diameters (figure 3)"
    print(f"{title}\n\n{daughters(pd.read_csv(DAUGHTERS))}\n\n{tables(data, published)}")
    picture = DOCS / "figures" / "mathias2022.png"
    save_figure(draw(data, published), picture)
    record(picture, "python docs/programs/mathias2022.py", {*OVER_STEP, *OVER_COST} - {"theirs"})


if __name__ == "__main__":
    main()
