"""Ends of coupling steps of six real runs by integration methods, with failures named.

Problem   runs of 30 to 70 cells: growing tissue, a wave of divisions just over, a cluster that is
          released from compression, cells that move by themselves, exact JKR, and a box with
          elastic walls
Truth     DOPRI5 at 1e-11 of a radius, checked by CVODE
Ratio     error of the worst cell over the largest effect of twelve shifts of the start
Command   python docs/programs/failures.py FOLDER    (--methods, --states, --quick)

Runs and measurements are kept in FOLDER: a program that was ended continues. With --quick five
methods take part, and two states.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import multicell as mc

TISSUE: dict[str, Any] = {
    "initial.count": 50, "initial.stage": "uniform", "initial.jitter": 0.02,
    "drag.viscosity": 0.5, "output.every": "30 min",
}  # fmt: skip
STATES: dict[str, tuple[str, dict[str, Any]]] = {
    "growing": ("4 h", {}),
    "fresh": (
        "3 h",
        {
            "initial.count": 30, "initial.stage": "birth", "growth.cycle_time": "3 h",
            "growth.cycle_variation": 0.02, "drag.viscosity": 0.05,
        },
    ),
    "compressed": ("0 h", {"initial.spacing": 0.7, "initial.jitter": 0.0}),
    "motile": (
        "1 h",
        {
            "motility.force": 0.1, "motility.persistence": 600.0, "initial.spacing": 1.3,
            "contact.surface_energy": 0.02, "drag.viscosity": 0.01,
        },
    ),
    "exact-jkr": ("2 h", {"contact.law": "exact-jkr", "drag.viscosity": 0.05}),
    "confined": (
        "4 h", {"drag.viscosity": 0.05, **{f"domain.{a}": ["-17 um", "17 um"] for a in "xyz"}}
    ),
}  # fmt: skip
"""Name of a state -> its time in a run, and changes of the scene ``growth``."""
QUICK = ("auto", "rkc2", "cvode", "rosenbrock", "euler-adaptive")


def run_of(name: str, folder: Path) -> str:
    """Run a scene up to its state unless that is done, and return the state's name."""
    time, changes = STATES[name]
    end = f"{float(time.split()[0]) + 0.5} h"
    scene = mc.load_scene("growth").with_changes({**TISSUE, **changes, "duration": end})
    place = folder / name
    if not (place / "summary.json").is_file():
        mc.run(scene, output=place, overwrite=True, report=False, threads=1)
    return f"{place}:{time}"


def main() -> None:
    """Run what is missing and make the map."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--states", nargs="+", choices=STATES, default=list(STATES))
    parser.add_argument("--methods", nargs="+")
    parser.add_argument("--quick", action="store_true")
    given = parser.parse_args()
    if given.quick:
        given.states, given.methods = ["motile", "compressed"], list(QUICK)
    states = [run_of(name, given.folder / "runs") for name in given.states]
    place = given.folder / "map"
    done = (place / "report.html").is_file()
    found = mc.moving_stability(
        states, given.methods, place, progress=print, threads=1, overwrite=done
    )
    for row in found.worst():
        print(
            f"{row['method']:16} {row['setting']:8.3g} {row['wrong']} of {row['states']} wrong, "
            f"worst {row['ratio']:.3g} ({row['error_um']:.2g} um) in {row['state']}: {row['kind']}"
        )


if __name__ == "__main__":
    main()
