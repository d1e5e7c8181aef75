"""Where implicit methods win: stiffness of a coupling step against the number of cells.

Problem   one coupling step of ten minutes of a cluster at rest (then strained by 1 %), growing, or
          with 2 % of the cells just divided; λΔt from 1e2 to 1e6, 1e2 to 1e5 cells, several seeds
Question  which method reaches an error of 1 % and of 0.1 % of a radius at least CPU time, in the
          worst cell, or in observables where the conditioning of the step leaves single cells to
          luck (docs/phase_problems.py, docs/phase_race.py)
Cost      printed at the beginning; one thread, so that two processes at once (--share 1/2 and
          --share 2/2) take half of the time
Command   python docs/phase_diagram.py     (--states, --cells, --stiffness, --seeds, --methods)

What is done is kept in docs/chart-data and not computed again; only methods that are missing are.
With --tables or --picture nothing is computed; both also merge what shares have written.
"""

from __future__ import annotations

import argparse
import csv
import math
import os
import time
from collections.abc import Iterable, Sequence
from itertools import product
from pathlib import Path
from typing import NamedTuple

from phase_picture import draw
from phase_problems import ACCURACIES, STATES, Solved, solved
from phase_race import REACHED, SLOW, not_tried, race, warm_up
from phase_tables import Point, crossings_table, points, points_table

from multicell.comparison.files import Row
from multicell.comparison.ladders import Method, find_method
from multicell.tables.text import table_text

HERE = Path(__file__).parent
NAME = "phase-diagram"
STIFFNESS = (1e2, 1e3, 1e4, 1e5, 1e6)
CELLS = (100, 1_000, 10_000, 100_000)
SEEDS = 5
FEW_SEEDS = {100_000: 2}
"""Number of cells -> number of seeds, where five would take too long."""
MOST = {100_000: 1e3}
"""Number of cells -> largest λΔt that is tried by default."""
METHODS = ("auto", "cvode", "rosenbrock", "rkc2", "ab2-adaptive", "dopri5")
WORDS = ("state", "method", "judged_by", "status", "control")


class Tile(NamedTuple):
    """A coupling step to solve."""

    seed: int
    cells: int
    stiffness: float
    state: str

    @property
    def columns(self) -> Row:
        """Its columns in the table."""
        return {"state": self.state, "cells": self.cells, "stiffness": self.stiffness,
                "seed": self.seed}  # fmt: skip

    @property
    def seconds(self) -> float:
        """About what it takes with five methods on a 2.5 GHz processor, CPU time in s."""
        work = self.cells / 1e3 * (0.4 + 0.5 * self.stiffness**0.22)
        return 0.2 + work * {"rest": 0.9, "growing": 0.45, "divided": 1.7}[self.state]


def grid(given: argparse.Namespace) -> list[Tile]:
    """Return the tiles of this share: seed by seed, small and mild ones first."""
    index, count = given.share
    tiles = []
    for seed, n, state in product(range(1, given.seeds + 1), given.cells, given.states):
        if n in FEW_SEEDS and seed > FEW_SEEDS[n] and not given.all:
            continue
        # series of growing stiffness stay together: what was hopeless before is not tried again
        if (seed + STATES.index(state)) % count != index - 1:
            continue
        most = math.inf if given.all else MOST.get(n, math.inf)
        tiles += [Tile(seed, n, z, state) for z in sorted(given.stiffness) if z <= most]
    return sorted(tiles, key=lambda tile: tile.cells in FEW_SEEDS)


def rows_of(rows: Iterable[Row], tile: Tile) -> list[Row]:
    """Return the rows of a tile."""
    wanted = tile.columns.items()
    return [row for row in rows if all(row[name] == value for name, value in wanted)]


