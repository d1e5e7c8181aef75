"""Sorting: unlike contacts fall from those of a random mixture where like cells stick more
========================================================================================

Problem
    400 cells of two types in a plane (the scene ``openvt-sorting``), mixed at random, with random
    motion. Like cells adhere four times as strongly as unlike ones, or all of them as weakly.
    The part of contacts between unlike cells is compared with that of a
    random mixture of n cells of each type, n / (2n - 1).
Scaling
    Domains coarsen ever more slowly: the part falls like a power of time.
Cost
    Half a minute on one core.
Command
    .. code-block:: sh

        python examples/sorting_types.py [FOLDER]

    It writes FOLDER/sorting_types.png.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from matplotlib.collections import EllipseCollection
from matplotlib.figure import Figure

import multicell as mc

LIKE, UNLIKE = "0.2 nN/um", "0.05 nN/um"
COLOURS = ("#0072b2", "#e69f00")


def setup(like: str, **changes: Any) -> mc.Scene:
    """Return the scene with a surface energy of like cells; arguments are further changes."""
    return mc.load_scene("openvt-sorting").with_changes(
        {
            "duration": "20 h",
            "types.A.surface_energy": {"A": like, "B": UNLIKE},
            "types.B.surface_energy": {"A": UNLIKE, "B": like},
            **changes,
        }
    )


def main(output: str | Path, **changes: Any) -> dict[str, float]:
    """Run, draw, and return the parts of contacts that are unlike at the end."""
    runs = {
        "like cells stick more": mc.run(setup(LIKE, **changes)),
        "all stick alike": mc.run(setup(UNLIKE, **changes)),
    }
    figure = Figure(figsize=(11.0, 3.8), layout="constrained")
    curve, *pictures = figure.subplots(1, 3)
    found, colours = {}, iter(("#0072b2", "#e69f00"))
    for (name, run), axes in zip(runs.items(), pictures, strict=True):
        part = run.history["heterotypic_fraction"]
        curve.plot(run.history["time"] / 3600.0, part, label=name, color=next(colours))
        found[name] = float(part[-1])
        cells = run.frames[-1].cells
        wide = 2.0 * cells.radius
        axes.add_collection(
            EllipseCollection(
                wide, wide, 0, units="xy", offsets=cells.position[:, :2], lw=0.3, ec="w",
                transOffset=axes.transData, facecolors=[COLOURS[kind] for kind in cells.kind],
            )
        )  # fmt: skip
        axes.set(title=name, aspect="equal", xticks=[], yticks=[])
        axes.autoscale_view()
        axes.margins(0.05)
    each = int((cells.kind == 0).sum())
    found["random mixture"] = each / (2 * each - 1)
    curve.axhline(found["random mixture"], color="0.4", ls="--", label="random mixture")
    curve.set(xlabel="time (h)", ylabel="contacts between unlike cells", ylim=(0, 0.6))
    curve.legend(frameon=False, loc="lower left")
    folder = Path(output)
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / "sorting_types.png", dpi=150)
    return found


if __name__ == "__main__":
    for case, part in main(*(sys.argv[1:2] or ["out/sorting_types"])).items():
        print(f"{case}: {part:.3f}")
