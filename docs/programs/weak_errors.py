"""Weak errors of observables over seeds: how tolerance and coupling step change distributions.

Problem   four scenes of 60 to 300 cells: free growth at 5 and at 0.05 kPa·s, a spheroid whose core
          is starved, and cells of two types that move and sort. At the end paths are lost: a cell's
          place is random with any method, and only distributions over seeds can be compared
Measured  radius of the uniform ball, viable rim, number of cells, contacts of a cell, and root mean
          square pressure of the cells: its mean is about zero where adhesion balances contact
Compared  `auto` at tolerances from 1 to 0.01 µm, and with the coupling step twice and half as
          long, with `auto` at 0.001 µm and the scene's coupling step; the same seeds. The steps
          halve the growth rates' sampling and draw other random numbers
Error     relative difference of the means with its 95 % interval: differences are paired by seed,
          and so are their standard errors. Spread: ratio of the standard deviations over the seeds,
          with the interval of Pitman and Morgan for paired samples
Cost      printed at the beginning; one thread (--share 1/2 and --share 2/2 for two processes)
Command   python docs/programs/weak_errors.py --results FOLDER    (--seeds, --scenes, --page)

Runs that are in FOLDER are not done again. With --tables nothing is run; --page writes the table
into docs/which-integrator.md.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple, final

import numpy as np
from marked import replaced
from scipy.spatial import cKDTree
from scipy.stats import t as student

import multicell as mc
from multicell.results.documents import Lines

PAGE = Path(__file__).parents[1] / "which-integrator.md"
NAME = "weak errors"
SEEDS = 40
LEVEL = 0.95
ASKED = 0.01
"""Relative error of a mean that the table of choices asks for."""

GROWTH: dict[str, Any] = {
    "initial.count": 60, "initial.stage": "uniform", "duration": "24 h", "output.every": "24 h",
}  # fmt: skip
SCENES: dict[str, tuple[str, dict[str, Any]]] = {
    "growth, 5 kPa·s": ("growth", GROWTH),
    "growth, 0.05 kPa·s": ("growth", {**GROWTH, "drag.viscosity": 0.05, "duration": "12 h"}),
    "starved core": (
        "spheroid",
        {
            "initial.count": 500, "initial.stage": "uniform", "duration": "12 h",
            "nutrients.oxygen.boundary": 0.025, "nutrients.oxygen.necrosis": 0.0145,
            "output.every": "12 h",
        },
    ),
    "motile, two types": (
        "sorting", {"initial.count": 100, "duration": "2 h", "output.every": "2 h"},
    ),
}  # fmt: skip
"""Name -> built-in scene, and changes of it."""
SECONDS = 0.25  # of a run on 2.5 GHz, on average
OBSERVABLES = {
    "radius": "µm", "viable rim": "µm", "cells": "", "contacts of a cell": "",
    "pressure, rms": "kPa",
}  # fmt: skip


class Candidate(NamedTuple):
    """A tolerance in µm and a coupling step over the scene's own."""

    atol: float
    step: float = 1.0

    def __str__(self) -> str:
        if self.step == 1.0:
            return f"{self.atol:g} µm"
        return f"{self.atol:g} µm, step × {self.step:g}"


REFERENCE = Candidate(0.001)
CANDIDATES = (
    Candidate(1.0), Candidate(0.3), Candidate(0.1), Candidate(0.01), Candidate(0.1, 2.0),
    Candidate(0.1, 0.5),
)  # fmt: skip


def observables(simulation: mc.Simulation) -> dict[str, float]:
    """Return the observables of a run; without a starved core there is no rim."""
    row, cells = simulation.history_row(), simulation.cells
    found = {
        "radius": 0.5 * row["diameter"],
        "cells": float(len(cells)),
        "contacts of a cell": contacts(cells.position, cells.radius),
        "pressure, rms": float(np.sqrt(np.mean(cells.pressure**2))),
    }
    if simulation.scene.death is not None:
        found["viable rim"] = row["viable_rim"]
    return found


