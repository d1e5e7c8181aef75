"""The chart of docs/which-integrator.md: worst cell over cost of all methods on stiff inclusions.

Problem   the built-in scene `stiff-inclusions`: ten stiff cells among a thousand, 20 minutes
Measured  what `multicell compare stiff-inclusions -o FOLDER --threads 1` measures; it is done here
          unless FOLDER holds it already
Cost      two minutes
Command   python docs/programs/compare_chart.py FOLDER [--repeats 3] [--budget 60] [--no-times]

The axis of processor time belongs to an idle machine. --no-times leaves that panel out, with the
failures above it: errors and evaluations are the same on any machine.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from picture_origins import FIGURES, record

import multicell as mc
from multicell.comparison.result import WorkPrecision
from multicell.report.plots.style import save_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SCENE, NORM = "stiff-inclusions", "worst_cell"


def remove_times(figure: Figure) -> None:
    """Take the panel of times away; that of evaluations takes its place too, and its labels."""
    times, counts = (
        next(axes for axes in figure.axes if axes.get_label() == f"{NORM} {name}")
        for name in ("time", "cost")
    )
    first, own = times.get_position(), counts.get_position()
    for axes in figure.axes:
        if axes is not counts:
            axes.remove()
    counts.set_aspect("auto")
    counts.set_position((first.x0, own.y0, own.x1 - first.x0, own.height))
    counts.tick_params(labelleft=True)
    counts.set_ylabel("error")


def main() -> None:
    """Compare, draw, and note which methods the picture shows."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--budget", type=float, default=60.0)
    parser.add_argument("--no-times", action="store_true")
    given = parser.parse_args()
    if (found := given.folder / "workprecision.json").exists():
        result = WorkPrecision.read(found)
    else:
        result = mc.compare(
            SCENE, output=given.folder, repeats=given.repeats, budget=given.budget, threads=1,
            progress=print,
        )  # fmt: skip
    figure = result.figure(NORM)
    if given.no_times:
        remove_times(figure)
    picture = FIGURES / f"compare-{SCENE}.png"
    save_figure(figure, picture)
    command = "python docs/programs/compare_chart.py chart"
    if given.no_times:
        command += " --no-times"
    record(picture, command, (row["method"] for row in result.table))


if __name__ == "__main__":
    main()
