"""An hour of a ball of growing cells in PhysiCell, for performance.py.

Problem   a ball of cells that grow, divide and take up oxygen from a field with 38 mmHg at its
          faces, in the template project of PhysiCell 1.14.2 with its default steps (0.01, 0.1 and
          6 min) and voxels of 20 um, without output
Measured  what the program itself reports at simulated times 6 minutes apart, one step of its
          phenotypes: the time between two of them, after a warm-up, scaled to an hour
Beside    with --pyphysicell the same settings in pyphysicell, PhysiCell's model as a package of
          Python: the window's time by the clock
Separated start, reading of the settings, the two snapshots and the pictures that the template
          writes before its loop and after it
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Final

import numpy as np

RADIUS = 8.41
"""Radius of a cell of the template's 2494 um^3, um."""
VOXEL = 20.0
PHENOTYPES = 6.0
"""Step of phenotypes, min: a window of whole steps has its share of them."""
TEMPLATE = Path("sample_projects") / "template" / "config" / "PhysiCell_settings.xml"
_TOTAL = re.compile(
    r"total wall time: *(\d+) days, (\d+) hours, (\d+) minutes, and ([\d.e+-]+) seconds"
)


def build(source: Path, folder: Path) -> Path:
    """Return a folder with the program, its version and a place for settings, for runs to change.

    ``source`` is a folder of PhysiCell, built as template project or not, or an archive of one.
    """
    if not source.is_dir():
        shutil.unpack_archive(source, folder / "sources")
        (makefile,) = (folder / "sources").glob("*/Makefile")
        source = makefile.parent
    elif not (source / "project").exists():
        source = Path(shutil.copytree(source, folder / "sources"))
    if not (source / "project").exists():
        for command in (["make", "template"], ["make", "-j2"]):
            subprocess.run(command, cwd=source, check=True, capture_output=True)
    place = folder / "physicell"
    for name in ("project", "VERSION.txt", str(TEMPLATE)):
        (place / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(source / name, place / name)
    for name in ("config", "output"):
        (place / name).mkdir()
    return place


def version(place: Path) -> str:
    """Return the program's name and version."""
    return f"PhysiCell {(place / 'VERSION.txt').read_text().strip()}"


def ball(cells: int) -> np.ndarray:
    """Return the places of a dense ball of cells, (n, 3) um: the closest ones of a packing."""
    spacing = 0.95 * 2.0 * RADIUS
    side = 2 * round(cells ** (1 / 3)) + 2
    i, j, k = np.indices((side, side, side)) - side // 2
    places = spacing * np.stack(
        [i + 0.5 * (j % 2) + 0.5 * (k % 2), np.sqrt(0.75) * j, np.sqrt(2.0 / 3.0) * k], axis=-1
    ).reshape(-1, 3)
    return places[np.argsort(np.linalg.norm(places, axis=1), kind="stable")[:cells]]


def prepare(place: Path, cells: int, minutes: float, threads: int) -> None:
    """Write settings and cells of one run of so many simulated minutes."""
    root = ET.parse(place / TEMPLATE)
    places = ball(cells)
    half = VOXEL * np.ceil((np.abs(places).max() + 100.0) / VOXEL)
    entries = {
        "domain/use_2D": "false", "overall/max_time": f"{minutes:g}",
        "parallel/omp_num_threads": str(threads), "save/full_data/enable": "false",
        # reports of the time come at this interval, whether data are saved or not
        "save/full_data/interval": f"{PHENOTYPES:g}",
        "save/SVG/enable": "false", "user_parameters/number_of_cells": "0",
    }  # fmt: skip
    for axis in "xyz":
        entries |= {f"domain/{axis}_min": f"{-half:g}", f"domain/{axis}_max": f"{half:g}"}
    substrate = "microenvironment_setup/variable"
    entries[f"{substrate}/physical_parameter_set/decay_rate"] = "0.1"
    entries[f"{substrate}/initial_condition"] = "38"
    entries[f"{substrate}/Dirichlet_boundary_condition"] = "38"
    secretion = "cell_definitions/cell_definition/phenotype/secretion/substrate"
    entries[f"{secretion}/uptake_rate"] = "10"
    for path, value in entries.items():
        found = root.find(path)
        if found is None:
            raise ValueError(f"the template's settings have no {path}")
        found.text = value
    switched = [f"{substrate}/Dirichlet_boundary_condition", "initial_conditions/cell_positions"]
    for path in switched:
        root.find(path).set("enabled", "true")  # type: ignore[union-attr]
    for face in root.findall(f"{substrate}/Dirichlet_options/boundary_value"):
        face.set("enabled", "true")
        face.text = "38"
    root.write(place / "config" / "PhysiCell_settings.xml")
    rows = np.column_stack([places, np.zeros(cells)])
    np.savetxt(place / "config" / "cells.csv", rows, delimiter=",", fmt=["%.6f"] * 3 + ["%d"])


def hour(place: Path, cells: int, minutes: tuple[float, float], threads: int) -> float:
    """Return the wall time of a simulated hour, s: that of a window after a warm-up, scaled.

    Raises
    ------
    ValueError
        If warm-up or window are not whole steps of phenotypes, or the program did something else.
    """
    warm, window = (round(m / PHENOTYPES) for m in minutes)
    if [warm * PHENOTYPES, window * PHENOTYPES] != list(minutes) or window < 1:
        raise ValueError(f"warm-up and window must be multiples of {PHENOTYPES:g} min")
    prepare(place, cells, (warm + window) * PHENOTYPES, threads)
    done = subprocess.run(
        [place / "project"], cwd=place, check=True, capture_output=True, text=True,
        env={**os.environ, "OMP_NUM_THREADS": str(threads)},
    )  # fmt: skip
    if f"total agents: {cells}\n" not in done.stdout:
        raise ValueError(f"PhysiCell did not begin with {cells} cells")
    totals = [
        ((int(days) * 24 + int(hours)) * 60 + int(some)) * 60 + float(seconds)
        for days, hours, some, seconds in _TOTAL.findall(done.stdout)
    ]
    if len(totals) != warm + window + 1:
        raise ValueError(f"PhysiCell reported {len(totals)} times, not {warm + window + 1}")
    return (totals[-1] - totals[warm]) * 60.0 / (window * PHENOTYPES)


_IN_PYTHON: Final = """
import sys, time
import pyphysicell as pc
cells, warm, window = (float(word) for word in sys.argv[1:])
simulation = pc.Simulation(pc.load("."), seed=0)
assert simulation.cells.n == cells, f"pyphysicell began with {simulation.cells.n} cells"
simulation.run(until=warm)
begin = time.perf_counter()
simulation.run(until=warm + window)
print(time.perf_counter() - begin)
"""


def port_version(python: Path) -> str:
    """Return the name and version of the pyphysicell that an interpreter has."""
    asked = "import importlib.metadata as m; print(m.version('pyphysicell'))"
    done = subprocess.run([python, "-c", asked], check=True, capture_output=True, text=True)
    return f"pyphysicell {done.stdout.strip()}"


def port_hour(
    python: Path, place: Path, cells: int, minutes: tuple[float, float], threads: int
) -> float:
    """Return the wall time of a simulated hour in pyphysicell, s, of the window of :func:`hour`."""
    prepare(place, cells, sum(minutes), threads)
    done = subprocess.run(
        [python, "-c", _IN_PYTHON, str(cells), *(str(m) for m in minutes)], cwd=place, check=True,
        capture_output=True, text=True, env={**os.environ, "OMP_NUM_THREADS": str(threads)},
    )  # fmt: skip
    return float(done.stdout.splitlines()[-1]) * 60.0 / minutes[1]