def tried(tile: Tile, methods: Sequence[str], rows: Sequence[Row]) -> list[Row]:
    """Return the rows of methods that are missing in a tile."""
    begin = cpu_time()
    kept = rows_of(rows, tile)
    step = solved(tile.state, tile.cells, tile.stiffness, tile.seed)
    missing = [name for name in methods if name not in {row["method"] for row in kept}]
    chosen = [find_method(name, step.problem.scene, step.problem.mean_radius) for name in missing]
    hopeless = {m.name: why for m in chosen if (why := slower(m, tile, rows)) is not None}
    turn = tile.seed + STATES.index(tile.state) + round(2.0 * math.log10(tile.stiffness))
    racing = [m for m in chosen if m.name not in hopeless]
    found = race(step, racing, turn, _least(kept))
    found += _without(step, hopeless, [*kept, *found])
    took = cpu_time() - begin
    return [{**tile.columns, **row, "took_s": took} for row in found]


def cpu_time() -> float:
    """Return the CPU time of this process and of those that it has started, s."""
    return sum(os.times()[:4])


def slower(method: Method, tile: Tile, rows: Sequence[Row]) -> Row | None:
    """Return a row that shows that an explicit method was too slow on a less stiff step."""
    if method.info.implicit:
        return None
    for less in sorted({row["stiffness"] for row in rows if row["stiffness"] < tile.stiffness}):
        of = [r for r in rows_of(rows, tile._replace(stiffness=less)) if r["method"] == method.name]
        if of and all(row["status"] == SLOW for row in of):
            return of[0]
    return None


def _without(step: Solved, hopeless: dict[str, Row], rows: Sequence[Row]) -> list[Row]:
    """Return the rows of methods that are not tried: the bound that the others' cost sets."""
    found = []
    for a in ACCURACIES:
        there = [row for row in rows if row["accuracy"] == a]
        reached = [row for row in there if row["status"] == REACHED]
        if not there:
            continue
        best = min(reached or there, key=lambda row: row["cost_s"])
        found += [
            not_tried(name, bool(why["implicit"]), step, why, best)
            for name, why in hopeless.items()
        ]
    return found


def _least(rows: Iterable[Row]) -> dict[float, float]:
    """Return the least cost in s at which each accuracy was reached."""
    least: dict[float, float] = {}
    for row in rows:
        if row["status"] == REACHED:
            a = row["accuracy"]
            least[a] = min(row["cost_s"], least.get(a, math.inf))
    return least


def kept(folder: Path) -> list[Row]:
    """Return all rows that earlier runs have written, shares included; of two the later one."""
    found: dict[tuple[object, ...], Row] = {}
    for path in sorted(folder.glob(f"{NAME}*.csv")):
        with path.open(encoding="utf-8", newline="") as file:
            for texts in csv.DictReader(file):
                row: Row = {n: t if n in WORDS else float(t) for n, t in texts.items()}
                keys = ("state", "cells", "stiffness", "seed", "method", "accuracy")
                found[tuple(row[name] for name in keys)] = row
    return [found[key] for key in sorted(found, key=_order)]


def _order(key: tuple[object, ...]) -> tuple[object, ...]:
    return (STATES.index(str(key[0])), *key[1:])


def keep(path: Path, rows: Sequence[Row]) -> None:
    """Append rows to a table."""
    path.parent.mkdir(parents=True, exist_ok=True)
    text = table_text([{n: _short(v) for n, v in row.items()} for row in rows])
    if path.exists():
        text = text.partition("\n")[2]
    with path.open("a", encoding="utf-8", newline="") as file:
        file.write(text)


def _short(value: object) -> object:
    return float(f"{value:.5g}") if isinstance(value, float) else value


def merge(folder: Path) -> list[Row]:
    """Write one table of all rows, and remove those of shares."""
    rows = kept(folder)
    if rows:
        whole = folder / f"{NAME}.csv"
        partial = whole.with_suffix(".part")
        partial.write_text(table_text([{n: _short(v) for n, v in r.items()} for r in rows]))
        partial.replace(whole)
        for path in folder.glob(f"{NAME}.*-of-*.csv"):
            path.unlink()
    return rows


