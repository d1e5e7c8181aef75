"""Cost per cell from a hundred to a million cells, threads, memory, and PhysiCell beside it.

Problem   asynchronous cells of the scene `spheroid` in rich medium: all grow, divide and eat
          oxygen, a steady field on cubes. One hour after one coupling step to settle in. With
          --physicell the same number of cells there (physicell_speed.py), with --pyphysicell in
          that package as well, and single commands as a user gives them
Measured  wall time of that hour in a process of its own, with one thread and with all; peak memory
          above what the process held before; the share of each part of a step; of the CPU time
          the part that one thread has spent alone, which other programs hardly change. Medians of
          rounds: each round measures everything once, every other round in reverse, so that a
          machine that becomes slower does so for all
Separated compilation and start: each size is run once before it is timed, by the first step.
          What other programs use of the machine in the second before is in the table
Cost      a round takes five minutes on 2 cores, with a million cells; PhysiCell's 100,000 cells
          three to five more with 12 simulated minutes
Command   python docs/programs/performance.py --physicell FOLDER [--rounds 5] [--cells 100 1000 ...]
          [--threads 1 2] [--beside 10000 100000] [--parts hour beside runs] [--minutes 6 6]
          [--pyphysicell PYTHON]
          python docs/programs/performance.py --serial --cells 100000   prints the serial part
          python docs/programs/performance.py --tables     only makes the page from the table

FOLDER is a built template project of PhysiCell, its sources, or an archive of them; PYTHON an
interpreter that has pyphysicell. The rows of
docs/chart-data/speed.csv are replaced by what is measured, and docs/performance.md is made from it;
other pages quote it (speed_tables.py).
"""

from __future__ import annotations

import argparse
import contextlib
import cProfile
import datetime
import json
import os
import pstats
import re
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
import speed_tables
from physicell_speed import build, hour, port_hour, port_version, version

DOCS = Path(__file__).parents[1]
CELLS = (100, 1_000, 10_000, 100_000, 1_000_000)
BESIDE = (10_000, 100_000)
HOUR = 3600.0
Job = tuple[dict[str, Any], Callable[[], dict[str, Any]]]
"""What a row of the table says that it is, and what measures it."""
OXYGEN = {"boundary": 5.0, "uptake": 40.0, "half_saturation": 0.005,
          "growth_half_saturation": 0.01, "quiescence": 0.015, "necrosis": 0.008}  # fmt: skip
RICH = {f"nutrients.oxygen.{key}": value / 8.0 for key, value in OXYGEN.items()}
"""A hundred times the oxygen of the scene for its uptake and thresholds. At most 1 mM dissolves,
and with all of it eight times smaller the cells find the same parts."""


def peak() -> float:
    """Return the largest memory that this process has held, in kB."""
    return float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)


def time_alone(threads: int) -> float:
    """Return the CPU seconds of this thread that each of the others has not had.

    What threads share takes as much of each: the rest is serial.
    """
    own = time.thread_time()
    return own - (time.process_time() - own) / (threads - 1) if threads > 1 else own


def measure_hour(
    cells: int, threads: int, profile: cProfile.Profile | None = None
) -> dict[str, Any]:
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
    alone, spent, clock = time_alone(threads), time.process_time(), time.perf_counter()
    with profile or contextlib.nullcontext():
        while simulation.time < begin + HOUR * (1.0 - 1e-9):
            simulation.step()
    took = time.perf_counter() - clock
    alone, spent = time_alone(threads) - alone, time.process_time() - spent
    used = {name: took - parts[name] for name, took in simulation.wall.items()}
    return {
        "seconds": took,
        "us_per_cell": 1e6 * took / len(simulation.cells),
        "kB_per_cell": (peak() - least) / len(simulation.cells),
        **{name: used[name] / sum(used.values()) for name in speed_tables.PARTS},
        "serial": alone / spent,
        "simulated_min": HOUR / 60.0,
    }


def print_serial(cells: int, threads: int) -> None:
    """Print which functions one thread does alone, by its CPU time there in s."""
    profile = cProfile.Profile(partial(time_alone, threads))
    print(f"serial part: {measure_hour(cells, threads)['serial']:.3f}")
    measure_hour(cells, threads, profile)
    pstats.Stats(profile).sort_stats("tottime").print_stats(25)


def apart(cells: int, threads: int) -> dict[str, Any]:
    """Measure in a process of its own."""
    command = [sys.executable, __file__, "--cells", str(cells), "--threads", str(threads), "--one"]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return dict(json.loads(done.stdout.splitlines()[-1]))


def measure_other(
    how: Callable[..., float], cells: int, minutes: tuple[float, float], threads: int
) -> dict[str, Any]:
    """Measure another program, by a function that returns the seconds of a simulated hour."""
    return {"seconds": how(cells, minutes, threads), "simulated_min": minutes[1]}


