"""Weak error against cost of methods for Brownian motion, at several lengths of internal steps.

Problem   a cell between held ones on springs, in a plane (variance D γ/k); pairs on a spring (mean
          square of its extension, by Boltzmann's distribution); 64 cells that fill a box which
          repeats (mean square pressure), or a scene of the user's own by --scene
Compared  euler, heun and rk4 with one step in each internal step, and methods that control their
          steps, at their default tolerances. Internal steps h are halved three times
Error     relative difference of the mean from that of the same paths in steps of h/32 by heun,
          with its 95 % interval over cells × seeds, of means over time; in tissue over seeds. Where
          there is a closed form, the reference is compared with it
Order     slope of the logarithm of the error over that of h, by regression over the errors that
          their intervals resolve, with its 95 % interval over resampled cells or seeds
Cost      evaluations, passes over all cells (a list of neighbours counts as seven evaluations) and
          CPU time, of one thread, for each cell and relaxation time
Command   python docs/programs/brownian_chart.py --results FOLDER    (--seeds, --problems, --page)
          python docs/programs/brownian_chart.py --results FOLDER --scene SCENE

Runs that are in FOLDER are not done again. With --tables nothing is run; --page draws the picture
and writes tables and data of the documentation.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple, final

import numpy as np
import pandas as pd
from marked import replaced
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from picture_origins import FIGURES, record
from scipy.integrate import quad
from scipy.stats import t as student

import multicell as mc
from multicell.integrators.registry import METHODS
from multicell.mechanics.motion import Work
from multicell.report.plots.style import render, save_figure, styled
from multicell.results.documents import Lines
from multicell.scene.sizes import internal_step

DOCS = Path(__file__).parents[1]
PAGE, DATA = DOCS / "implicit-or-explicit.md", DOCS / "chart-data" / "brownian.csv"
PICTURE = FIGURES / "brownian.png"
NAME = "Brownian motion"
SEEDS = 8
LEVEL = 0.95
SHOWN = ("euler", "heun", "rk4", "rk4-adaptive", "rkc2", "cvode", "auto")
HALVINGS = 4
"""Lengths of internal steps, each half of the one before."""
FINER = 32
"""How many steps of the reference one of the longest internal steps has."""
WARM, MEASURED = 3, 8
"""Coupling steps before the measurement, and in it."""
IN_COUPLING = 4
"""Longest internal steps in a coupling step."""

RADIUS = 5.0 * 0.5 ** (1.0 / 3.0)
DRAG = 6.0 * math.pi * 5.0 * RADIUS
STIFFNESS = 2.0
LENGTH = 2.0 * RADIUS
COPIES = 160


@final
@dataclass(frozen=True)
class Problem:
    """A scene, and the means of its cells that are measured.

    - ``scene``, ``cells``: as ``mc.Simulation`` takes them
    - ``longest``: longest internal step, s
    - ``relaxation``: unit of time for costs, s
    - ``measure``: state, positions at the beginning (n, 3) -> samples by observable
    - ``exact``: value of the first observable, NaN where it is not known
    """

    scene: mc.Scene
    cells: Mapping[str, Any] | None
    longest: float
    relaxation: float
    measure: Callable[[mc.Simulation, np.ndarray], dict[str, np.ndarray]]
    exact: float = math.nan


class Try(NamedTuple):
    """A method, and how many of its internal steps the longest one has."""

    method: str
    parts: int


REFERENCE = Try("heun", FINER)
TRIES = tuple(Try(method, 2**k) for method, k in product(SHOWN, range(HALVINGS)))


def by_identity(simulation: mc.Simulation) -> np.ndarray:
    """Return the places of the cells in the order of their identities, (n, 3) µm."""
    cells = simulation.cells
    return np.asarray(cells.position[np.argsort(cells.id)])


def table(places: np.ndarray, **more: Any) -> dict[str, Any]:
    """Return a table of cells at places (n, 3), µm."""
    return dict(zip(("x_um", "y_um", "z_um"), places.T, strict=True)) | more


def on_springs(kappa: float, variance: float, **parts: Any) -> tuple[mc.Scene, float]:
    """Return a scene of springs with a variance in µm², and its longest internal step, s."""
    longest = 0.8 / kappa
    scene = mc.Scene.from_dict(
        {
            "duration": 1e9,
            "coupling_step": IN_COUPLING * longest,
            "output": {"every": 1e9},
            "cells": {"young_variation": 0.0},
            "contact": {"law": "linear", "stiffness_at_rest": STIFFNESS},
            "motility": {"diffusion": variance * kappa},
            **parts,
        }
    )
    return scene, longest


def spring() -> Problem:
    """Return cells between four held ones each, which two of them pull back along each axis."""
    kappa, variance = 2.0 * STIFFNESS / DRAG, (0.02 * LENGTH) ** 2
    centre = np.zeros((COPIES, 3))
    centre[:, 0] = 20.0 * RADIUS * np.arange(COPIES)
    ways = LENGTH * np.array([[0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    places = (centre + ways[:, None]).reshape(-1, 3)
    scene, longest = on_springs(
        kappa,
        variance,
        dimensions=2,
        motions={"anchor": {"type": "held"}},
        types={"free": {}, "held": {"diffusion_scale": 0}},
    )
    del_z = {k: v for k, v in table(places).items() if k != "z_um"}
    cells = del_z | {"type": np.repeat(["free", "held"], [COPIES, 4 * COPIES])}

    def measure(simulation: mc.Simulation, _: np.ndarray) -> dict[str, np.ndarray]:
        away = by_identity(simulation)[:COPIES] - centre
        return {"variance": 0.5 * np.square(away[:, :2]).sum(axis=1)}

    return Problem(scene, cells, longest, 1.0 / kappa, measure, variance)


def pairs() -> Problem:
    """Return pairs of cells that a spring holds together, far from all others."""
    kappa = 2.0 * STIFFNESS / DRAG
    places = np.zeros((COPIES, 2, 3))
    places[..., 0] = 40.0 * RADIUS * np.arange(COPIES)[:, None]
    places[:, 1, 0] += LENGTH
    part = 0.003  # energy over that of a spring that is as long as a cell
    scene, longest = on_springs(kappa, part * LENGTH**2)
    energy = 2.0 * part * STIFFNESS * LENGTH**2

    def measure(simulation: mc.Simulation, _: np.ndarray) -> dict[str, np.ndarray]:
        both = by_identity(simulation).reshape(-1, 2, 3)
        length = np.linalg.norm(both[:, 1] - both[:, 0], axis=1)
        return {"square of the extension": np.square(length - LENGTH)}

    def moment(power: int) -> float:
        def weight(r: float) -> float:
            away = r - LENGTH
            return float(r**2 * away**power * np.exp(-0.5 * STIFFNESS * away**2 / energy))

        # none gets away: the well is 20 energies deep at the cutoff
        return float(quad(weight, 0.2 * LENGTH, 1.5 * LENGTH)[0])

    return Problem(
        scene, table(places.reshape(-1, 3)), longest, 1.0 / kappa, measure, moment(2) / moment(0)
    )


def tissue_measure(simulation: mc.Simulation, start: np.ndarray) -> dict[str, np.ndarray]:
    """Return observables of a tissue, one number each; displacements where all cells are left."""
    found = {"mean square pressure": np.array([np.mean(simulation.cells.pressure**2)])}
    places = by_identity(simulation)
    if len(places) == len(start):
        way = np.square(places - start).sum(axis=1)
        found["mean square displacement"] = np.array([way.mean()])
    return found


def tissue() -> Problem:
    """Return 64 cells with Hertz's contacts in a box that repeats along all axes."""
    size = 30.0
    grid = np.stack(np.meshgrid(*3 * [np.arange(4)]), axis=-1).reshape(-1, 3) + 0.5
    shift = np.random.default_rng(0).normal(0.0, 0.02, (64, 3))
    longest = 32.0
    scene = mc.Scene.from_dict(
        {
            "duration": 1e9,
            "coupling_step": IN_COUPLING * longest,
            "output": {"every": 1e9},
            "contact": {"law": "hertz"},
            "motility": {"diffusion": "0.002 um^2/s"},
            "domain": {axis: [0.0, size] for axis in "xyz"} | {"periodic": ["x", "y", "z"]},
        }
    )
    return Problem(scene, table((grid + shift) * size / 4.0), longest, longest, tissue_measure)


