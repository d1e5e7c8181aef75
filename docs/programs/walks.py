"""Walks of values through the rooms of the package, and circles of files within a room.

Problem   a reader follows a value: the scene from ``Simulation`` on, a concentration into growth, a
          surface energy into a force
Question  how many rooms does the reader enter, how often up, and how often one seen before; and
          which files of a room import each other
Measured  in a small scene, the Python functions that are called with the value, or with something
          that holds it, in their order. A station is a room that the walk enters from another; a
          climb goes to a higher floor; a return enters a room that was left before
Command   python docs/programs/walks.py   (a minute; --stations lists them; PYTHONPATH for
          another version of the package)
"""

from __future__ import annotations

import argparse
import ast
import sys
import tomllib
from collections.abc import Callable, Mapping
from itertools import pairwise
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

import multicell as mc

PACKAGE = Path(mc.__file__).parent
ENERGY = 0.0123457  # nN/um, which no other number of the scene is
SCENE = {
    "duration": "20 min", "coupling_step": "10 min", "initial": {"count": 12},
    "contact": {"law": "jkr", "surface_energy": ENERGY}, "growth": {}, "death": {},
    "nutrients": {"oxygen": {"boundary": 0.06, "quiescence": 0.01, "necrosis": 0.001}},
}  # fmt: skip


def floors() -> dict[str, int]:
    """Return the floor of each room, the lowest first."""
    settings = tomllib.loads((PACKAGE.parent / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = settings["tool"]["importlinter"]["contracts"]
    (layers,) = (contract["layers"] for contract in contracts if contract["type"] == "layers")
    rows = [[room.strip() for room in row.split("|")] for row in reversed(layers)]
    return {room: level for level, row in enumerate(rows) for room in row}


class Walk:
    """A profiler that notes the rooms of all functions that are called with a value."""

    def __init__(self, holds: Callable[[Any], bool], last: str = "") -> None:
        self.holds, self.last = holds, last
        self.rooms, self.over = [], False

    def __call__(self, frame: FrameType, event: str, _: Any) -> None:
        """Note the room of a function that is called with the value."""
        code = frame.f_code
        if self.over or event != "call" or not code.co_filename.startswith(f"{PACKAGE}/"):
            return
        names = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
        sys.setprofile(None)
        try:
            if any(self.holds(frame.f_locals[name]) for name in names if name in frame.f_locals):
                room = Path(code.co_filename).relative_to(PACKAGE).parts[0].removesuffix(".py")
                self.rooms.append(room)
                self.over = bool(self.last) and code.co_name == self.last
        finally:
            sys.setprofile(self)

    def stations(self) -> list[str]:
        """Return the rooms in their order, one after another that is the same once."""
        before = ["", *self.rooms]
        return [room for last, room in zip(before, self.rooms, strict=False) if room != last]

    def follow(self, run: Callable[[], object]) -> list[str]:
        """Run a function and return the stations."""
        sys.setprofile(self)
        try:
            run()
        finally:
            sys.setprofile(None)
        return self.stations()


def parts_of(value: Any) -> list[Any]:
    """Return a value, and its parts by name or in a row; of an unfinished one its present parts."""
    inside = list((vars(value) if hasattr(value, "__dict__") else {}).values())
    if isinstance(value, tuple | list):
        return [value, *value, *inside]
    try:
        return [value, *value.values(), *inside] if isinstance(value, Mapping) else [value, *inside]
    except AttributeError:
        return [value, *inside]


def walks() -> dict[str, list[str]]:
    """Return the stations of each walk."""
    scene = mc.Scene.from_dict(SCENE)
    mc.run(scene, threads=1, report=False)  # compiles
    found = {
        "scene from Simulation": Walk(lambda value: isinstance(value, mc.Scene)).follow(
            lambda: mc.Simulation(scene, threads=1).step()
        )
    }
    simulation = mc.Simulation(scene, threads=1)
    simulation.step()
    oxygen = np.array(simulation.concentrations["oxygen"])

    def same(value: Any) -> bool:
        return any(
            isinstance(part, np.ndarray) and part.shape == oxygen.shape and (part == oxygen).all()
            for part in parts_of(value)
        )

    found["concentration into growth"] = Walk(same, "grow").follow(simulation.step)

    def energy(value: Any) -> bool:
        for part in parts_of(value):
            inner = parts_of(part) if isinstance(part, tuple) else (part,)
            for number in inner:
                if isinstance(number, float) and number == ENERGY:
                    return True
                if getattr(number, "surface_energy", None) == ENERGY:
                    return True
        return False

    def build() -> None:
        mc.Simulation(mc.Scene.from_dict(SCENE), threads=1).step()

    found["surface energy into a force"] = Walk(energy).follow(build)
    return found


def imported(file: Path, *, lazily: bool) -> set[str]:
    """Return the modules of the package that a file imports at its top, or also in functions."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    nodes = ast.walk(tree) if lazily else tree.body
    typed = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
        for inner in ast.walk(node)
    }
    found = set()
    for node in nodes:
        if isinstance(node, ast.ImportFrom) and node.module and id(node) not in typed:
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def circles(*, lazily: bool) -> list[list[str]]:
    """Return the groups of files of the same room that import each other."""
    from graphlib import CycleError, TopologicalSorter

    files = {
        ".".join(("multicell", *file.relative_to(PACKAGE).with_suffix("").parts)): file
        for file in sorted(PACKAGE.rglob("*.py"))
        if file.name != "__init__.py"
    }
    room = {name: name.split(".")[1] for name in files}
    needs = {
        name: {x for x in imported(file, lazily=lazily) & files.keys()
               if room[x] == room[name] and x != name}
        for name, file in files.items()
    }  # fmt: skip
    found = []
    while True:
        try:
            TopologicalSorter(needs).prepare()
        except CycleError as error:
            circle = error.args[1]
            found.append(circle)
            needs[circle[1]] = needs[circle[1]] - {circle[0]}
        else:
            return found


def main() -> None:
    """Print the walks and the circles."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--stations", action="store_true", help="list the rooms of each walk")
    listed = parser.parse_args().stations
    level = floors()
    print("| walk | stations | rooms | climbs | returns |\n|---|---|---|---|---|")
    for name, stations in walks().items():
        pairs = list(pairwise(stations))
        climbs = sum(level.get(b, -1) > level.get(a, -1) for a, b in pairs)
        returns = sum(room in stations[:place] for place, room in enumerate(stations))
        print(f"| {name} | {len(stations)} | {len(set(stations))} | {climbs} | {returns} |")
        if listed:
            print(" ".join(stations))
    for lazily in (False, True):
        groups = circles(lazily=lazily)
        print(f"\ncircles within rooms{', imports in functions included' * lazily}: {len(groups)}")
        for circle in groups:
            print("  " + " <- ".join(circle))


if __name__ == "__main__":
    main()