def time_command(words: list[str], fresh: bool = False) -> dict[str, Any]:
    """Time a command of multicell, if asked with no kernel compiled before."""
    with tempfile.TemporaryDirectory() as folder:
        place = {"NUMBA_CACHE_DIR": folder} if fresh else {}
        line = [sys.executable, "-m", "multicell", *words, "-o", f"{folder}/out"]
        begin = time.perf_counter()
        subprocess.run(line, check=True, capture_output=True, env={**os.environ, **place})
        return {"seconds": time.perf_counter() - begin}


def load_of_others() -> float:
    """Return the use of all processors by other programs, from 0 to 1, in a second of rest."""

    def ticks() -> tuple[int, int]:
        times = [int(t) for t in Path("/proc/stat").read_text().splitlines()[0].split()[1:9]]
        return sum(times), times[3] + times[4]  # all, and idle or waiting for a disk

    before = ticks()
    time.sleep(1.0)
    total, idle = (now - then for now, then in zip(ticks(), before, strict=True))
    return 1.0 - idle / total


def machine() -> str:
    """Return the name of the processor."""
    found = re.search(r"model name\s*: (.*)", Path("/proc/cpuinfo").read_text())
    return f"{os.cpu_count()} cores of {found[1] if found else 'an unknown processor'}"


def jobs(given: argparse.Namespace, place: Path | None) -> list[Job]:
    """Return all that a round measures."""
    found: list[Job] = []

    def add(what: str, program: str, cells: int, threads: int, how: Callable[[], Any]) -> None:
        found.append(({"what": what, "program": program, "cells": cells, "threads": threads}, how))

    if "hour" in given.parts:
        for cells in given.cells:
            for threads in given.threads:
                add("hour", "multicell", cells, threads, partial(apart, cells, threads))
    if "beside" in given.parts and place is not None:
        most, minutes = max(given.threads), tuple(given.minutes)
        others = [(version(place), partial(hour, place))]
        if given.pyphysicell is not None:
            python = given.pyphysicell.absolute()
            others.append((port_version(python), partial(port_hour, python, place)))
        for cells in given.beside:
            for program, how in others:
                theirs = partial(measure_other, how, cells, minutes, most)
                add("beside", program, cells, most, theirs)
            add("beside", "multicell", cells, most, partial(apart, cells, most))
    if "runs" in given.parts:
        whole = ["run", "spheroid", "--quiet"]
        one = [*whole, "--no-report", "--threads", "1"]
        add("spheroid", "multicell", 1, 1, partial(time_command, one))
        short = partial(time_command, [*one, "--set", "duration=10 min"])
        add("first step", "multicell", 1, 1, short)
        most = max(given.threads)
        add("first run", "multicell", 1, most, partial(time_command, whole, fresh=True))
    return found


def take_turns(
    found: list[Job], rounds: int, stamp: dict[str, Any], told: Callable[[dict[str, Any]], None]
) -> pd.DataFrame:
    """Measure everything once in each round, every other round in reverse."""
    rows = []
    for count in range(1, rounds + 1):
        for what, how in found if count % 2 else reversed(found):
            rows.append({**stamp, **what, "round": count, "others": load_of_others(), **how()})
            told(rows[-1])
    return pd.DataFrame(rows)


def main() -> None:
    """Measure, put it into the table, and write the page from it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--cells", type=int, nargs="+", default=list(CELLS))
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--parts", nargs="+", default=["hour", "beside", "runs"])
    parser.add_argument("--physicell", type=Path, help="a folder of PhysiCell, or an archive")
    parser.add_argument("--pyphysicell", type=Path, help="an interpreter that has pyphysicell")
    parser.add_argument("--beside", type=int, nargs="+", default=list(BESIDE))
    parser.add_argument(
        "--minutes", type=float, nargs=2, default=[6.0, 6.0], help="PhysiCell's warm-up and window"
    )
    parser.add_argument("--machine", default="", help="name of the machine in the table")
    parser.add_argument("--table", type=Path, help="write there instead, and no page")
    parser.add_argument("--tables", action="store_true", help="measure nothing")
    parser.add_argument("--serial", action="store_true", help="print the serial part of an hour")
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.one:
        print(json.dumps(measure_hour(given.cells[0], given.threads[0])))
        return
    if given.serial:
        print_serial(given.cells[0], max(given.threads))
        return
    if not given.tables:
        stamp = {
            "machine": given.machine or machine(),
            "date": datetime.date.today().isoformat(),
            "note": "",
        }
        with tempfile.TemporaryDirectory() as folder:
            place = None if given.physicell is None else build(given.physicell, Path(folder))
            found = take_turns(
                jobs(given, place), given.rounds, stamp, lambda row: print(row, flush=True)
            )
        if given.table is not None:
            found.to_csv(given.table, index=False)
            print(speed_tables.medians(found.reindex(columns=speed_tables.read().columns)))
            return
        speed_tables.write(found.reindex(columns=speed_tables.read().columns))
    speed_tables.renew()


if __name__ == "__main__":
    main()
