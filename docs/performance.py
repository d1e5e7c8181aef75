"""Cost per cell from a hundred to a million cells, threads, memory, and where the time goes.

Problem   asynchronous cells of the scene `spheroid` in rich medium: all grow, divide and eat
          oxygen, a steady field on cubes. One hour after one coupling step to settle in.
Measured  wall time of that hour in a process of its own, with one thread and with all; peak memory
          above what the process held before; the share of each part of a step; contacts a cell.
Separated compilation and start: each size is run once before it is timed, by the first step
Cost      about five minutes on 2 cores, with a million cells; the tables of docs/performance.md
Command   python docs/performance.py [--cells 100 1000 ...] [--threads 1 2]
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from marked import replaced

HERE = Path(__file__).parent
CELLS = (100, 1_000, 10_000, 100_000, 1_000_000)
HOUR = 3600.0
OXYGEN = {"boundary": 5.0, "uptake": 40.0, "half_saturation": 0.005,
          "growth_half_saturation": 0.01, "quiescence": 0.015, "necrosis": 0.008}  # fmt: skip
RICH = {f"nutrients.oxygen.{key}": value / 8.0 for key, value in OXYGEN.items()}
"""A hundred times the oxygen of the scene for its uptake and thresholds. At most 1 mM dissolves,
and with all of it eight times smaller the cells find the same parts."""


def peak() -> float:
    """Return the largest memory that this process has held, in kB."""
    return float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)


def measured(cells: int, threads: int) -> dict[str, Any]:
    """Run an hour of one size; return what it took."""
    import multicell as mc
    from multicell.simulation import Simulation

    scene = mc.load_scene("spheroid").with_changes(
        {
            "initial.count": cells,
            "initial.stage": "asynchronous",
            **RICH,
            "duration": "1 d",
        }
    )
    least = peak()
    simulation = Simulation(scene, threads=threads)
    simulation.step()
    parts, begin = dict(simulation.wall), simulation.time
    clock, used = time.perf_counter(), time.process_time()
    while simulation.time < begin + HOUR * (1.0 - 1e-9):
        simulation.step()
    took = time.perf_counter() - clock
    mechanics = simulation.prepared()
    touching = len(mechanics.contacts(simulation.time, simulation.cells.position))
    return {
        "cells": len(simulation.cells),
        "wall": took,
        "CPU": time.process_time() - used,
        "memory": (peak() - least) / len(simulation.cells),
        "parts": {name: took - parts[name] for name, took in simulation.wall.items()},
        "contacts": 2.0 * touching / len(simulation.cells),
    }


def apart(cells: int, threads: int) -> dict[str, Any]:
    """Measure in a process of its own."""
    command = [sys.executable, __file__, "--cells", str(cells), "--threads", str(threads), "--one"]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return dict(json.loads(done.stdout.splitlines()[-1]))


def table(rows: list[list[str]]) -> str:
    """Return a Markdown table; the first row is its head."""
    lines = [f"| {' | '.join(row)} |" for row in rows]
    return "\n".join([lines[0], "| " + " | ".join(["---"] * len(rows[0])) + " |", *lines[1:]])


def costs(found: dict[tuple[int, int], dict[str, Any]]) -> str:
    """Return the table of costs: a row for each size and number of threads."""
    head = ["cells", "threads", "wall time an hour", "a cell", "kB a cell"]
    names = ["mechanics", "nutrient", "events", "biology"]
    rows = [[*head, *names]]
    for (cells, threads), run in found.items():
        whole = sum(run["parts"].values())
        rows.append(
            [
                f"{cells:,}", f"{threads}", f"{run['wall']:.3g} s",
                f"{1e6 * run['wall'] / run['cells']:.3g} µs",
                # of fewer it is the libraries'
                f"{run['memory']:.2g}" if cells >= 10_000 else "",
                *(f"{100.0 * run['parts'][name] / whole:.0f} %" for name in names),
            ]
        )  # fmt: skip
    return table(rows)


def serial_part(one: float, many: float, threads: int) -> float:
    """Return the part of the time that threads do not share (Amdahl), from two wall times."""
    return (many / one - 1.0 / threads) / (1.0 - 1.0 / threads)


def scaling(found: dict[tuple[int, int], dict[str, Any]], threads: list[int]) -> str:
    """Return the table of speed-ups: measured with all threads, and by Amdahl's law with more."""
    most = max(threads)
    rows = [["cells", f"{most} threads, measured", "serial part", "8", "16", "64", "limit"]]
    for cells in sorted({cells for cells, _ in found}):
        # threads share nothing below 14,337 cells
        if (cells, 1) not in found or most == 1 or cells < 20_000:
            continue
        one, many = found[cells, 1]["wall"], found[cells, most]["wall"]
        serial = serial_part(one, many, most)
        ahead = [1.0 / (serial + (1.0 - serial) / cores) for cores in (8, 16, 64)]
        limit = 1.0 / serial if serial > 0.0 else float("inf")
        rows.append(
            [f"{cells:,}", f"{one / many:.2f}", f"{100.0 * serial:.0f} %"]
            + [f"{value:.1f}" for value in (*ahead, limit)]
        )
    return table(rows)


def main() -> None:
    """Measure and write the tables into the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cells", type=int, nargs="+", default=list(CELLS))
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.one:
        print(json.dumps(measured(given.cells[0], given.threads[0])))
        return
    found = {}
    for cells in given.cells:
        for threads in given.threads:
            found[cells, threads] = run = apart(cells, threads)
            print(cells, threads, run, flush=True)
    page = HERE / "performance.md"
    text = replaced(page.read_text(encoding="utf-8"), "costs", costs(found))
    text = replaced(text, "scaling", scaling(found, given.threads))
    page.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
