"""Coupling steps of real runs, with their references: what the tiles of the diagram are solved on.

A cluster grows at 5 kPa·s as the built-in scene grow-2000 does: from cells in all stages of the
cycle, or from cells that were born together, which divide in waves. One coupling step of ten
minutes is taken from it:

quiet     between two waves: hardly any cell has divided in the last hours
typical   in steady growth: one to two cells in a hundred have divided just before the step
fresh     at the height of a wave: four to eight in a hundred

LEAD steps before it the viscosity changes to the one at which λΔt, the largest decay rate of the
Jacobian times the length of the step, is what it should be; `auto` leads through these steps.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, final

import numpy as np

import multicell as mc
from multicell.cells import Cells, FloatArray
from multicell.comparison.conditioning import shift_starts
from multicell.comparison.ladders import capable_methods, find_method
from multicell.comparison.null_methods import MotionScale
from multicell.comparison.replay import ReplayProblem, Step, Trajectory, replay
from multicell.mechanics.decay_rate import largest_decay_rate

STATES: Final = ("quiet", "typical", "fresh")
GOALS: Final = (0.1, 0.01)
"""Errors that are asked for, relative to the motion (multicell.comparison.null_methods)."""
LEAD: Final = 3
"""Coupling steps at the tile's own viscosity before the one that is solved."""
PART: Final = 0.1
"""Shift of the beginning that shows the conditioning, in units of the error that is asked for."""
_VISCOSITY: Final = 5.0  # kPa s, at which clusters grow
_HOURS: Final = {"quiet": (20.0, 24.0), "typical": (16.0, 18.0), "fresh": (28.0, 32.0)}
"""State -> when its step may begin, hours."""
_MILD_TO: Final = 2e3
"""λΔt up to which a method of order 5 solves the reference."""
_MILD: Final = (("dopri5", 1e-6), ("rkc2", 1e-4))
_STIFF: Final = (("rkc2", 1e-4), ("rosenbrock", 1e-3))
"""Method and tolerance in µm of the reference, and of its check."""


@final
@dataclass(frozen=True)
class Tile:
    """A coupling step to solve: about so many cells, at a λΔt."""

    state: str
    cells: int
    stiffness: float
    seed: int


@final
@dataclass(frozen=True, eq=False)
class Solved:
    """A coupling step with its reference.

    Attributes
    ----------
    tile : Tile
    problem : Problem
    end : (n, 3) float64, µm
        Where the reference leads.
    scale : MotionScale
        To which errors are relative.
    uncertainty : float
        Difference of the reference from its check.
    conditioning : tuple of float
        What a shift by :data:`PART` of each goal does to the end, over that goal.
    facts : dict
        Of the state: ``n``, ``lambda_dt`` (λΔt at the beginning), ``divided`` (part of the cells
        that divided just before), ``since_h`` (hours since its division, of the cell in the
        hundred that divided last), ``viscosity_kPa_s``, ``moved_um`` and ``residual_um`` (root
        square), ``reference_s``.
    goals : tuple of float
        Errors that are asked for.
    """

    tile: Tile
    problem: ReplayProblem
    end: FloatArray
    scale: MotionScale
    uncertainty: float
    conditioning: tuple[float, ...]
    facts: dict[str, float]
    goals: tuple[float, ...] = GOALS

    def errors(self, end: FloatArray) -> tuple[float, float]:
        """Return the errors of an end: of all cells, and of the worst (:class:`MotionScale`)."""
        return self.scale.errors(end, self.end)


def _scene(tile: Tile, viscosity: float) -> mc.Scene:
    """Return the scene of a tile's run."""
    waves = tile.state != "typical"
    return mc.load_scene("grow-2000").with_changes({
        "initial.count": max(2, round(tile.cells / (2.5 if waves else 2.1))), "seed": tile.seed,
        "stop_cells": None, "initial.stage": "birth" if waves else "asynchronous",
        "initial.jitter": 0.1, "initial.spacing": 0.9, "duration": "48 h",
        "drag.viscosity": viscosity, "integrator": "auto",
    })  # fmt: skip


def checkpoints(tile: Tile, folder: Path | None = None) -> dict[str, Cells]:
    """Return the cells LEAD steps before the steps of all states that the tile's run passes."""
    states = ("typical",) if tile.state == "typical" else ("quiet", "fresh")
    made = {state: _path(folder, "cells", [state, tile.cells, tile.seed]) for state in states}
    if not all(path.exists() for path in made.values()):
        for state, cells in _grown(tile, states).items():
            _store(made[state], dict(cells.columns()))
    return {state: Cells(**_load(path)) for state, path in made.items()}


def _grown(tile: Tile, states: tuple[str, ...]) -> dict[str, Cells]:
    simulation = mc.Simulation(_scene(tile, _VISCOSITY), threads=1)
    last: deque[Cells] = deque(maxlen=LEAD + 1)
    seen: dict[str, list[tuple[float, Cells]]] = {state: [] for state in states}
    known = len(simulation.cells)
    while simulation.time < 3600.0 * max(_HOURS[state][1] for state in states):
        simulation.step()
        cells = simulation.cells
        last.append(cells)
        born = float((cells.id >= known).mean())
        known = int(cells.id.max()) + 1
        for state in states:
            first, end = (3600.0 * hour for hour in _HOURS[state])
            if first <= simulation.time <= end and len(last) > LEAD:
                seen[state].append((born, last[0]))
                _thin(state, seen[state])
    return {state: min(steps, key=_rank(state, steps))[1] for state, steps in seen.items()}


