"""Work–precision: error against cost of each method over a ladder of settings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from multicell.comparison.base import CLOCKS, Row
from multicell.comparison.ladders import (
    Ladder,
    Method,
    capable_methods,
    select_methods,
    settings,
    stiffness,
)
from multicell.comparison.measure import Effort, TimedPoint, climb, default_budget, time_again
from multicell.comparison.measured import Measurements, named_only, open_measurements
from multicell.comparison.norms import Metric, norms_with
from multicell.comparison.numbers import COMPARISON_FILES, NUMBERS_FILE
from multicell.comparison.record import sample_size
from multicell.comparison.reference import Reference, method_pair, reference, unsolved_problem
from multicell.comparison.result import WorkPrecision
from multicell.comparison.styles import unregistered_styles
from multicell.errors import SceneError
from multicell.integrators.base import Integrator
from multicell.integrators.shift import SHIFT
from multicell.results.folder import versions
from multicell.scene.bare import note_bare
from multicell.scene.scene import Scene, load_scene
from multicell.schema import near_miss
from multicell.units import to_base


def compare(
    scene: Scene | str | Path,
    methods: Sequence[str | Method | type[Integrator] | Integrator] | None = None,
    ladder: Ladder | None = None,
    output: str | Path | None = None,
    *,
    stepwise: bool | int = False,
    shift: float | str = SHIFT,
    clock: str = "cpu",
    metrics: Mapping[str, Metric] | None = None,
    references: Sequence[tuple[str, float] | tuple[Method, float]] | None = None,
    repeats: int = 3,
    patience: float = 10.0,
    budget: float | None = None,
    threads: int | None = None,
    overwrite: bool = False,
    progress: Callable[[str], None] | None = None,
) -> WorkPrecision:
    """Measure error and cost of integration methods on one scene.

    The scene is recorded once by the reference method; every method replays the same events at
    the same times (:mod:`multicell.comparison.replay`). The errors of a point come from one solve;
    its time is the minimum of several solves after that one.

    In a growing or driven population trajectories of any two methods part after a while. There
    compare step-wise: each of a sample of the run's coupling steps starts from the same recorded
    state for every method (:mod:`multicell.comparison.record`).

    Parameters
    ----------
    scene
        The scene, the name of a built-in one, or a TOML file.
    methods
        Names (:data:`multicell.integrators.registry.METHODS`), methods of the user's own (an
        object, a class or ``"file.py:Name"``) or :class:`Method` objects; by default all that can
        hold the scene.
    ladder
        Settings of the methods, see :func:`multicell.comparison.ladders.settings`.
    output
        Folder for the files of :meth:`WorkPrecision.save`.
    stepwise
        True to compare 24 of the run's coupling steps, or their number, each from its own
        recorded state; cost is the sum over them. False to compare the whole run.
    shift
        Size of the random shift of all positions that shows how well-conditioned single steps
        are (:mod:`multicell.comparison.conditioning`): root mean square of each coordinate, in
        µm or with a unit; 0 to leave it out. A whole run has none.
    clock
        Which time judges: ``"cpu"``, that of the processors, or ``"wall"``, which other load on
        the machine disturbs more. Both are measured.
    metrics
        Name -> function of the positions of all cells, (n, 3) µm, that returns a number in any
        unit. Its error is the largest difference from the reference over the common times or
        steps; the name serves as a norm of the result.
    references
        Two methods with their settings (see :func:`multicell.comparison.reference.reference`).
    repeats
        Number of timed solves of each point, of which the fastest counts. The first follows
        the solve that gives the error; the others go round all methods in turns.
    patience
        Wall time in s that one solve may take; a finer setting that is foreseen to take longer
        is skipped, one that does take longer fails at its next coupling step. The repeats of a
        point may take a fifth of it together.
    budget
        Wall time in s for all methods, divided among those that are left; finer settings than
        it allows are skipped. By default 60 s, or ten times what the reference took if that
        is longer.
    threads
        Number of threads, by default all.
    overwrite
        Whether the folder may hold something: files of an earlier comparison are replaced. A
        comparison that was ended early (a full disk, a kill) continues when it is asked for again:
        methods of the package are not measured twice.
    progress
        Called with a line of words for everything that is begun.

    Returns
    -------
    WorkPrecision

    Raises
    ------
    SceneError, OutputError
        For input that cannot be used, before anything is computed.
    StepFailed
        If the reference cannot be computed. Methods that fail are rows of the table.
    """
    described = scene if isinstance(scene, Scene) else load_scene(scene)
    count = sample_size(stepwise)
    if clock not in CLOCKS:
        raise SceneError("clock", f"is {clock!r}, must be {' or '.join(map(repr, CLOCKS))}")
    note_bare("shift", shift, "um")
    moved = to_base(shift, "um", "shift")
    if moved < 0.0:
        raise SceneError("shift", f"is {shift!r}, must be 0 um or more")
    note = progress or (lambda _: None)
    norms = norms_with(metrics)
    radius = unsolved_problem(described, threads).mean_radius
    asked = capable_methods(described) if methods is None else methods
    chosen = select_methods(asked, described, radius)
    pair = None if references is None else method_pair(references, described, radius)
    _check_ladder(chosen, ladder)
    what = {
        "ladder": ladder,
        "stepwise": count,
        "shift": moved,
        "clock": clock,
        "repeats": repeats,
        "patience": patience,
        "budget": budget,
        "threads": threads,
        "metrics": list(metrics or ()),
        "references": pair and [(m.name, s) for m, s in pair],
    }
    names = [method.name for method in chosen]
    given = [m for m, _ in references or ()]
    own = bool(metrics) or named_only(given) != given  # they may have changed since
    with open_measurements(
        output, COMPARISON_FILES, described, what, names, () if own else asked, overwrite=overwrite
    ) as measured:
        if output is not None and measured.has(names) and (Path(output) / NUMBERS_FILE).is_file():
            result = WorkPrecision.read(Path(output) / NUMBERS_FILE)
            result.save(output)  # what is made of it is all that was lacking
            return result
        exact = reference(
            described,
            pair=pair,
            stepwise=count,
            shift=moved,
            norms=norms,
            threads=threads,
            progress=note,
        )
        decay = stiffness(exact.problem, exact.trajectory)
        left = default_budget(exact.wall) if budget is None else budget
        table: list[Row] = []
        again: list[TimedPoint] = []
        for k, method in enumerate(chosen):
            rungs = settings(method, ladder, exact.problem, decay)
            effort = Effort(repeats, patience, left / (len(chosen) - k), len(rungs))
            rows, timed, spent = _measure(method, rungs, exact, effort, measured, note)
            table += rows
            again += timed
            left -= spent
        note("timing again, all methods in turns")
        time_again(again, exact.problem, repeats)
        named = [] if methods is None else names
        facts = {**_facts(exact, decay), "looks": unregistered_styles(chosen), "named": named}
        if metrics:
            facts["metrics"] = list(metrics)
        result = WorkPrecision(
            described, table, facts, exact.uncertainty, clock, exact.conditioning
        )
        if output is not None:
            result.save(output)
    return result


def _measure(
    method: Method,
    rungs: Sequence[float],
    exact: Reference,
    effort: Effort,
    measured: Measurements,
    note: Callable[[str], None],
) -> tuple[list[Row], list[TimedPoint], float]:
    """Do as :func:`climb`, from the folder where it was measured before."""
    known = measured.find(method.name)
    if known is not None:
        note(f"{method.name}: was measured before")
        rows = known["rows"]
        timed = [
            TimedPoint(rows[k], method, share, spent, [(wall, cpu) for wall, cpu in repeats])
            for k, share, spent, repeats in known["timed"]
        ]
        return rows, timed, known["spent"]
    rows, timed, spent = climb(method, rungs, exact, effort, note)
    places = {id(row): k for k, row in enumerate(rows)}
    points = [(places[id(point.row)], point.share, point.spent, point.repeats) for point in timed]
    measured.add(method.name, rows=rows, timed=points, spent=spent)
    return rows, timed, spent


def _facts(exact: Reference, decay: float) -> dict[str, Any]:
    """Return facts about the problem for readers of the chart."""
    problem = exact.problem
    return {
        "cells": [len(problem.start), int(problem.counts[-1])],
        "mode": problem.mode,
        "stepwise": problem.stepwise,
        "coupling_steps": len(problem.steps),
        "coupling_steps_in_all": problem.total,
        "steps_with_events": sum(step.before is not None for step in problem.steps),
        "time": float(problem.times[-1]),
        "mean_radius": problem.mean_radius,
        "largest_decay_rate": decay,
        "threads": int(getattr(problem.template, "threads", 1)),
        "reference": exact.words,
        "reference_wall": exact.wall,
        "versions": versions(),
    }


def _check_ladder(methods: Sequence[Method], ladder: Ladder | None) -> None:
    """Refuse a ladder for a method or control that is not compared."""
    known = {"tolerance", "step", *(method.name for method in methods)}
    for name in ladder or {}:
        if name not in known:
            raise SceneError(f"ladder.{name}", "is no method here", near_miss(name, known))
