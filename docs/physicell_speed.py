"""An hour of a ball of growing cells in PhysiCell, built from its sources, and here.

Problem   a ball of cells that grow, divide and take up oxygen from a field with 38 mmHg at its
          faces, in the template project of PhysiCell 1.14.2 with its default steps (0.01, 0.1 and
          6 min) and voxels of 20 um, without output; here scene `spheroid` in rich medium
Measured  wall time of two runs of PhysiCell of different length, whose difference leaves start-up
          out, scaled to an hour; here the hour of docs/performance.py
Separated compilation in both, and reading of the settings
Cost      building 2 minutes; 10,000 cells 1 minute, 100,000 some 10; needs make and g++
Command   python docs/physicell_speed.py [ARCHIVE] [--cells 10000 100000] [--threads 2]

ARCHIVE is a folder, a .zip or .tar.gz with the sources, or where to download one; by default that
of the release. The table of docs/performance.md is made anew.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import tempfile
import time
import urllib.request
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
from marked import replaced
from performance import HERE, apart, table

RELEASE = "https://github.com/MathCancer/PhysiCell/archive/refs/tags/1.14.2.zip"
RADIUS = 8.41
"""Radius of a cell of the template's 2494 um^3, um."""
VOXEL = 20.0


def unpacked(archive: str, folder: Path) -> Path:
    """Return a copy of the sources below a folder."""
    if Path(archive).is_dir():
        return Path(shutil.copytree(archive, folder / "sources"))
    if archive.startswith("https://"):
        archive, _ = urllib.request.urlretrieve(archive, folder / Path(archive).name)
    shutil.unpack_archive(archive, folder)
    (makefile,) = folder.glob("*/Makefile")
    return makefile.parent


def ball(cells: int) -> np.ndarray:
    """Return the places of a dense ball of cells, (n, 3) um: the closest ones of a packing."""
    spacing = 0.95 * 2.0 * RADIUS
    side = 2 * round(cells ** (1 / 3)) + 2
    i, j, k = np.indices((side, side, side)) - side // 2
    places = spacing * np.stack(
        [i + 0.5 * (j % 2) + 0.5 * (k % 2), np.sqrt(0.75) * j, np.sqrt(2.0 / 3.0) * k], axis=-1
    ).reshape(-1, 3)
    return places[np.argsort(np.linalg.norm(places, axis=1), kind="stable")[:cells]]


def prepare(sources: Path, cells: int, minutes: float, threads: int) -> None:
    """Write settings and cells of one run into the project."""
    settings = sources / "config" / "PhysiCell_settings.xml"
    root = ET.parse(sources / "sample_projects/template/config/PhysiCell_settings.xml")
    places = ball(cells)
    half = VOXEL * np.ceil((np.abs(places).max() + 100.0) / VOXEL)
    entries = {
        "domain/use_2D": "false", "overall/max_time": f"{minutes:g}",
        "parallel/omp_num_threads": str(threads), "save/full_data/enable": "false",
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
    root.write(settings)
    rows = np.column_stack([places, np.zeros(cells)])
    np.savetxt(sources / "config" / "cells.csv", rows, delimiter=",", fmt=["%.6f"] * 3 + ["%d"])


def timed(sources: Path, cells: int, minutes: float, threads: int) -> float:
    """Return the wall time of a run of PhysiCell, s."""
    prepare(sources, cells, minutes, threads)
    begin = time.perf_counter()
    done = subprocess.run(
        [sources / "project"], cwd=sources, check=True, capture_output=True, text=True,
        env={**os.environ, "OMP_NUM_THREADS": str(threads)},
    )  # fmt: skip
    took = time.perf_counter() - begin
    if f"total agents: {cells}\n" not in done.stdout:
        raise ValueError(f"PhysiCell did not begin with {cells} cells")
    return took


def main() -> None:
    """Build, measure, and write the table into the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("archive", nargs="?", default=RELEASE)
    parser.add_argument("--cells", type=int, nargs="+", default=[10_000, 100_000])
    parser.add_argument(
        "--minutes",
        type=float,
        nargs=2,
        default=[2.0, 3.0],
        help="length of the shorter run, and what the longer one has beyond",
    )
    parser.add_argument("--threads", type=int, default=2)
    given = parser.parse_args()
    first, more = given.minutes
    rows = [["cells", "PhysiCell, a simulated hour", "multicell, a simulated hour", "ratio"]]
    with tempfile.TemporaryDirectory() as folder:
        sources = unpacked(given.archive, Path(folder))
        for command in (["make", "template"], ["make", "-j2"]):
            subprocess.run(command, cwd=sources, check=True, capture_output=True)
        version = (sources / "VERSION.txt").read_text().strip()
        rows[0][1] = f"PhysiCell {version}, a simulated hour"
        for cells in given.cells:
            short, long = (timed(sources, cells, m, given.threads) for m in (first, first + more))
            theirs = (long - short) * 60.0 / more
            ours = apart(cells, given.threads)["wall"]
            rows.append([f"{cells:,}", f"{theirs:,.0f} s", f"{ours:.3g} s", f"{theirs / ours:.0f}"])
            print(rows[-1], f"short {short:.3g} s, long {long:.3g} s", flush=True)
    page = HERE / "performance.md"
    page.write_text(
        replaced(page.read_text(encoding="utf-8"), "PhysiCell", table(rows)), encoding="utf-8"
    )


if __name__ == "__main__":
    main()