def _rank(state: str, steps: list[tuple[float, Cells]]) -> Callable[[tuple[float, Cells]], float]:
    """Return the key by which the chosen step is least."""
    if state == "typical":
        mean = float(np.mean([born for born, _ in steps]))
        return lambda step: abs(step[0] - mean)
    sign = 1.0 if state == "quiet" else -1.0
    return lambda step: sign * step[0]


def _thin(state: str, steps: list[tuple[float, Cells]]) -> None:
    """Keep but the best step of a wave, since large clusters take much memory."""
    if state != "typical" and len(steps) > 1:
        # of equally quiet steps the later one: its last division is longer ago
        steps[:] = [min(reversed(steps), key=_rank(state, steps))]


def recorded(tile: Tile, folder: Path | None = None) -> tuple[ReplayProblem, dict[str, float]]:
    """Return the step of a tile, and what there is to know of it."""
    cells = checkpoints(tile, folder)[tile.state]
    begun = mc.Simulation(_scene(tile, _VISCOSITY), threads=1, cells=cells)
    system = begun.prepared()
    length = system.motion.end - system.motion.begin
    rate = largest_decay_rate(system, system.motion.begin, begun.cells.position)
    scene = _scene(tile, _VISCOSITY * rate * length / tile.stiffness)
    simulation = mc.Simulation(scene, threads=1, cells=cells)
    for _ in range(LEAD):
        known = simulation.next_id
        simulation.step()
    cells, template = simulation.cells, simulation.prepared()
    start = np.array(cells.position)
    problem = ReplayProblem(
        scene, template, start, cells.radius, [Step(template.motion)], [start], 1
    )
    return problem, {
        "n": float(len(cells)),
        "lambda_dt": length * largest_decay_rate(template, template.motion.begin, start),
        "divided": float((cells.id >= known).mean()),
        "since_h": float(np.percentile(cells.age, 1.0)) / 3600.0,
        "viscosity_kPa_s": float(scene.drag.viscosity),
    }


def solved(tile: Tile, folder: Path | None = None) -> Solved:
    """Return the step of a tile with its reference; both are kept in a folder of the user's."""
    problem, facts = recorded(tile, folder)
    motion = problem.steps[0].motion
    # a state that another version of the package recorded has a reference of its own
    same = hashlib.sha256(b"".join(a.tobytes() for a in (problem.start, motion.end_radius)))
    path = _path(folder, "reference", [*vars(tile).values(), same.hexdigest()])
    if not path.exists():
        _store(path, reference(problem, tile.stiffness))
    held = _load(path)
    scale = MotionScale.of(problem.start, held["end"], problem.mean_radius)
    facts |= {
        "moved_um": scale.moved,
        "residual_um": scale.residual,
        "reference_s": float(held["cost"]),
    }
    uncertainty = scale.errors(held["check"], held["end"])[0]
    conditioning = tuple(
        scale.errors(shifted, held["end"])[0] / goal
        for shifted, goal in zip(held["shifted"], GOALS, strict=True)
    )
    return Solved(tile, problem, held["end"], scale, uncertainty, conditioning, facts)


def reference(
    problem: ReplayProblem, stiffness: float, goals: tuple[float, ...] = GOALS
) -> dict[str, Any]:
    """Return the end of a step, and those of a check by another method and of shifted beginnings.

    Both are tightened, a decade at a time, until they agree to a fifth of what the finest goal
    allows, or three times at most.
    """
    (method, atol), (checking, other) = _MILD if stiffness <= _MILD_TO else _STIFF
    if checking not in capable_methods(problem.scene):
        checking = "cvode"

    def run(by: str, tolerance: float, start: ReplayProblem = problem) -> Trajectory:
        solver = find_method(by, problem.scene, problem.mean_radius)
        found = replay(start, solver.make(tolerance / problem.mean_radius))
        if not found.done:
            raise SystemExit(f"the reference by {by} failed: {found.problem}")
        return found

    for _ in range(3):
        end, check = run(method, atol), run(checking, other)
        scale = MotionScale.of(problem.start, end.positions[0], problem.mean_radius)
        if scale.errors(check.positions[0], end.positions[0])[0] <= 0.2 * goals[-1]:
            break
        atol, other = 0.1 * atol, 0.1 * other
    shifts = [shift_starts(problem, PART * goal * scale.rms / np.sqrt(3.0)) for goal in goals]
    shifted = [run(method, 10.0 * atol, start).positions[0] for start in shifts]
    return {"end": end.positions[0], "check": check.positions[0], "shifted": np.array(shifted),
            "cost": end.cpu}  # fmt: skip


def _path(folder: Path | None, kind: str, about: list[Any]) -> Path:
    own = hashlib.sha256(Path(__file__).read_bytes() + json.dumps([kind, about]).encode())
    place = Path.home() / ".cache/multicell/tiles" if folder is None else folder
    return place / f"{own.hexdigest()[:32]}.npz"


def _load(path: Path) -> dict[str, Any]:
    with np.load(path, allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def _store(path: Path, arrays: dict[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    # two processes that share the work may make the same one
    part = path.with_name(f"{path.stem}.{os.getpid()}.npz")
    np.savez(part, **arrays)
    part.replace(path)