PROBLEMS: dict[str, Callable[[], Problem]] = {
    "springs": spring,
    "pairs": pairs,
    "tissue": tissue,
}
TITLES = {
    "springs": "a cell on springs",
    "pairs": "pairs in contact",
    "tissue": "tissue of 64 cells",
}


def own(name: str) -> Problem:
    """Return a scene of the user's own, from twice its default internal step on.

    Raises SystemExit where the scene has no diffusion, or a coupling step too short to be cut.
    """
    scene = mc.load_scene(name)
    if scene.motility is None or scene.motility.diffusion is None:
        raise SystemExit(f"{name}: motility.diffusion is missing, so that nothing is random here")
    longest = min(2.0 * internal_step(scene), scene.coupling_step)
    return Problem(scene, None, longest, longest, tissue_measure)


def described(problem: Problem, one: Try, seed: int) -> mc.Scene:
    """Return the scene that a method solves with a seed."""
    step = problem.longest / one.parts
    integrator: dict[str, Any] = {"method": one.method}
    if METHODS[one.method].control == "step":
        # one in each internal step, however far it goes
        integrator |= {"step": 1.01 * step, "max_displacement": 1.0}
    return problem.scene.with_changes(
        {
            "seed": 100 + seed,
            "integrator": integrator,
            "motility.diffusion_step": 1.001 * step,
        }
    )


