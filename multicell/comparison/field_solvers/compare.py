"""Error against cost of solvers of a scene's fields, and where each of them fails."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final, NamedTuple, final

from multicell.comparison.field_solvers.equations import (
    BACKENDS,
    SHELLS,
    Layout,
    geometries,
    grids,
    node_count,
    own_spacing,
)
from multicell.comparison.field_solvers.measure import TRIAL_PATIENCE, Bench, stability_rows
from multicell.comparison.field_solvers.problems import KINDS, TRANSIENT, Case, case
from multicell.comparison.field_solvers.reference import of_grids, on_one_grid
from multicell.comparison.field_solvers.result import FieldComparison, all_files
from multicell.comparison.field_solvers.solvers import DIRECT, SOLVERS, FieldSolver, select_names
from multicell.comparison.files import CLOCKS, Row, prepare
from multicell.comparison.measure import Effort
from multicell.errors import NutrientFailed, SceneError
from multicell.results.folder import versions
from multicell.results.frame import Frame
from multicell.scene.scene import Scene, load_scene
from multicell.simulation import Simulation
from multicell.units import to_base

SPACINGS: Final = 3
MAX_NODES: Final = 60_000
"""Nodes of a grid above which its own error is measured, but not the solvers'."""

_MIN_MAP_NODES = 20
"""Nodes of the grid of the stability map at least, where there are as many."""

_MIN_PATIENCE = 0.5
"""Wall time in s that a first point may take however short the budget is."""

_RUNGS = 6  # of a ladder, about

_LOOPING = (
    "py-pde judges the iteration in a loop over the nodes, which is tens of times faster with "
    "--backend numba"
)

Tell = Callable[[str], None]


def compare_fields(
    scene: Scene | str | Path,
    output: str | Path | None = None,
    *,
    solvers: Sequence[str] | None = None,
    fields: Sequence[str] | None = None,
    at: float | str | None = None,
    frame: Frame | None = None,
    spacings: int = SPACINGS,
    backend: str = "kernels",
    clock: str = "cpu",
    repeats: int = 3,
    patience: float = 5.0,
    budget: float = 240.0,
    stability: bool = True,
    threads: int | None = None,
    overwrite: bool = False,
    progress: Tell | None = None,
) -> FieldComparison:
    """Measure error and cost of solvers of a scene's fields, each field alone.

    Three problems with the cells as they are: the steady state; a transient from the medium's
    concentration everywhere, over twice the time in which the slowest deviation falls to 1/e; and
    a coupling step, once that time before whose end the medium falls to half. On cubes and, where
    the tissue is a ball, on shells (squares in two dimensions), each at a ladder of spacings.
    Errors are the largest at any node, over the highest concentration. The error of a solver is
    against the same equation on the same grid, that of a grid against finer ones.

    Parameters
    ----------
    scene
        The scene, the name of a built-in one, or a TOML file.
    output
        Folder for the files of :meth:`FieldComparison.save`.
    solvers
        Names of :data:`multicell.comparison.field_solvers.solvers.SOLVERS`; absent: all.
    fields
        Names of fields; absent: all of the scene.
    at
        Time to which the scene is run first, s or with a unit; absent: its start.
    frame
        A frame of a run of the scene, in place of running it.
    spacings
        Number of nested grids: about twice the field's own spacing, its own, half of it, ...
    backend
        How rates are evaluated for py-pde's solvers (:data:`BACKENDS`). ``"numba"`` compiles for
        seconds for every solver, step and grid, which is not part of the times, and its solves
        cannot be stopped by ``patience``.
    clock
        Which time judges: ``"cpu"`` or ``"wall"``. Both are measured.
    repeats
        Number of timed solves of each point, of which the median counts.
    patience
        Wall time in s that one solve may take.
    budget
        Wall time in s for all solvers, divided among what is left; finer settings than it allows
        are skipped.
    stability
        Whether to find out where each solver fails, as steps and uptake grow.
    threads
        Number of threads of a run ``at`` a time.
    overwrite
        Whether the folder may hold something: files of an earlier comparison are replaced.
    progress
        Called with a line of words for everything that is begun.

    Raises
    ------
    SceneError, OutputError
        For input that cannot be used, before anything is computed.
    StepFailed
        If the run to ``at`` fails. Solvers that fail are rows of the table.
    """
    described = scene if isinstance(scene, Scene) else load_scene(scene)
    if not described.nutrients:
        problem = "are none: the scene has no fields whose solvers could be compared"
        raise SceneError("nutrients", problem)
    names = select_names("fields", fields, described.nutrients, "field of the scene")
    wanted = [
        SOLVERS[name] for name in select_names("solvers", solvers, SOLVERS, "solver of fields")
    ]
    _check(clock, backend, spacings)
    tell = progress or (lambda _: None)
    time = None if at is None else _time(at, described)
    if at is not None and frame is not None:
        raise SceneError("at", "is given beside a frame, which has a time of its own")
    prepare(output, all_files(), overwrite)
    taken = frame or frame_at(described, time, threads, tell)
    race = _Race(described, taken, wanted, backend, Effort(repeats, patience, budget, _RUNGS), tell)
    looping = [solver.name for solver in wanted if solver.iterates]
    if looping and backend != "numba":
        race.notes.append(f"{' and '.join(looping)}: {_LOOPING}")
    ladders = list(race.ladders(names, spacings))
    race.run(ladders)
    failures = race.failures(ladders) if stability else []
    facts = {
        "cells": len(taken.cells), "time": taken.time, "backend": backend,
        "backend_words": BACKENDS[backend], "notes": list(dict.fromkeys(race.notes)),
        "trial_patience": TRIAL_PATIENCE * patience,
        "spacing": {name: own_spacing(described, name) for name in names},
        "solvers": {solver.name: solver.words for solver in wanted}, "versions": versions(),
    }  # fmt: skip
    result = FieldComparison(described, race.table, race.grid_table, failures, facts, clock)
    if output is not None:
        result.save(output)
    return result


