"""Implicit or explicit: which method reaches an error at least cost, tile by tile.

Problem   coupling steps of ten minutes of growing clusters (tile_problems.py): quiet, typical
          and fresh tissue, 1e2 to 1e5 cells, λΔt from 10 to 1e6, several seeds
Error     root mean square over the cells of the distance from the reference, over that of the
          motion that the best dilation leaves (multicell.comparison.null_methods); the error of the
          worst cell over the largest motion stands beside it
Question  which method has an error of 10 % and of 1 % at least CPU time, and what the default
          tolerances cost and reach (tile_race.py)
Methods   all in the registry with an error control, and the null methods. From the fourth seed on,
          and from one number of cells to the next, methods that were far behind are left out.
Cost      printed at the beginning; one thread. --quick takes about two minutes
Command   python docs/programs/tiles.py     (--states, --cells, --stiffness, --seeds, --methods)
          python docs/programs/tiles.py --again 5     five tiles with other seeds, to compare

What is done is kept in docs/chart-data and not computed again. With --tables nothing is computed;
--renew METHOD solves by that method again, if it has changed.
"""

from __future__ import annotations

import argparse
import csv
import math
import os
from collections.abc import Iterable, Sequence
from itertools import product
from pathlib import Path
from statistics import median

from marked import replaced
from picture_origins import record
from tile_picture import draw
from tile_problems import GOALS, STATES, Solved, Tile, solved
from tile_race import DEFAULT, REACHED, Row, race
from tile_tables import again_table, defaults_table, main_table, points, states_table

from multicell.comparison.ladders import find_method
from multicell.comparison.null_methods import NULL_METHODS
from multicell.comparison.replay import replay
from multicell.integrators.registry import METHODS
from multicell.report.plots.style import save_figure
from multicell.tables.text import table_text

DOCS = Path(__file__).parents[1]
STIFFNESS = (1e1, 1e2, 1e3, 1e4, 1e5, 1e6)
SEEDS = {100: 20, 1_000: 20, 10_000: 5, 100_000: 1}
"""Number of cells -> number of seeds."""
MOST = {100_000: 1e3}
"""Number of cells -> largest λΔt that is tried by default."""
PILOTS, NEAR, FAR = 3, 2.0, 5.0
"""Seeds that all methods solve; cost over the best one's up to which a method takes part in later
seeds, and with more cells."""
OTHERS = 1000
"""Seeds from here on are those of --again."""
WORDS = ("state", "method", "status", "scene", "step")
KEY = ("state", "cells", "stiffness", "seed")


def registered() -> list[str]:
    """Return the names of the methods that take part: those with an error control of our own."""
    return [n for n, m in METHODS.items() if m.control == "tolerance" and not m.outside]


def columns(tile: Tile) -> Row:
    """Return the columns of a tile in the tables."""
    return {name: getattr(tile, name) for name in KEY}


def grid(given: argparse.Namespace) -> list[Tile]:
    """Return the tiles: few cells first, seed by seed, so that a part is a picture of its own."""
    tiles = []
    for n in sorted(given.cells):
        count = given.seeds or SEEDS.get(n, 1)
        for seed, z in product(range(1, count + 1), sorted(given.stiffness)):
            if z <= MOST.get(n, math.inf) or given.all:
                tiles += [Tile(state, n, z, seed) for state in given.states]
    return tiles


