"""The chart of networks on docs/which-integrator.md, and the limits of fixed steps in its table.

Problem   the cell cycle under oxygen of Alarcón, Byrne and Maini (2004) in four cells, eight hours
Measured  what `multicell compare` and `multicell stability` measure with `--networks`
Cost      one minute
Command   python docs/programs/networks_chart.py FOLDER

The picture shows evaluations, which are the same on any machine.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from compare_chart import remove_times
from picture_origins import FIGURES, record

import multicell as mc
from multicell.report.plots.style import save_figure

CYCLE = """
Cdh1 = 0.9; CycCdk = 0.01; p27 = 0; mass = 5; RBNP = 1; oxygen = 1;
a1 = 0.05; a2 = 1; a3 = 0.25; a4 = 0.04; b3 = 10; b4 = 5.5; c1 = 0.1; c2 = 0.01;
d1 = 0.01; d2 = 0.1; J3 = 0.04; J4 = 0.04; eta = 0.01; largest = 10; B = 0.01;
Cdh1' = (1 + b3*RBNP)*(1 - Cdh1)/(J3 + 1 - Cdh1) - b4*mass*Cdh1*CycCdk/(J4 + Cdh1);
CycCdk' = a4 - (a1 + a2*Cdh1 + a3*p27)*CycCdk;
p27' = c1*(1 - mass/largest) - c2*oxygen*p27/(B + oxygen);
mass' = eta*mass*(1 - mass/largest);
RBNP' = d1 - (d2 + d1*CycCdk)*RBNP;
"""
"""Normal cells, in minutes, with the parameters of the paper."""


def main() -> None:
    """Compare, find the limits, draw, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "cycle.ant"
    file.write_text(CYCLE, encoding="utf-8")
    own = {"file": str(file), "time_unit": "1 min", "dilution": False}
    scene = mc.load_scene("growth").with_changes({
        "title": "Cell cycle under oxygen (Alarcón 2004)", "duration": "8 h", "initial.count": 4,
        "growth": None, "networks": {"cycle": own},
    })  # fmt: skip
    found = mc.compare_networks(scene, output=folder / "compare", overwrite=True, threads=1)
    figure = found.figure()
    remove_times(figure, found.main)
    picture = FIGURES / "compare-networks.png"
    save_figure(figure, picture)
    record(picture, "python docs/programs/networks_chart.py chart")
    print(*(found.verdict(error) for error in (1e-2, 1e-4, 1e-6)), sep="\n")
    methods = ["rk4", "euler"]
    limits = mc.network_stability(
        scene, methods=methods, output=folder / "stability", overwrite=True, threads=1
    )
    for row in limits.facts["moments"]:
        print(f"| {row['time'] / 3600:.2g} h | {row['rate']:.3g} | "
              + " | ".join(f"{row[name]:.3g}" for name in methods) + " |")  # fmt: skip


if __name__ == "__main__":
    main()