def counts(simulation: mc.Simulation) -> dict[str, int]:
    """Return the counts of work since the start of a run that `Work` knows."""
    progress = simulation.frame().progress
    assert progress is not None
    return {name: progress.work[name] for name in vars(Work())}


def run(problem: Problem, one: Try, seed: int) -> dict[str, Any]:
    """Run a problem with a method; return samples, means over time, and costs.

    A method that ends with an error has no samples, and ``failed`` has its words.
    """
    scene = described(problem, one, seed)
    simulation = mc.Simulation(scene, cells=problem.cells, threads=1)
    samples: dict[str, list[np.ndarray]] = {}
    start = by_identity(simulation)
    try:
        for _ in range(WARM):
            simulation.step()
        before, begin = counts(simulation), time.process_time()
        spent, steps = 0.0, 0
        while steps < MEASURED and not simulation.finished:
            simulation.step()
            steps += 1
            spent += time.process_time() - begin
            for name, values in problem.measure(simulation, start).items():
                samples.setdefault(name, []).append(values)
            begin = time.process_time()
    except mc.StepFailed as error:
        return {"failed": str(error)}
    after = counts(simulation)
    work = Work(**{name: after[name] - before[name] for name in before})
    units = steps * scene.coupling_step / problem.relaxation
    return {
        # where cells divide, there are no displacements at later times
        "samples": {
            name: np.mean(rows, axis=0).tolist()
            for name, rows in samples.items()
            if len(rows) == steps
        },
        "evaluations": work.evaluations / units,
        "passes": work.effort / units,
        "cpu_us": 1e6 * spent / units / len(simulation.cells),
    }


Entries = Mapping[tuple[str, Try], Mapping[int, Mapping[str, Any]]]
"""Problem and try -> entry of the log by seed."""


def stored(folder: Path) -> Entries:
    """Return the entries in a folder."""
    found: dict[tuple[str, Try], dict[int, Any]] = {}
    for path in sorted(folder.glob("brownian*.log")):
        for entry in Lines(path).entries:
            one = Try(*entry["try"])
            found.setdefault((entry["problem"], one), {})[entry["seed"]] = entry
    return found


def compute(given: argparse.Namespace) -> None:
    """Run what is missing, all tries of a problem and a seed before the next ones."""
    done = stored(given.results)
    ahead = [
        (name, one, seed)
        for seed, name in product(range(given.seeds), given.problems)
        for one in (REFERENCE, *TRIES)
        if seed not in done.get((name, one), {})
    ]
    print(f"{len(ahead)} runs to do, about {len(ahead) / 200.0:.1f} min of CPU")
    given.results.mkdir(parents=True, exist_ok=True)
    log, problems = Lines(given.results / "brownian.log"), {}
    for k, (name, one, seed) in enumerate(ahead):
        if name not in problems:
            problems[name] = PROBLEMS[name]() if name in PROBLEMS else own(name)
        entry = run(problems[name], one, seed)
        log.append([{"problem": name, "try": [*one], "seed": seed, **entry}])
        print(f"{k + 1}/{len(ahead)} {name}, {one.method}, 1/{one.parts}, seed {seed}", flush=True)


def interval(values: np.ndarray) -> tuple[float, float]:
    """Return the mean of independent values and half the width of its 95 % interval."""
    n = len(values)
    if n < 2:
        return float(values.mean()), math.nan
    quantile = float(student.ppf(0.5 + 0.5 * LEVEL, n - 1))
    return float(values.mean()), quantile * float(values.std(ddof=1)) / math.sqrt(n)