def chosen_again(rows: Sequence[Row], count: int) -> list[Tile]:
    """Return tiles to repeat with other seeds: evenly from all that have at least three."""
    known: dict[tuple[object, ...], set[int]] = {}
    for row in rows:
        if row["seed"] < OTHERS:
            known.setdefault(tuple(row[n] for n in KEY[:3]), set()).add(int(row["seed"]))
    able = sorted(key for key, seeds in known.items() if len(seeds) >= PILOTS)
    picked = [able[(2 * k + 1) * len(able) // (2 * count)] for k in range(min(count, len(able)))]
    return [
        Tile(str(state), int(n), float(z), OTHERS + seed)  # type: ignore[call-overload]
        for state, n, z in picked
        for seed in range(1, len(known[state, n, z]) + 1)
    ]


def contenders(tile: Tile, methods: Sequence[str], rows: Sequence[Row]) -> list[str]:
    """Return the methods that take part in a tile: at first all, then those that were near.

    The best explicit and the best implicit one always take part, as ``auto`` does.
    """
    like = [r for r in rows if (r["state"], r["stiffness"]) == (tile.state, tile.stiffness)]
    here = [r for r in like if r["cells"] == tile.cells and r["seed"] < OTHERS]
    fewer = max((r["cells"] for r in like if r["cells"] < tile.cells), default=None)
    enough = len({row["seed"] for row in here}) >= PILOTS
    known = here if enough else [r for r in like if r["cells"] == fewer]
    lead = leads([row for row in known if row["method"] in methods])
    if not lead:
        return list(methods)
    best = {min(of, key=of.__getitem__) for of in _by_kind(lead, known) if of}
    limit = NEAR if enough else FAR
    unseen = set(methods) - {row["method"] for row in known}
    return [
        name
        for name in methods
        if name == "auto" or name in best | unseen or lead.get(name, math.inf) <= limit
    ]


def leads(rows: Iterable[Row]) -> dict[str, float]:
    """Return method -> its cost over the best one's: median over seeds, least of both goals."""
    by: dict[tuple[object, ...], dict[str, float]] = {}
    for row in rows:
        if row["goal"] != DEFAULT and row["method"] not in NULL_METHODS:
            cost = row["cost"] if row["status"] == REACHED else math.inf
            by.setdefault((row["goal"], row["seed"]), {})[row["method"]] = cost
    ratios: dict[str, dict[object, list[float]]] = {}
    for (goal, _), costs in by.items():
        least = min(costs.values())
        for name, cost in costs.items():
            ratio = cost / least if math.isfinite(cost) else math.inf
            ratios.setdefault(name, {}).setdefault(goal, []).append(ratio)
    return {name: min(map(median, of.values())) for name, of in ratios.items()}


def _by_kind(lead: dict[str, float], rows: Sequence[Row]) -> list[dict[str, float]]:
    kind = {row["method"]: row["implicit"] for row in rows}
    return [
        {n: x for n, x in lead.items() if kind[n] == implicit and n != "auto" and x < math.inf}
        for implicit in (0, 1)
    ]


def loosest(tile: Tile, rows: Sequence[Row]) -> dict[str, float]:
    """Return where ladders of large tiles begin: a decade above what fewer cells needed."""
    if tile.cells < 10_000:
        return {}
    found: dict[str, list[float]] = {}
    for r in rows:
        same = (r["state"], r["stiffness"]) == (tile.state, tile.stiffness)
        if same and r["goal"] == max(GOALS) and r["status"] == REACHED:
            found.setdefault(r["method"], []).append(r["setting"])
    return {name: 10.0 * max(settings) for name, settings in found.items()}


def solve_tile(tile: Tile, given: argparse.Namespace, rows: Sequence[Row]) -> tuple[Row, list[Row]]:
    """Return the row of a tile, and those of the methods in it."""
    begin = cpu_time()
    step = solved(tile, given.cache)
    names = [*contenders(tile, given.methods, rows), *NULL_METHODS]
    methods = [find_method(n, step.problem.scene, step.problem.mean_radius) for n in names]
    turn = tile.seed + STATES.index(tile.state) + round(math.log10(tile.stiffness))
    found = race(step, methods, turn, loosest(tile, rows))
    return (
        {**columns(tile), **step.facts, **_judged(step), "took_s": cpu_time() - begin},
        [{**columns(tile), **row} for row in found],
    )


def _judged(step: Solved) -> Row:
    conditioning = {
        f"conditioning_{goal:g}": x for goal, x in zip(GOALS, step.conditioning, strict=True)
    }
    best = step.scale.residual / step.scale.rms
    return {"uncertainty": step.uncertainty, **conditioning, "best_dilation": best,
            "radius_um": step.problem.mean_radius}  # fmt: skip


def cpu_time() -> float:
    """Return the CPU time of this process and of those that it has started, s."""
    return sum(os.times()[:4])


def kept(folder: Path, name: str) -> list[Row]:
    """Return the rows of a table that earlier runs have written."""
    path = folder / f"{name}.csv"
    if not path.exists():
        return []
    with path.open(encoding="utf-8", newline="") as file:
        return [
            {n: t if n in WORDS else float(t) for n, t in texts.items()}
            for texts in csv.DictReader(file)
        ]


def keep(folder: Path, name: str, rows: Sequence[Row]) -> None:
    """Append rows to a table."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.csv"
    text = table_text([{n: _short(v) for n, v in row.items()} for row in rows])
    if path.exists():
        text = text.partition("\n")[2]
    with path.open("a", encoding="utf-8", newline="") as file:
        file.write(text)


def _short(value: object) -> object:
    return float(f"{value:.5g}") if isinstance(value, float) else value


def compute(given: argparse.Namespace) -> None:
    """Solve the tiles that are not solved, until the time is over."""
    known, rows = kept(given.results, "tiles"), kept(given.results, "tile-costs")
    # a run that was stopped between its two tables has no row of the tile
    done = {tuple(row[n] for n in KEY) for row in known}
    rows = [row for row in rows if tuple(row[n] for n in KEY) in done]
    tiles = chosen_again(rows, given.again) if given.again else grid(given)
    ahead = [tile for tile in tiles if tuple(columns(tile).values()) not in done]
    minutes = _minutes(ahead, known)
    print(f"{len(ahead)} of {len(tiles)} steps to solve, about {minutes:.0f} min of CPU")
    if not ahead:
        return
    warm_up(given)
    begin = cpu_time()
    for k, tile in enumerate(ahead):
        if cpu_time() - begin > 60.0 * given.budget_minutes:
            print(f"time is over: {len(ahead) - k} steps are left")
            return
        about, found = solve_tile(tile, given, rows)
        keep(given.results, "tile-costs", found)
        keep(given.results, "tiles", [about])
        rows += found
        best = min(found, key=lambda r: (r["goal"] != GOALS[0], r["status"] != REACHED, r["cost"]))
        print(
            f"{k + 1}/{len(ahead)} {tile.state}, {tile.cells:,} cells, λΔt = {tile.stiffness:.0e}, "
            f"seed {tile.seed}: {best['method']} {best['cost']:.3g} s; "
            f"{about['took_s']:.1f} s in all", flush=True,
        )  # fmt: skip
    print(f"{(cpu_time() - begin) / 60.0:.1f} min of CPU")


def renew(given: argparse.Namespace) -> None:
    """Repeat the solves of some methods: after a change of these, on the same steps.

    The best of the other methods takes part. A machine is faster at one time than at another, so
    new costs are those over its new one times its old one.
    """
    rows = kept(given.results, "tile-costs")
    took_part = {(*(r[n] for n in KEY), r["method"]) for r in rows}
    found: list[Row] = []
    for about in kept(given.results, "tiles"):
        tile = Tile(about["state"], int(about["cells"]), about["stiffness"], int(about["seed"]))
        key = tuple(about[n] for n in KEY)
        names = [name for name in given.renew if (*key, name) in took_part]
        if names and tile.cells in given.cells:
            step = solved(tile, given.cache)
            here = [r for r in rows if tuple(r[n] for n in KEY) == key]
            best = _best([r for r in here if r["method"] not in names])
            names.append(best["method"])
            methods = [find_method(n, step.problem.scene, step.problem.mean_radius) for n in names]
            again = race(step, methods, 0, loosest(tile, rows))
            slower = _best([r for r in again if r["method"] == best["method"]])["cost"]
            found += [
                {**columns(tile), **row, "cost": row["cost"] * best["cost"] / slower}
                for row in again if row["method"] in given.renew
            ]  # fmt: skip
    new = {(*(r[n] for n in KEY), r["method"]) for r in found}
    rows = [r for r in rows if (*(r[n] for n in KEY), r["method"]) not in new]
    (given.results / "tile-costs.csv").unlink()
    keep(given.results, "tile-costs", rows + found)


def _best(rows: Sequence[Row]) -> Row:
    """Return the cheapest row of the finest goal that is reached, null methods aside."""
    reached = [r for r in rows if r["status"] == REACHED and r["method"] not in NULL_METHODS]
    goals = [r for r in reached if r["goal"] != DEFAULT]
    return min(goals or reached, key=lambda r: (r["goal"], r["cost"]))


def _minutes(tiles: Sequence[Tile], known: Sequence[Row]) -> float:
    """Return about what tiles take, by those that were solved or else by their size."""
    took: dict[tuple[object, ...], list[float]] = {}
    for row in known:
        took.setdefault(tuple(row[n] for n in KEY[:3]), []).append(row["took_s"])
    return (
        sum(
            median(
                took.get((t.state, t.cells, t.stiffness), [0.5 + t.cells / 1e3 * t.stiffness**0.13])
            )
            for t in tiles
        )
        / 60.0
    )


def warm_up(given: argparse.Namespace) -> None:
    """Compile and load all that the methods need."""
    step = solved(Tile("fresh", 100, 1e3, 1), given.cache)
    for name in given.methods:
        method = find_method(name, step.problem.scene, step.problem.mean_radius)
        replay(step.problem, method.make(0.01 if method.control == "tolerance" else 60.0))


def show(given: argparse.Namespace) -> None:
    """Print the tables and draw the pictures of what is there."""
    tiles, rows = kept(given.results, "tiles"), kept(given.results, "tile-costs")
    if not tiles:
        raise SystemExit("nothing is computed yet")
    first = [[r for r in table if r["seed"] < OTHERS] for table in (tiles, rows)]
    pages = {f"tiles at {100 * goal:g} %": main_table(*first, goal) for goal in GOALS}
    pages |= {"states of the tiles": states_table(first[0]), "defaults": defaults_table(first[1])}
    if len(first[0]) < len(tiles):
        pages["tiles with other seeds"] = again_table(tiles, rows, OTHERS)
    for name, text in pages.items():
        print(f"\n{name}\n\n{text}")
    given.figures.mkdir(parents=True, exist_ok=True)
    for goal in GOALS:
        end = "" if goal == GOALS[0] else "-fine"
        picture = given.figures / f"tiles{end}.png"
        save_figure(draw(*first, goal), picture)
        best = {point.best for point in points(*first, goal)} - {""}
        record(picture, "python docs/programs/tiles.py", best)
    if given.page is not None:
        page = given.page.read_text(encoding="utf-8")
        for name, text in pages.items():
            if f"<!-- {name}:" in page:  # one goal is enough for a page
                page = replaced(page, name, text)
        given.page.write_text(page, encoding="utf-8")


def parser() -> argparse.ArgumentParser:
    """Return the options of the command."""
    made = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    made.add_argument("--states", nargs="+", choices=STATES, default=STATES)
    made.add_argument("--cells", type=int, nargs="+", default=tuple(SEEDS))
    made.add_argument("--stiffness", type=float, nargs="+", default=STIFFNESS, help="λΔt")
    made.add_argument("--seeds", type=int, help=f"number of seeds ({SEEDS})")
    made.add_argument("--all", action="store_true", help="all λΔt for any number of cells")
    made.add_argument("--quick", action="store_true", help="few tiles and seeds, in a folder apart")
    made.add_argument("--again", type=int, default=0, help="repeat so many tiles with other seeds")
    made.add_argument("--renew", nargs="+", default=[], help="solve again by these methods")
    made.add_argument("--methods", nargs="+", default=registered())
    made.add_argument("--budget-minutes", type=float, default=math.inf, help="of CPU time")
    made.add_argument("--tables", action="store_true", help="compute nothing")
    made.add_argument("--results", type=Path, default=DOCS / "chart-data")
    made.add_argument("--figures", type=Path, default=DOCS / "figures")
    made.add_argument("--page", type=Path, help="page whose tables are replaced")
    made.add_argument("--cache", type=Path, help="folder of recorded states and references")
    return made


def main() -> None:
    """Solve what is missing, then print the tables and draw the pictures."""
    given = parser().parse_args()
    if given.quick:
        given.cells, given.stiffness, given.seeds = (100, 1_000), (1e1, 1e3, 1e5), 1
        if given.results == DOCS / "chart-data":
            given.results = given.figures = Path("tiles-quick")
    if given.renew:
        warm_up(given)
        renew(given)
    elif not given.tables:
        compute(given)
    show(given)


if __name__ == "__main__":
    main()
