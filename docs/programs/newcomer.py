"""Waiting times of a newcomer: from a checkout to a fitted figure, in a new virtual environment.

Problem   Install; a first spheroid with its page; a cell line of one's own at three levels of
          oxygen; a fit to a growth curve and an IC50, both of tables that are typed here; a
          notebook; exports and a figure for a paper. Nothing but the installation reads the
          checkout, and no step needs a source file of the package.
Scaling   Installing depends on the network and pip's cache, the first run on how fast the machine
          compiles; everything after that is computation.
Cost      A few minutes, most of it to install and to compile.
Command   python docs/programs/newcomer.py            prints the time of each step
          python docs/programs/newcomer.py --write    puts them on the first tutorial's page, too
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

TOP = Path(__file__).resolve().parents[2]
PAGE = TOP / "docs" / "tutorials" / "first-spheroid.md"
SMALL = [
    *("--set", "initial.count=100", "--set", "initial.stage=asynchronous"),
    *("--set", "nutrients.oxygen.uptake=80 amol/s", "--set", "duration=4 d"),
]
CHANGES = {
    "count = 1": 'count = 100\nstage = "asynchronous"',
    'duration = "12 d"': 'duration = "3 d"',
    'cycle_time = "15 h"': 'cycle_time = "20 h"',
    'division_radius = "5 um"': 'division_radius = "5.02 um"',
}
LEVELS = [
    *("--vary", "nutrients.oxygen.boundary=3 %, 5 %, 21 %", "--seeds", "3"),
    *("--set", "duration=2 d"),
]
FILES = {
    "growth.csv": """day, cells, sd, n, diameter / um, sd
0.5, 13, 1.0, 6, 28.0, 1.0
1.0, 22, 1.5, 6, 32.9, 1.0
1.5, 34, 2.0, 6, 37.0, 1.0
2.0, 56, 3.0, 6, 43.8, 1.0
2.5, 108, 6.0, 6, 50.9, 1.0
""",
    "plate.csv": """dose / uM, response, replicate
"""
    + "".join(
        f"{dose}, {response * factor + 15 * shift * (dose > 0):.0f}, {plate}\n"
        for plate, factor, shift in (("A", 1.0, 0), ("B", 1.06, 1), ("C", 0.95, -1))
        for dose, response in ((0, 980), (0.25, 960), (0.5, 850), (1, 640), (2, 360), (4, 200))
    ),
    "first.ipynb": json.dumps(
        {
            "cells": [
                {
                    "cell_type": "code", "execution_count": None, "metadata": {}, "outputs": [],
                    "id": f"cell-{k}", "source": source,
                }
                for k, source in enumerate(
                    [
                        "import multicell as mc",
                        "result = mc.load_result('rich')\nresult",
                        "result.at('2 d').plot(colour='oxygen')",
                        "mc.run(result.scene.with_changes({'duration': '6 h'}), progress=True)",
                    ]
                )
            ],
            "metadata": {"kernelspec": {"display_name": "Python 3", "name": "python3"}},
            "nbformat": 4,
            "nbformat_minor": 5,
        }
    ),
}  # fmt: skip
"""What a newcomer types or has: tables of measurements, and a notebook."""
FIT = [
    *("--data", "growth.csv", "--budget", "60"),
    *("--set", "duration=60 h", "--set", "initial.count=8", "--set", "coupling_step=20 min"),
    *("--set", "initial.stage=asynchronous"),
    *("--free", "growth.cycle_time=10:30 h", "--free", "cells.division_radius=4:10 um"),
]


class Step(NamedTuple):
    """A step of the way: what it is called, and the commands that it takes."""

    name: str
    commands: list[list[str]]


def steps(venv: Path) -> list[Step]:
    """Return the steps; paths are relative to the folder in which they are taken."""
    pip, multicell = str(venv / "bin" / "pip"), str(venv / "bin" / "multicell")
    run = [multicell, "run", "spheroid", *SMALL, "--quiet"]
    return [
        Step(
            "install (`python3 -m venv`, `pip install .`)",
            [[sys.executable, "-m", "venv", str(venv)], [pip, "install", "--quiet", str(TOP)]],
        ),
        Step(
            "first spheroid, 100 to 1,600 cells, with pictures and page; compiles",
            [[*run, "-o", "rich"]],
        ),
        Step(
            "the same with less oxygen, compiled",
            [[*run, "-o", "poor", "--set", "nutrients.oxygen.boundary=0.035 mM"]],
        ),
        Step(
            "a scene of your own (`init`, edit, run)",
            [
                [multicell, "init", "spheroid", "-o", "mine.toml"],
                ["edit", "mine.toml"],
                [multicell, "run", "mine.toml", "-o", "mine", "--quiet"],
            ],
        ),
        Step('`pip install ".[study]"`', [[pip, "install", "--quiet", f"{TOP}[study]"]]),
        Step(
            "your cell line at three levels of oxygen, three seeds each, with bands",
            [
                [multicell, "study", "new", "mine.toml", *LEVELS, "-o", "levels"],
                [multicell, "study", "run", "levels", "--quiet"],
                [multicell, "study", "report", "levels"],
            ],
        ),
        Step(
            "fit of two parameters to a growth curve, 60 runs",
            [[multicell, "fit", "growth", *FIT, "-o", "fit", "--quiet"]],
        ),
        Step(
            "IC50 of a measured plate",
            [[multicell, "dose-response", "--data", "plate.csv", "-o", "ic50"]],
        ),
        Step(
            "a notebook (`pip install nbclient ipykernel`, four cells)",
            [
                [pip, "install", "--quiet", "nbclient", "ipykernel"],
                [str(venv / "bin" / "jupyter"), "execute", "--inplace", "first.ipynb"],
            ],
        ),
        Step(
            "exports: tables, a crate for a repository",
            [
                [multicell, "export", "rich", "-o", "tables"],
                [multicell, "export", "rich", "-o", "crate", "--format", "ro-crate"],
            ],
        ),
        Step(
            "figures as PDF",
            [
                [multicell, "plot", "rich", "-o", "section.pdf"],
                [multicell, "plot", "rich", "poor", "-o", "diameter.pdf", "--quantity", "diameter"],
            ],
        ),
    ]


def edited(scene: Path) -> None:
    """Change a scene as somebody with an editor would."""
    text = scene.read_text("utf-8")
    for old, new in CHANGES.items():
        if old not in text:
            raise ValueError(f"'{scene}' has no {old!r}")
        text = text.replace(old, new)
    scene.write_text(text, "utf-8")


class Times(NamedTuple):
    """Wall time and time of all processors, s."""

    wall: float
    cpu: float


def taken(step: Step, folder: Path) -> Times:
    """Take a step in a folder, and return what it took."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    start, before = time.perf_counter(), os.times()
    for command in step.commands:
        if command[0] == "edit":
            edited(folder / command[1])
        else:
            subprocess.run(command, cwd=folder, env=environment, check=True, stdout=sys.stderr)
    after = os.times()
    cpu = after.children_user + after.children_system
    cpu -= before.children_user + before.children_system
    return Times(time.perf_counter() - start, cpu)