def compute(given: argparse.Namespace) -> None:
    """Solve the tiles that are not solved, until the time is over."""
    index, count = given.share
    name = f"{NAME}.{index}-of-{count}.csv" if count > 1 else f"{NAME}.csv"
    rows, tiles = kept(given.results), grid(given)
    open_tiles = [
        t for t in tiles if not set(given.methods) <= {r["method"] for r in rows_of(rows, t)}
    ]
    ahead = sum(tile.seconds for tile in open_tiles)
    print(f"{len(open_tiles)} of {len(tiles)} steps to solve, about {ahead / 60.0:.0f} min of CPU")
    if not open_tiles:
        return
    small = solved("divided", 100, 1e3, 1)
    warm_up(small, [find_method(m, small.problem.scene, small.problem.mean_radius)
                    for m in given.methods])  # fmt: skip
    begin = time.perf_counter()
    for k, tile in enumerate(open_tiles):
        if time.perf_counter() - begin > 60.0 * given.budget_minutes:
            print(f"time is over: {len(open_tiles) - k} steps are left")
            return
        since = time.perf_counter()
        new = tried(tile, given.methods, rows)
        keep(given.results / name, new)
        rows += new
        best = min(new, key=lambda r: (r["accuracy"] < 0.01, r["status"] != REACHED, r["cost_s"]))
        print(
            f"{k + 1}/{len(open_tiles)} {tile.state}, {tile.cells:,} cells, "
            f"λΔt = {tile.stiffness:.0e}, seed {tile.seed}: {best['method']} {best['cost_s']:.3g} s"
            f" for 1 %; {time.perf_counter() - since:.1f} s (expected {tile.seconds:.1f})",
            flush=True,
        )


def show(given: argparse.Namespace) -> None:
    """Print the tables and draw the picture of what is there."""
    rows = merge(given.results)
    if not rows:
        raise SystemExit("nothing is computed yet")
    for accuracy in ACCURACIES:
        found: list[Point] = points(rows, accuracy)
        print(f"\nError of {100 * accuracy:g} % of a radius\n")
        print(points_table(found))
        print()
        print(crossings_table(rows, accuracy))
        end = "" if accuracy == ACCURACIES[0] else "-fine"
        given.figures.mkdir(parents=True, exist_ok=True)
        draw(rows, accuracy).savefig(given.figures / f"{NAME}{end}.png", dpi=150)


def _share(text: str) -> tuple[int, int]:
    index, _, count = text.partition("/")
    if not (index.isdecimal() and count.isdecimal() and 1 <= int(index) <= int(count)):
        raise argparse.ArgumentTypeError(f"{text!r} is not like 1/2")
    return int(index), int(count)


def parser() -> argparse.ArgumentParser:
    """Return the options of the command."""
    made = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    made.add_argument("--states", nargs="+", choices=STATES, default=STATES)
    made.add_argument("--cells", type=int, nargs="+", default=CELLS)
    made.add_argument("--stiffness", type=float, nargs="+", default=STIFFNESS, help="λΔt")
    made.add_argument("--seeds", type=int, default=SEEDS, help="number of seeds (%(default)s)")
    made.add_argument("--all", action="store_true", help="all seeds and λΔt for any cells")
    made.add_argument("--methods", nargs="+", default=METHODS)
    made.add_argument("--share", type=_share, default=(1, 1), help="part of the work, like 1/2")
    made.add_argument("--budget-minutes", type=float, default=math.inf)
    made.add_argument("--tables", "--picture", action="store_true", help="compute nothing")
    made.add_argument("--results", type=Path, default=HERE / "chart-data")
    made.add_argument("--figures", type=Path, default=HERE / "figures")
    return made


def main() -> None:
    """Solve what is missing, then print the tables and draw the picture."""
    given = parser().parse_args()
    if not given.tables:
        compute(given)
    if given.tables or given.share[1] == 1:
        show(given)


if __name__ == "__main__":
    main()
