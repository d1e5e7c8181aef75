"""Draw the rooms of the package: floors from pyproject.toml, imports from the code.

Every box is a room or a module on the top level, the wider the more files it has. An arrow joins a
room to each room below that it imports when it is loaded; what follows from other arrows is left
out. It is the darker the more files import.

    python docs/programs/rooms.py
"""

from __future__ import annotations

import ast
import tomllib
from collections import Counter
from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from multicell.report.plots.style import BLUE, INK, blank, save_figure, styled

DOCS = Path(__file__).parents[1]
PACKAGE = DOCS.parent / "multicell"
WHAT = {
    "cli": "commands", "comparison": "work–precision, stability", "studies": "many runs",
    "calibration": "fits, sensitivity",
    "testing": "conformance",
    "ode": "for outside solvers", "runner": "run, resume", "report": "result, pages, pictures",
    "simulation": "state and the coupling step",
    "behaviours": "growth, responses", "networks": "inside cells",
    "host": "files, signals, memory", "population": "radius, core, rim", "measured": "measurements",
    "nutrient": "fields", "biology": "growth, division, death",
    "results": "frames, history, journal", "scene": "parts of a scene", "integrators": "methods",
    "mechanics": "forces, Jacobian, lists", "contact": "pair laws", "plugins": "additions of users",
    "tables": "CSV, Parquet",
    "schema": "declarations", "units": "at the door", "random": "streams",
    "compiling": "by numba, threads", "precompile": "compiling ahead",
    "importing": "models of PhysiCell",
    "philox": "random words", "vectors": "sums by column", "roots": "Brent's method",
    "cells": "the state", "errors": "errors of users",
}  # fmt: skip


def floors() -> list[list[str]]:
    """Return the rooms of each floor, the top one first."""
    settings = tomllib.loads((DOCS.parent / "pyproject.toml").read_text(encoding="utf-8"))
    (contract,) = (
        c for c in settings["tool"]["importlinter"]["contracts"] if c["type"] == "layers"
    )
    return [[room.strip() for room in layer.split("|")] for layer in contract["layers"]]


def files(room: str) -> list[Path]:
    """Return the files of a room."""
    folder = PACKAGE / room
    return sorted(folder.rglob("*.py")) if folder.is_dir() else [folder.with_suffix(".py")]


def imports() -> Counter[tuple[str, str]]:
    """Return how many files of a room import from another room, by the two names."""
    found: Counter[tuple[str, str]] = Counter()
    rooms = {room for floor in floors() for room in floor}
    for room in rooms:
        for file in files(room):
            names = set()
            for node in ast.parse(file.read_text(encoding="utf-8")).body:
                if isinstance(node, ast.ImportFrom) and node.module:
                    parts = node.module.split(".")
                    if parts[0] == "multicell":
                        inside = parts[1:2] or [alias.name for alias in node.names]
                        names |= set(inside) & rooms
            found.update((room, other) for other in names - {room})
    return found


def shown(counts: Counter[tuple[str, str]]) -> dict[tuple[str, str], int]:
    """Return the imports that do not follow from a longer way (the transitive reduction)."""
    below: dict[str, set[str]] = {}

    def reach(room: str) -> set[str]:
        if room not in below:
            near = {other for one, other in counts if one == room}
            below[room] = near.union(*map(reach, near))
        return below[room]

    def implied(above: str, under: str) -> bool:
        return any(one == above and under in reach(other) for one, other in counts)

    return {pair: count for pair, count in counts.items() if not implied(*pair)}


@styled
def draw() -> Figure:
    """Return the picture."""
    figure = blank("Rooms of multicell", "imports go down only; number of files", (10.0, 10.4))
    axes = figure.add_axes((0.01, 0.01, 0.98, 0.91))
    levels = floors()
    places: dict[str, tuple[float, float, float]] = {}
    for level, floor in enumerate(levels):
        widths = [1.5 + 0.045 * len(files(room)) for room in floor]
        left = -0.5 * (sum(widths) + 0.35 * (len(floor) - 1))
        for room, width in zip(floor, widths, strict=True):
            places[room] = left + 0.5 * width, -float(level), width
            left += width + 0.35
    for (above, below), count in shown(imports()).items():
        (x, y, _), (u, v, _) = places[above], places[below]
        axes.annotate(
            "", (u, v + 0.3), (x, y - 0.3),
            arrowprops={
                "arrowstyle": "-|>", "color": BLUE, "alpha": min(0.35 + 0.06 * count, 0.9),
                "lw": 1.1, "shrinkA": 0, "shrinkB": 0,
            },
            zorder=1,
        )  # fmt: skip
    for room, (x, y, width) in places.items():
        axes.add_patch(
            Rectangle(
                (x - 0.5 * width, y - 0.3), width, 0.6, facecolor="#f4f6f8", edgecolor=INK,
                lw=0.8, zorder=2,
            )
        )  # fmt: skip
        number = len(files(room))
        name = f"{room}/ ({number})" if number > 1 else room
        axes.text(x, y + 0.1, name, ha="center", va="center", fontsize=10, weight="bold", zorder=3)
        axes.text(x, y - 0.15, WHAT[room], ha="center", va="center", fontsize=8, zorder=3)
    half = max(abs(x) + 0.5 * width for x, _, width in places.values()) + 0.1
    axes.set(xlim=(-half, half), ylim=(-len(levels) + 0.4, 0.6))
    axes.axis("off")
    return figure


if __name__ == "__main__":
    save_figure(draw(), DOCS / "figures" / "rooms.png")
