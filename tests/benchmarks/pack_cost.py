"""Gain of a pack of compiled kernels for a first command, and its effect on speed and bits.

Problem   the first command of a new installation, `multicell run spheroid` to 1,000 cells on an
          empty cache; an hour of 10,000 growing cells on one thread with warm kernels
Measured  wall time and CPU time of all processes, with and without the pack in turns; size of the
          wheel; whether the cells of all frames have the same bits
Separated the pack is built before, from a whole `spheroid`, and lies in an environment of its own;
          for the hour each kind of kernels runs once before it is measured
Cost      two minutes, and a minute a round
Command   python tests/benchmarks/pack_cost.py [--rounds 3] [--level x86-64-v3]
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import time
import venv
from pathlib import Path
from statistics import median
from zipfile import ZipFile

import h5py
import numpy as np
from compare_trees import AROUND, HOUR

from multicell.compiling.kernels import build_pack
from multicell.compiling.pack import PROCESSOR_LEVELS

FIRST = ["-m", "multicell", "run", "spheroid", "--no-report", "--quiet", "--overwrite"]
FIRST += ["--set", "duration=20 d", "--set", "stop_cells=1000"]
FIRST_TIMED = (
    "import json, os, subprocess, sys, time; begin = time.perf_counter()\n"
    "subprocess.run(sys.argv[1:], check=True, stdout=subprocess.DEVNULL)\n"
    "wall, used = time.perf_counter() - begin, os.times()\n"
    "print(json.dumps({'wall': wall, 'CPU': used.children_user + used.children_system}))"
)


def environment_with(wheel: Path, folder: Path) -> Path:
    """Return the Python of a new environment that has this one's packages and a wheel."""
    venv.create(folder, with_pip=False)
    schemes = {"base": str(folder), "platbase": str(folder)}
    site = Path(sysconfig.get_path("purelib", vars=schemes))
    here = [str(Path(__file__).parents[2]), *filter(None, sys.path)]
    (site / "here.pth").write_text("\n".join(here), encoding="utf-8")
    with ZipFile(wheel) as packed:
        packed.extractall(site)
    return Path(sysconfig.get_path("scripts", vars=schemes)) / Path(sys.executable).name


def same_bits(one: Path, other: Path) -> bool:
    """Return whether all arrays of two files of frames are equal."""
    arrays: list[dict[str, np.ndarray]] = [{}, {}]
    for path, found in zip((one, other), arrays, strict=True):
        with h5py.File(path) as file:
            file.visititems(
                lambda name, item, found=found: (
                    found.update({name: item[()]}) if isinstance(item, h5py.Dataset) else None
                )
            )
    position = [name for name in arrays[0] if name.endswith("position")]
    assert position  # the frames have cells
    return arrays[0].keys() == arrays[1].keys() and all(
        np.array_equal(arrays[0][name], arrays[1][name]) for name in position
    )


def measured(command: list[str], cache: Path, bare: bool) -> dict[str, float]:
    """Return the JSON that a command prints of itself, with or without the pack."""
    variables = {**os.environ, "NUMBA_CACHE_DIR": str(cache)}
    variables |= {"MULTICELL_NO_PACK": "1"} if bare else {}
    done = subprocess.run(command, env=variables, check=True, capture_output=True, text=True)
    return dict(json.loads(done.stdout.splitlines()[-1]))


def main() -> None:
    """Build a pack, measure in turns and print medians with the shortest and the longest."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--level", choices=PROCESSOR_LEVELS, default="x86-64-v3")
    given = parser.parse_args()
    found: dict[tuple[str, bool], list[dict[str, float]]] = {}
    with tempfile.TemporaryDirectory() as work:
        folder, begin = Path(work), time.perf_counter()
        wheel = build_pack(folder / "wheels", ["spheroid"], given.level)
        python = str(environment_with(wheel, folder / "venv"))
        print(f"{wheel.name}: {wheel.stat().st_size / 1e6:.2f} MB, built in ", end="")
        print(f"{time.perf_counter() - begin:.0f} s")
        for turn in range(given.rounds + 1):
            for bare in (False, True):
                hour = [python, "-c", AROUND + HOUR % (10_000, 1)]
                value = measured(hour, folder / f"hour-{bare}", bare)
                if turn:
                    found.setdefault(("hour of 10,000 cells", bare), []).append(value)
                    shutil.rmtree(folder / "cache", ignore_errors=True)
                    output = ["-o", str(folder / f"out-{bare}")]
                    command = [python, "-c", FIRST_TIMED, python, *FIRST, *output]
                    value = measured(command, folder / "cache", bare)
                    found.setdefault(("first command", bare), []).append(value)
        equal = same_bits(*(folder / f"out-{bare}" / "frames.h5" for bare in (False, True)))
    print(f"same bits: {equal}\n| what | kernels | wall | CPU |\n| --- | --- | --- | --- |")
    for (what, bare), values in found.items():
        cells = [what, "compiled here" if bare else "of the pack"]
        for key in ("wall", "CPU"):
            times = [value[key] for value in values]
            cells.append(f"{median(times):.4g} s ({min(times):.4g} to {max(times):.4g})")
        print(f"| {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