def contacts(position: np.ndarray, radius: np.ndarray) -> float:
    """Return the mean number of cells that overlap with a cell."""
    first, second = cKDTree(position).query_pairs(2.0 * radius.max(), output_type="ndarray").T
    away = np.linalg.norm(position[first] - position[second], axis=1)
    return float(2.0 * np.count_nonzero(away < radius[first] + radius[second]) / len(radius))


def run(scene: str, candidate: Candidate, seed: int) -> dict[str, Any]:
    """Run a scene to its end; return its entry in the log."""
    name, changes = SCENES[scene]
    described = mc.load_scene(name)
    described = described.with_changes(
        {
            **changes,
            "seed": 1000 + seed,
            "integrator.method": "auto",
            "integrator.atol": candidate.atol,
            "coupling_step": described.coupling_step * candidate.step,
        }
    )
    begin = time.process_time()
    simulation = mc.Simulation(described, threads=1)
    while not simulation.finished:
        simulation.step()
    return {
        "scene": scene,
        "candidate": [candidate.atol, candidate.step],
        "seed": seed,
        "values": observables(simulation),
        "cpu_s": round(time.process_time() - begin, 3),
    }


@final
@dataclass(frozen=True)
class WeakError:
    """Difference of a candidate from the reference in the distribution of an observable.

    - ``mean``, ``half``: relative difference of the means, and half the width of its interval
    - ``spread``, ``low``, ``high``: ratio of the standard deviations, and its interval
    - ``scatter``: standard deviation over the seeds in the reference, over the mean
    - ``seeds``: number of pairs
    """

    mean: float
    half: float
    spread: float
    low: float
    high: float
    scatter: float
    seeds: int

    @property
    def most(self) -> float:
        """Largest relative error of the mean within the interval."""
        return abs(self.mean) + self.half


def weak_error(found: np.ndarray, exact: np.ndarray) -> WeakError:
    """Return the weak error of paired samples, (n,) each, of three or more seeds.

    The ratio of standard deviations s of correlated samples has the interval of Pitman (1939) and
    Morgan (1939): ratios k at which found - k exact and found + k exact are not correlated.
    """
    n, scale = len(found), abs(exact.mean())
    off = found - exact
    quantile = float(student.ppf(0.5 + 0.5 * LEVEL, n - 1))
    half = quantile * off.std(ddof=1) / math.sqrt(n)
    ours, true = found.std(ddof=1), exact.std(ddof=1)
    spread = low = high = math.nan
    if ours > 0.0 and true > 0.0:
        spread = ours / true
        tail = float(student.ppf(0.5 + 0.5 * LEVEL, n - 2)) ** 2
        unlike = max(1.0 - np.corrcoef(found, exact)[0, 1] ** 2, 0.0)
        wide = 1.0 + 2.0 * tail * unlike / (n - 2)
        root = math.sqrt(max(wide * wide - 1.0, 0.0))
        low, high = spread * math.sqrt(wide - root), spread * math.sqrt(wide + root)
    return WeakError(off.mean() / scale, half / scale, spread, low, high, true / scale, n)


Values = Mapping[tuple[str, Candidate, str], Mapping[int, float]]
"""Scene, candidate and observable -> value by seed."""


def stored(folder: Path) -> tuple[Values, set[tuple[str, Candidate, int]]]:
    """Return the values in the folder, and the runs that are done."""
    values: dict[tuple[str, Candidate, str], dict[int, float]] = {}
    done = set()
    for path in sorted(folder.glob("weak-errors*.log")):
        for entry in Lines(path).entries:
            scene, candidate, seed = entry["scene"], Candidate(*entry["candidate"]), entry["seed"]
            done.add((scene, candidate, seed))
            for name, value in entry["values"].items():
                values.setdefault((scene, candidate, name), {})[seed] = value
    return values, done


def errors(values: Values) -> dict[tuple[str, Candidate, str], WeakError]:
    """Return the weak error of each candidate in each observable of each scene."""
    found = {}
    for (scene, candidate, name), ours in values.items():
        exact = values.get((scene, REFERENCE, name), {})
        seeds = sorted(set(ours) & set(exact))
        if candidate != REFERENCE and len(seeds) > 2:
            pair = [np.array([x[seed] for seed in seeds]) for x in (ours, exact)]
            if all(np.isfinite(x).all() for x in pair) and pair[1].mean() != 0.0:
                found[scene, candidate, name] = weak_error(*pair)
    return found