def paired(entries: Entries, problem: str, one: Try, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return samples of a try and those of the reference on the same paths, (n,) each.

    There are none where some run of them failed: those that did not are no fair sample.
    """
    ours, exact = (entries.get((problem, which), {}) for which in (one, REFERENCE))
    both: list[list[float]] = [[], []]
    for seed in sorted(set(ours) & set(exact)):
        pair = [by_seed[seed].get("samples", {}).get(name) for by_seed in (ours, exact)]
        if None in pair:
            return np.empty(0), np.empty(0)
        for column, values in zip(both, pair, strict=True):
            column.extend(values)
    return np.array(both[0]), np.array(both[1])


def data(entries: Entries) -> pd.DataFrame:
    """Return the error and the costs of each try in each observable, a row each."""
    rows = []
    names = {
        (problem, name): None
        for (problem, one), by_seed in entries.items()
        if one == REFERENCE
        for entry in by_seed.values()
        for name in entry.get("samples", {})
    }
    for (problem, name), one in product(names, TRIES):
        ours, exact = paired(entries, problem, one, name)
        if not len(ours):
            continue
        error, half = interval((ours - exact) / exact.mean())
        seen = entries[problem, one].values()
        cost = {
            unit: float(np.median([entry[unit] for entry in seen if unit in entry]))
            for unit in ("evaluations", "passes", "cpu_us")
        }
        rows.append(
            {
                "problem": problem,
                "observable": name,
                "method": one.method,
                "parts": one.parts,
                "samples": len(ours),
                "error": error,
                "half": half,
                **cost,
            }
        )
    return pd.DataFrame(rows)


def order(
    entries: Entries, problem: str, method: str, name: str, resamples: int = 400
) -> tuple[float, float, float, int] | None:
    """Return the weak order by regression, its 95 % interval, and the number of errors in it.

    Errors count whose interval does not reach zero; with fewer than two there is none.
    """
    parts, rows = [], []
    for k in range(HALVINGS):
        ours, exact = paired(entries, problem, Try(method, 2**k), name)
        if len(ours):
            off = (ours - exact) / exact.mean()
            mean, half = interval(off)
            if abs(mean) > half:
                parts.append(2**k)
                rows.append(off)
    if len(rows) < 2:
        return None
    away, along = np.array(rows), -np.log(parts)

    def slope(means: np.ndarray) -> float:
        return float(np.polyfit(along, np.log(np.abs(means)), 1)[0])

    random = np.random.default_rng(0)
    drawn = random.integers(away.shape[1], size=(resamples, away.shape[1]))
    again = [slope(away[:, which].mean(axis=1)) for which in drawn]
    low, high = np.quantile(again, [0.5 - 0.5 * LEVEL, 0.5 + 0.5 * LEVEL])
    return slope(away.mean(axis=1)), float(low), float(high), len(parts)


def full_table(found: pd.DataFrame) -> str:
    """Return all errors and costs, a line each."""
    lines = [
        "| problem | observable | method | h | error / % | evaluations | passes | CPU / µs |",
        "|---" * 8 + "|",
    ]
    for row in found.itertuples():
        lines.append(
            f"| {row.problem} | {row.observable} | `{row.method}` | 1/{row.parts} | "
            f"{100 * row.error:+.2g} ± {100 * row.half:.2g} | {row.evaluations:.3g} | "
            f"{row.passes:.3g} | {row.cpu_us:.3g} |"
        )
    return "\n".join(lines)


def checks(entries: Entries) -> str:
    """Return the reference beside each closed form."""
    lines = []
    for problem, make in PROBLEMS.items():
        by_seed, exact = entries.get((problem, REFERENCE), {}), make().exact
        columns = [
            values for entry in by_seed.values() for values in [*entry["samples"].values()][:1]
        ]
        if columns and np.isfinite(exact):
            mean, half = interval(np.concatenate(columns) / exact - 1.0)
            lines.append(
                f"{TITLES[problem]}: reference {100 * mean:+.2f} ± {100 * half:.2f} % "
                "from the closed form"
            )
    return "\n".join(lines)


def summary(entries: Entries, found: pd.DataFrame) -> str:
    """Return the table of the page: orders, and errors and passes at the second longest step."""
    main = {problem: group.iloc[0]["observable"] for problem, group in found.groupby("problem")}
    shown = [problem for problem in TITLES if problem in main] or sorted(main)
    heads = [
        f"{what}: {TITLES.get(problem, problem)}"
        for what in ("error", "order")
        for problem in shown
    ]
    lines = [f"| method | {' | '.join(heads)} |", "|---" * (len(heads) + 1) + "|"]
    for method in SHOWN:
        errors, orders = [], []
        for problem in shown:
            at = found[
                (found["problem"] == problem)
                & (found["observable"] == main[problem])
                & (found["method"] == method)
                & (found["parts"] == 2)
            ]
            errors.append("failed")
            if len(at):
                row = at.iloc[0]
                size, half = 100.0 * row["error"], 100.0 * row["half"]
                errors[-1] = f"{size:+.2g} ± {half:.1g} %, {row['passes']:.0f}"
            slope = order(entries, problem, method, main[problem])
            orders.append("not resolved")
            if slope is not None:
                orders[-1] = f"{slope[0]:.1f} ({slope[1]:.1f} to {slope[2]:.1f})"
        lines.append(f"| `{method}` | {' | '.join([*errors, *orders])} |")
    return "\n".join(lines)


@styled
def drawn(found: pd.DataFrame) -> Any:
    """Return the picture: a column for each problem, passes above and CPU below."""
    from matplotlib.figure import Figure

    there = set(found["problem"])
    shown = [problem for problem in TITLES if problem in there] + sorted(there - set(TITLES))
    figure = Figure(figsize=(1.2 + 3.0 * len(shown), 6.4), dpi=160, layout="constrained")
    axes = figure.subplots(2, len(shown), squeeze=False, sharey="col")
    labels = {"passes": "passes over all cells", "cpu_us": "CPU / µs per cell"}
    for (row, unit), (column, problem) in product(enumerate(labels), enumerate(shown)):
        here, ours = axes[row, column], found[found["problem"] == problem]
        ours = ours[ours["observable"] == ours.iloc[0]["observable"]]
        for method, points in ours.groupby("method", sort=False):
            draw_method(here, str(method), points, unit)
        here.set(xscale="log", yscale="log", xlabel=labels[unit])
        for axis in (here.xaxis, here.yaxis):
            axis.set_major_locator(LogLocator(subs=(1.0,) if axis is here.yaxis else (1.0, 3.0)))
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            axis.set_minor_formatter(NullFormatter())
        if not row:
            here.set_title(TITLES.get(problem, "own scene"))
        if not column:
            here.set_ylabel("weak error / %")
    figure.legend(
        *axes[0, 0].get_legend_handles_labels(),
        loc="outside lower center",
        ncols=len(SHOWN),
        fontsize=11,
        columnspacing=1.0,
        handletextpad=0.4,
    )
    return figure


def draw_method(axes: Any, method: str, points: pd.DataFrame, unit: str) -> None:
    """Draw the errors of a method over a cost; those that reach zero hollow, and up from there."""
    look, size = METHODS[method], 100.0 * points["error"].abs()
    half = 100.0 * points["half"].fillna(0.0)
    clear = half < size
    axes.plot(points[unit], size, color=look.colour, linewidth=1.2)
    axes.errorbar(
        points[unit],
        size,
        [half.where(clear, 0.0), half],
        fmt="none",
        color=look.colour,
        elinewidth=0.7,
    )
    axes.plot([], [], color=look.colour, marker=look.marker, markersize=5, label=method)
    for which, face in ((clear, look.colour), (~clear, "white")):
        axes.plot(
            points[unit][which],
            size[which],
            look.marker,
            color=look.colour,
            markerfacecolor=face,
            markersize=5,
        )


def main() -> None:
    """Run what is missing, print the tables, and draw."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--results", type=Path, default=Path("brownian"))
    parser.add_argument("--seeds", type=int, default=SEEDS, help="number of seeds (%(default)s)")
    parser.add_argument("--problems", nargs="+", choices=PROBLEMS, default=list(PROBLEMS))
    parser.add_argument("--scene", help="a scene of your own instead of the problems")
    parser.add_argument("--tables", action="store_true", help="run nothing")
    parser.add_argument("--page", action="store_true", help="write picture, data and page")
    given = parser.parse_args()
    if given.scene is not None:
        given.problems = [given.scene]
    if not given.tables:
        compute(given)
    entries = stored(given.results)
    found = data(entries)
    if not len(found):
        raise SystemExit("no try is done beside its reference")
    print(f"\n{full_table(found)}\n\n{summary(entries, found)}\n\n{checks(entries)}")
    picture = drawn(found)
    (given.results / "brownian.png").write_bytes(render(picture, "png"))
    if given.page:
        save_figure(picture, PICTURE)
        record(PICTURE, "python docs/programs/brownian_chart.py --results FOLDER --page", SHOWN)
        found.to_csv(DATA, index=False, float_format="%.4g", lineterminator="\n")
        text = PAGE.read_text(encoding="utf-8")
        PAGE.write_text(replaced(text, NAME, summary(entries, found)), encoding="utf-8")


if __name__ == "__main__":
    main()
