"""A study: the effect of adhesion and stiffness on the packing of a small cluster
===============================================================================

Problem
    Growing clusters of two stiffnesses and three surface energies, two seeds each: twelve
    runs of 30 h, from one cell. Points share their random numbers, so only the
    parameters differ between them. The result is one table with units.
Scaling
    Proportional to the number of runs, divided by the number of cores. The longest
    runs start first.
Cost
    About 10 s on two cores, the pictures included; longer when numba compiles the first time. A
    second start repeats no run.
Command
    .. code-block:: sh

        python examples/study.py [FOLDER]

    It writes FOLDER/study.toml, runs/, study.nc, study.csv, report.html and its pictures.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import multicell as mc


def main(output: str | Path, **changes: Any) -> mc.Study:
    """Plan the study, run what is missing, write its report; return it."""
    scene = mc.load_scene("growth").with_changes({"duration": "30 h", "output.every": "3 h"})
    study = mc.study(
        scene.with_changes(changes),
        vary={"contact.surface_energy": "0.02,0.1,0.2 nN/um", "cells.young": "1,2 kPa"},
        seeds=2,
        output=output,
    )
    study.run()
    study.report()
    return study


if __name__ == "__main__":
    table = main(*(sys.argv[1:2] or ["out/study"])).to_xarray()
    packing = table["packing_ratio"].isel(time=-1)
    for energy in table["surface_energy"].values:
        for young in table["young"].values:
            found = packing.sel(surface_energy=energy, young=young)
            mean, spread = float(found.mean("seed")), float(found.std("seed", ddof=1))
            print(f"{energy:g} nN/um, {young:g} kPa: packing ratio {mean:.3f} ± {spread:.3f}")
