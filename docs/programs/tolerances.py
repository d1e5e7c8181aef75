"""Effect of a method's default tolerance on single cells: errors over one coupling step.

Problem   coupling steps of small scenes, each from its own recorded state: packed cells that
          settle, a shock of divisions, clusters that grow at three viscosities
Question  how far are single cells off at the end of a step that a method takes at the tolerance
          that a scene gets which names none
Measured  distance from the reference in µm: median over all cells and steps, median over the
          steps of the worst cell, worst cell of all; and what a shift of all positions by
          0.01 µm (root mean square of a coordinate) at the beginning does to the worst cell
Cost      five minutes
Command   python docs/programs/tolerances.py    (--methods auto:0.01 for others)
"""

from __future__ import annotations

import argparse

import numpy as np

import multicell as mc
from multicell.comparison.reference import Reference, reference
from multicell.comparison.replay import replay
from multicell.integrators.registry import METHODS, from_options
from multicell.scene.parts import IntegratorOptions

STEPS = 8
GROWN = {"initial.count": 150, "duration": "6 h"}
SCENES = {
    "settle": ("settle", {}),
    "division-shock": ("division-shock", {"duration": "1 h"}),
    "grow-2000 from 150 cells, 5 kPa·s": ("grow-2000", {**GROWN, "drag.viscosity": 5.0}),
    "grow-2000 from 150 cells, 0.5 kPa·s": ("grow-2000", {**GROWN, "drag.viscosity": 0.5}),
    "grow-2000 from 150 cells, 0.05 kPa·s": ("grow-2000", {**GROWN, "drag.viscosity": 0.05}),
}
"""Name in the table -> built-in scene and what is changed of it."""


def defaults() -> list[tuple[str, float]]:
    """Return the methods under error control with their default tolerance, µm."""
    return [(name, info.atol) for name, info in METHODS.items() if info.control == "tolerance"]


def errors(exact: Reference, options: IntegratorOptions) -> list[np.ndarray] | str:
    """Return how far each cell is off at the end of each step, µm, or why a step failed."""
    found = replay(exact.problem, from_options(options))
    if not found.done:
        return found.problem
    pairs = zip(found.positions, exact.trajectory.positions, strict=True)
    return [np.linalg.norm(end - true, axis=1) for end, true in pairs]


def entry(exact: Reference, method: str, atol: float) -> str:
    """Return the table's entry of a method in a scene, µm."""
    found = errors(exact, IntegratorOptions(method=method, atol=atol))
    if isinstance(found, str):
        return found
    worst = [step.max() for step in found]
    return f"{np.median(np.concatenate(found)):.1g} / {np.median(worst):.2g} / {max(worst):.2g}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--methods", nargs="+", default=[], help="like auto:0.01")
    given = [text.rpartition(":") for text in parser.parse_args().methods]
    asked = [(name, float(atol)) for name, _, atol in given] or defaults()
    rows = {f"| `{name}` | {atol:g} |": "" for name, atol in asked}
    last = ""
    for name, (scene, changes) in SCENES.items():
        print(name, flush=True)
        exact = reference(mc.load_scene(scene).with_changes(changes), stepwise=STEPS, threads=1)
        for method, atol in asked:
            rows[f"| `{method}` | {atol:g} |"] += f" {entry(exact, method, atol)} |"
        known = exact.conditioning
        assert known is not None
        worst = known.worst_cell
        last += f" {np.median(known.rms):.1g} / {np.median(worst):.2g} / {worst.max():.2g} |"
    print(f"| method | `atol` / µm | {' | '.join(SCENES)} |\n|{'---|' * (2 + len(SCENES))}")
    print("\n".join(first + rest for first, rest in rows.items()))
    print(f"| a shift | {known.shift:g} |{last}")


if __name__ == "__main__":
    main()