def _check(clock: str, backend: str, spacings: int) -> None:
    if clock not in CLOCKS:
        raise SceneError("clock", f"is {clock!r}, must be {' or '.join(map(repr, CLOCKS))}")
    if backend not in BACKENDS:
        raise SceneError("backend", f"is {backend!r}, must be one of {', '.join(BACKENDS)}")
    if not 1 <= spacings <= 6:
        raise SceneError("spacings", f"is {spacings!r}, must be 1 to 6")


def _time(at: float | str, scene: Scene) -> float:
    """Return a time within the scene's duration, s."""
    time = to_base(at, "s", "at")
    if not (math.isfinite(time) and time >= 0.0):
        raise SceneError("at", f"is {at!r}, must be a time of 0 s or more")
    if time > scene.duration:
        problem = f"is {time:g} s, after the end of the scene ({scene.duration:g} s)"
        raise SceneError("at", problem, "Set a longer duration.")
    return time


def frame_at(scene: Scene, time: float | None, threads: int | None, tell: Tell) -> Frame:
    """Return the frame of a scene at its start, or at the first coupling time from ``time`` on.

    Raises
    ------
    StepFailed
    """
    simulation = Simulation(scene, threads=threads)
    if time:
        tell(f"running the scene to {time:g} s")
    while time and simulation.time < time and not simulation.finished:
        simulation.step()
    return simulation.frame()


class _Ladder(NamedTuple):
    """Nested grids of one geometry for one field, from coarse to fine."""

    field: str
    geometry: str
    layouts: list[Layout]