def in_words(seconds: float) -> str:
    """Return a time as ``"1 min 5 s"`` or ``"2.3 s"``."""
    if seconds < 60.0:
        return f"{seconds:.2g} s" if seconds < 10.0 else f"{seconds:.0f} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s"


def table(times: dict[str, Times]) -> str:
    """Return the table of the page."""
    rows = [
        f"| {name} | {in_words(wall)} | {in_words(cpu)} |" for name, (wall, cpu) in times.items()
    ]
    wall, cpu = (in_words(sum(column)) for column in zip(*times.values(), strict=True))
    rows.append(f"| **total** | **{wall}** | **{cpu}** |")
    return "\n".join(["| step | wall time | CPU time |", "|---|---|---|", *rows])


def written(text: str, page: Path) -> None:
    """Put the table between the marks on a page."""
    marks = re.compile(r"(<!-- newcomer: .*? -->\n\n).*?(\n\n<!-- end of newcomer -->)", re.DOTALL)
    before = page.read_text("utf-8")
    if not marks.search(before):
        raise ValueError(f"'{page}' has no place for the table")
    page.write_text(marks.sub(lambda mark: mark[1] + text + mark[2], before), "utf-8")


def main(arguments: list[str] | None = None) -> dict[str, Times]:
    """Take all steps; return what they took."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help="put the times on the page")
    parser.add_argument("--keep", type=Path, help="folder for what comes out, new or empty")
    given = parser.parse_args(arguments)
    folder = given.keep or Path(tempfile.mkdtemp(prefix="newcomer-"))
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in FILES.items():
        (folder / name).write_text(text, "utf-8")
    times: dict[str, Times] = {}
    try:
        for step in steps(folder.resolve() / "venv"):
            times[step.name] = taken(step, folder)
            wall, cpu = times[step.name]
            print(f"{wall:8.1f} s, processors {cpu:8.1f} s: {step.name}", flush=True)
    finally:
        if given.keep is None:
            shutil.rmtree(folder)
    print(f"{sum(step.wall for step in times.values()):8.1f} s in all")
    if given.write:
        written(table(times), PAGE)
    return times


if __name__ == "__main__":
    main()