def full_table(found: Mapping[tuple[str, Candidate, str], WeakError]) -> str:
    """Return all errors, one line for each scene, observable and candidate."""
    head = "scene | observable | candidate | seeds | error / % | spread ratio | scatter / %"
    lines = [f"| {head} |", "|---|---|---|---|---|---|---|"]
    for scene, name, candidate in product(SCENES, OBSERVABLES, CANDIDATES):
        e = found.get((scene, candidate, name))
        if e is not None:
            lines.append(
                f"| {scene} | {name} | {candidate} | {e.seeds} | {100 * e.mean:+.2g} ± "
                f"{100 * e.half:.2g} | {e.spread:.2f} ({e.low:.2f} to {e.high:.2f}) | "
                f"{100 * e.scatter:.2g} |"
            )
    return "\n".join(lines)


def choices(found: Mapping[tuple[str, Candidate, str], WeakError]) -> str:
    """Return the table of choices: for each observable the worst scene at each candidate.

    The last column has the loosest tolerance with which all scenes are shown to be within 1 %.
    """
    shown = sorted({candidate for _, candidate, _ in found}, key=lambda c: (c.step != 1.0, -c.atol))
    columns = [*(f"{candidate}" for candidate in shown), "within 1 % by"]
    lines = [f"| observable | {' | '.join(columns)} |", "|---" * (len(columns) + 1) + "|"]
    for name in OBSERVABLES:
        cells, good = [], []
        for candidate in shown:
            here = [e for (_, c, o), e in found.items() if (c, o) == (candidate, name)]
            if not here:
                cells.append("")
                continue
            worst = max(here, key=lambda e: e.most)
            cells.append(f"{100 * worst.mean:+.2g} ± {100 * worst.half:.2g}")
            if candidate.step == 1.0 and worst.most <= ASKED:
                good.append(candidate)
        loosest = f"{max(good).atol:g} µm" if good else "not resolved"
        lines.append(f"| {name} | {' | '.join(cells)} | {loosest} |")
    return "\n".join(lines)


def compute(given: argparse.Namespace) -> None:
    """Run what is missing, all candidates of a seed and a scene before the next ones."""
    _, done = stored(given.results)
    index, count = map(int, given.share.split("/"))
    ahead = [
        (scene, candidate, seed)
        for k, (seed, scene) in enumerate(product(range(given.seeds), given.scenes))
        if k % count == index - 1
        for candidate in (REFERENCE, *CANDIDATES)
        if (scene, candidate, seed) not in done
    ]
    print(f"{len(ahead)} runs to do, about {len(ahead) * SECONDS / 60.0:.0f} min of CPU")
    given.results.mkdir(parents=True, exist_ok=True)
    log = Lines(given.results / f"weak-errors.{index}-of-{count}.log")
    for k, (scene, candidate, seed) in enumerate(ahead):
        entry = run(scene, candidate, seed)
        log.append([entry])
        cost = entry["cpu_s"]
        print(f"{k + 1}/{len(ahead)} {scene}, {candidate}, seed {seed}: {cost} s", flush=True)


def main() -> None:
    """Run what is missing and print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--results", type=Path, default=Path("weak-errors"))
    parser.add_argument("--seeds", type=int, default=SEEDS, help="number of seeds (%(default)s)")
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=list(SCENES))
    parser.add_argument("--share", default="1/1", help="part of the work, like 1/2")
    parser.add_argument("--tables", action="store_true", help="run nothing")
    parser.add_argument("--page", action="store_true", help="write the table into the page")
    given = parser.parse_args()
    if not given.tables:
        compute(given)
    found = errors(stored(given.results)[0])
    if not found:
        raise SystemExit("fewer than three seeds are done")
    print(f"\n{full_table(found)}\n\n{choices(found)}")
    if given.page:
        text = PAGE.read_text(encoding="utf-8")
        PAGE.write_text(replaced(text, NAME, choices(found)), encoding="utf-8")


if __name__ == "__main__":
    main()
