"""Threads beside the diagram of implicit and explicit methods, and whether the winner changes.

Of each tile the best explicit and the best implicit method of the diagram, at the tolerances by
which they reached the goal, solve the same step on one and on more threads, in turns. A tile with
more cells than the diagram has takes the methods and tolerances of the largest one with its state
and λΔt. Ends are the same bits on any number of threads.

Wall time is measured, and the CPU time that the first thread needs for all that threads do not
share and its part of the rest. On a busy machine wall times mean nothing; those of the first thread
do, since threads that wait sleep.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from statistics import median

from tile_problems import GOALS, Tile, recorded
from tile_race import REACHED, Row
from tile_tables import MIXED, duration, markdown, power

from multicell.comparison.ladders import find_method
from multicell.comparison.null_methods import NULL_METHODS
from multicell.comparison.replay import ReplayProblem, replay
from multicell.compiling.threads import thread_count

ROUNDS = 3
KINDS = ("explicit", "implicit")


def chosen(rows: Sequence[Row], tile: Tile) -> list[tuple[str, float]]:
    """Return the best explicit and the best implicit method for the finest goal, and tolerances.

    Of the largest tile up to this one, over its seeds: least median cost, middle tolerance in µm.
    """
    like = [
        r
        for r in rows
        if (r["state"], r["stiffness"]) == (tile.state, tile.stiffness)
        and r["cells"] <= tile.cells
        and (r["goal"], r["status"]) == (min(GOALS), REACHED)
        and r["method"] not in (*MIXED, *NULL_METHODS)
    ]
    found = []
    for implicit in range(len(KINDS)):
        kind = [r for r in like if r["implicit"] == implicit]
        most = max((r["cells"] for r in kind), default=0.0)
        by: dict[str, list[Row]] = {}
        for row in kind:
            if row["cells"] == most:
                by.setdefault(row["method"], []).append(row)
        if not by:
            where = f"{tile.state} tissue at λΔt = {tile.stiffness:g}"
            raise SystemExit(f"no {KINDS[implicit]} method is known for {where}: tiles.py finds it")
        name = min(by, key=lambda n: (-len(by[n]), median(r["cost"] for r in by[n])))
        found.append((name, sorted(r["setting"] for r in by[name])[len(by[name]) // 2]))
    return found


def timed(problem: ReplayProblem, name: str, setting: float, threads: int) -> tuple[Row, bytes]:
    """Solve a step; return its times in s, and its end."""
    thread_count(threads)
    shared = replace(problem, template=replace(problem.template, threads=threads))
    method = find_method(name, problem.scene, problem.mean_radius)
    integrator = method.make(setting / problem.mean_radius)
    # one within the other: the time of a thread is never more than that of all
    wall, spent, first = time.perf_counter(), time.process_time(), time.thread_time()
    found = replay(shared, integrator)
    first, spent = time.thread_time() - first, time.process_time() - spent
    times = {"wall": time.perf_counter() - wall, "first_thread": first, "cpu": spent}
    if not found.done:
        raise SystemExit(f"{name} at {setting:g} um failed: {found.problem}")
    return times, found.positions[0].tobytes()


def race_threads(
    tile: Tile, rows: Sequence[Row], threads: Sequence[int], cache: Path | None
) -> list[Row]:
    """Return a row for each kind and number of threads: medians of solves in turns."""
    problem, facts = recorded(tile, cache)
    both, ends = chosen(rows, tile), {}
    times: dict[tuple[int, int], list[Row]] = {}
    # the first turn may compile: medians do not see it
    for turn in range(ROUNDS):
        for count in threads if turn % 2 else threads[::-1]:
            for implicit, (name, setting) in enumerate(both):
                found, end = timed(problem, name, setting, count)
                if ends.setdefault(implicit, end) != end:
                    raise SystemExit(f"{name} ends elsewhere on {count} threads")
                times.setdefault((implicit, count), []).append(found)
    rows_found: list[Row] = []
    for (implicit, count), of in sorted(times.items()):
        name, setting = both[implicit]
        about: Row = {**vars(tile), "n": facts["n"], "implicit": implicit, "method": name}
        about |= {"setting": setting, "threads": count}
        rows_found.append(about | {key: median(t[key] for t in of) for key in of[0]})
    return rows_found


def threads_table(rows: Sequence[Row]) -> str:
    """Return a line for each tile: times of both kinds on each number of threads, and the ratio."""
    counts = sorted({int(row["threads"]) for row in rows})
    tiles: dict[tuple[object, ...], dict[tuple[int, int], Row]] = {}
    for row in rows:
        key = (row["cells"], row["state"], row["stiffness"])
        tiles.setdefault(key, {})[int(row["implicit"]), int(row["threads"])] = row
    lines = []
    for (cells, state, z), of in sorted(tiles.items()):
        line = [f"{int(cells):,}", str(state), power(float(z))]  # type: ignore[call-overload,arg-type]
        for implicit in range(len(KINDS)):
            first = of[implicit, counts[0]]
            gains = (f"{gain(first, of[implicit, k]):.2f}" for k in counts[1:])
            line.append(f"`{first['method']}` {duration(first['cpu'])}; {', '.join(gains)}")
        ratios = [of[0, k]["first_thread"] / of[1, k]["first_thread"] for k in counts]
        line.append(", ".join(f"{ratio:.2g}" for ratio in ratios))
        line.append("no" if len({ratio < 1.0 for ratio in ratios}) == 1 else "yes")
        lines.append(line)
    more = ", ".join(map(str, counts[1:]))
    heads = [f"{kind}: CPU on one thread; gain on {more}" for kind in KINDS]
    ratio = f"explicit / implicit on {', '.join(map(str, counts))}"
    return markdown(["cells", "state", "λΔt", *heads, ratio, "another winner"], lines)


def gain(one: Row, more: Row) -> float:
    """Return how much less the first thread has to do."""
    return float(one["first_thread"] / more["first_thread"])
