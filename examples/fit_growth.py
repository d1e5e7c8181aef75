"""Fit of a growth curve: cycle time and cell size, with their uncertainties
=========================================================================

Problem
    A culture grows from 8 cells for 60 h; cells were counted and its diameter measured five
    times (growth.csv). The data come from a run with a cycle of 17 h and a division radius
    of 6.5 um, with errors of 5 % and 1 um. The fit does not use these values: it searches
    cycles of 10 to 30 h and radii of 4 to 10 um.
Scaling
    Runs of a fit are independent: twice the cores take half the time. Polynomials through the
    runs need (n + 1)(n + 2)/2 of them for n parameters, and some more.
Cost
    60 runs of 0.2 s on one core, and a few seconds for pictures and page. It is not run in the
    documentation, which is to be built quickly.
Command
    .. code-block:: sh

        python examples/fit_growth.py [FOLDER]

    It writes FOLDER/report.html.
"""

# sphinx_gallery_thumbnail_path = 'figures/fit-data.png'

from __future__ import annotations

import sys
from pathlib import Path

import multicell as mc

DATA = Path(__file__).with_name("growth.csv")
TRUTH = {"growth.cycle_time": 17 * 3600.0, "cells.division_radius": 6.5}
FREE = {"growth.cycle_time": "10:30 h", "cells.division_radius": "4:10 um"}


def setup() -> mc.Scene:
    """Return the scene, with values for what is fitted that are off."""
    return mc.load_scene("growth").with_changes(
        {
            "title": "Growth of a small culture",
            "duration": "60 h",
            "initial.count": 8,
            "initial.stage": "asynchronous",
            "coupling_step": "20 min",
        }
    )


def main(output: str | Path, budget: int = 60) -> mc.Fit:
    """Fit, and write everything to a folder; the same folder again runs nothing twice."""
    return mc.fit(setup(), DATA, FREE, output=output, seeds=2, budget=budget, cores=1)


if __name__ == "__main__":
    found = main(*(sys.argv[1:2] or ["out/fit_growth"]))
    intervals = found.intervals()
    for free in found.problem.ranges:
        interval = intervals[free.name]
        print(
            f"{free.key:24s} best {found.best.words[free.key]:>9s}, 95 %: {interval.low:.4g} to "
            f"{interval.high:.4g} {free.unit}, true {TRUTH[free.key]:g}"
        )
    print(f"chi^2 = {found.best.chi_squared:.3g} for {len(found.best.residuals)} data")
    for words in found.undetermined:
        print(words)