@final
@dataclass
class _Race:
    """All solvers on all problems, and what is left of the time for them.

    Attributes
    ----------
    effort : Effort
        Its budget is the wall time for all solvers.
    notes
        What is left out and why.
    series
        Solvers on problems that are still to come.
    table, grid_table
        Rows of the solvers, and of the grids' own errors.
    """

    scene: Scene
    frame: Frame
    solvers: Sequence[FieldSolver]
    backend: str
    effort: Effort
    tell: Tell
    notes: list[str] = field(default_factory=list)
    series: int = 0
    table: list[Row] = field(default_factory=list)
    grid_table: list[Row] = field(default_factory=list)

    def ladders(self, names: Sequence[str], spacings: int) -> Iterator[_Ladder]:
        """Yield the grids of each field and geometry."""
        for name in names:
            found = geometries(self.scene, self.frame, name)
            if SHELLS not in found and self.scene.dimensions == 3:
                why = "the tissue is no ball, or its sides differ"
                self.notes.append(f"{name} has no shells here: {why}")
            for geometry in found:
                try:
                    layouts = grids(self.scene, self.frame, name, geometry, spacings)
                    yield _Ladder(name, geometry, layouts)
                except NutrientFailed as trouble:
                    self.notes.append(f"{name} has no {geometry}: {trouble}")

    def run(self, ladders: Sequence[_Ladder]) -> None:
        """Solve all problems.

        Raises
        ------
        SceneError
            If none can be posed.
        """
        rungs = sum(len(ladder.layouts) for ladder in ladders)
        self.series = len(KINDS) * rungs * len(self.solvers)
        for ladder, kind in itertools.product(ladders, KINDS):
            self._climb(ladder, kind)
        if not self.table:
            problem = "; ".join(self.notes) or "have no problem that can be posed"
            raise SceneError("nutrients", problem)

    def _climb(self, ladder: _Ladder, kind: str) -> None:
        """Solve one problem on a ladder of grids."""
        name, geometry, layouts = ladder
        self.tell(f"{name}, {kind}: errors of {geometry}")
        try:
            errors = of_grids(self.scene, self.frame, name, kind, layouts)
        except (NutrientFailed, SceneError) as trouble:
            self.notes.append(f"{name}, {kind}, on {geometry} is left out: {trouble}")
            self.series -= len(layouts) * len(self.solvers)
            return
        for layout, (error, uncertainty) in zip(layouts, errors, strict=True):
            nodes = node_count(layout)
            self.grid_table.append(
                {
                    "field": name, "geometry": geometry, "spacing": layout.spacing, "nodes": nodes,
                    "problem": kind, "error": error, "uncertainty": uncertainty,
                }
            )  # fmt: skip
            if nodes > MAX_NODES:
                self.notes.append(f"solvers are not compared on more than {MAX_NODES:,} nodes")
                self.series -= len(self.solvers)
            else:
                self._solve(case(self.scene, self.frame, name, kind, layout), error)

    def _solve(self, problem: Case, space_error: float) -> None:
        """Let all solvers try one problem on one grid."""
        bench = Bench(problem, on_one_grid(problem), self.backend)
        for solver in self.solvers:
            share = self.effort.budget / max(self.series, 1)
            longest = min(self.effort.patience, max(_MIN_PATIENCE, 3.0 * share))
            effort = replace(self.effort, patience=longest, budget=share)
            rows, spent = bench.climb(solver, effort, self.tell)
            if (why := solver.refusal(problem)) and solver.kind != DIRECT:
                self.notes.append(f"{solver.name} is left out of {problem.name}: {why}")
            self.table += [{**row, "space_error": space_error} for row in rows]
            self.effort = replace(self.effort, budget=self.effort.budget - spent)
            self.series -= 1

    def failures(self, ladders: Sequence[_Ladder]) -> list[Row]:
        """Return where solvers fail: in the smallest transient of the first field taken up."""
        eaten = [x for x in ladders if self.scene.nutrients[x.field].takes_up]
        if not eaten or not len(self.frame.cells):
            self.notes.append("no stability map: no cell takes up any field")
            return []
        name = eaten[0].field
        layouts = [layout for x in eaten if x.field == name for layout in x.layouts]
        layouts.sort(key=node_count)
        large = [layout for layout in layouts if node_count(layout) >= _MIN_MAP_NODES]
        try:
            problem = case(self.scene, self.frame, name, TRANSIENT, (large or layouts)[0])
        except (NutrientFailed, SceneError) as trouble:
            self.notes.append(f"no stability map: {trouble}")
            return []
        patience = self.effort.patience
        return stability_rows(problem, self.solvers, self.backend, patience, self.tell)
