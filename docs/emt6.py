"""EMT6/Ro spheroids: the scene `emt6` against measured growth, and the picture of docs/emt6.md.

Problem   600 cells at 102 h of culture grow to 20,000, with oxygen, glucose and a cycle in phases
Data      Freyer & Sutherland, Cancer Res. 46 (1986) 3504, as digitised by others; the medium that
          the data belong to is not stated there
Fitted    by hand, two parameters: the radius at division (sizes) and the duration of G1 (rate)
Cost      half a minute on 2 cores
Command   python docs/emt6.py
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import multicell as mc

HERE = Path(__file__).parent
START = 102.0
"""Age of the culture at the start of the scene, h."""
# hours, cells, diameter in um
DATA = np.array(
    [
        (102, 600, 154), (148, 1472, 272), (193, 4409, 370), (243, 14968, 461),
        (270, 30327, 559), (276, 16577, 575),
    ]
)  # fmt: skip


def main() -> None:
    """Run the scene, print the error of the fit and draw the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=HERE / "figures" / "emt6.png")
    parser.add_argument("--seeds", type=int, default=1, help="number of runs")
    given = parser.parse_args()
    scene = mc.load_scene("emt6")
    runs = []
    for seed in range(given.seeds):
        result = mc.run(scene.with_changes({"seed": scene.seed + seed}))
        runs.append(result)
        print(f"seed {scene.seed + seed}: {result.summary()['cells']:,} cells", flush=True)
    cells, size = (
        np.sqrt(np.mean([errors(run.history, column) for run in runs]))
        for column in ("cells", "diameter")
    )
    print(f"root mean square of the logarithmic error: cells {cells:.2f}, diameter {size:.2f}")
    draw(runs, given.output)


def errors(history: dict[str, np.ndarray], column: str) -> np.ndarray:
    """Return the squared logarithmic errors at the measurements that the run comes to."""
    hours = START + history["time"] / 3600.0
    known = DATA[(DATA[:, 0] > START) & (DATA[:, 0] <= hours[-1])]
    found = np.interp(known[:, 0], hours, np.log(history[column]))
    return np.square(found - np.log(known[:, 1 if column == "cells" else 2]))


def draw(runs: list[mc.Result], path: Path) -> None:
    """Draw cells and diameter over time, measured and computed."""
    figure = Figure(figsize=(10, 4.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    for axes, column, k in ((left, "cells", 1), (right, "diameter", 2)):
        axes.plot(DATA[:, 0], DATA[:, k], "o", color="#b5432f", ms=8, label="measured, EMT6/Ro")
        for number, run in enumerate(runs):
            hours = START + run.history["time"] / 3600.0
            label = "multicell, scene emt6" if number == 0 else None
            axes.plot(hours, run.history[column], color="#2f6fb0", lw=2, label=label)
        axes.set(xlabel="age of the culture (h)", xlim=(90, 290))
        axes.grid(alpha=0.3)
    left.set(ylabel="cells", yscale="log", title="Cells")
    right.set(ylabel="diameter (µm)", ylim=(0, 650), title="Diameter")
    left.legend(loc="upper left")
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
