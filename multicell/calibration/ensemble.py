"""Runs at points of a space of parameters, and what they come to."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final, final

import numpy as np

from multicell.errors import MulticellError, SceneError
from multicell.results.documents import read_table
from multicell.studies.cost import Cost, StudyCost, cost_of, together
from multicell.studies.limits import forecast_step
from multicell.studies.observed import continued, entry_of
from multicell.studies.runs import Run, digest
from multicell.studies.status import run_folder, status

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.scene.scene import Scene
    from multicell.studies.axes import Range
    from multicell.studies.task import Outcome

MOMENTS: Final = 24
"""How many times an observable is asked for in the course of the runs."""


@final
@dataclass(frozen=True)
class Observed:
    """What runs at n points with k seeds each come to.

    Attributes
    ----------
    final : name -> (n, k)
        Observables at the end of each run; NaN where a run failed or lacks one.
    times : (m,) s
    courses : name -> (n, k, m)
        Those that have a course, NaN after the end of a run.
    failures : name of a run -> reason
    """

    final: Mapping[str, FloatArray]
    times: FloatArray
    courses: Mapping[str, FloatArray]
    failures: Mapping[str, str] = field(default_factory=dict)


Evaluate = Callable[["FloatArray"], Observed]
"""From points of the unit cube, (n, parameters), to what runs there come to."""


@final
@dataclass(frozen=True)
class Ensemble:
    """The runs at points of the unit cube.

    Attributes
    ----------
    points : list of list of Run
        For each point one run for each seed; points that are the same have the same runs.
    costs : name of a run -> Cost
    """

    points: list[list[Run]]
    costs: Mapping[str, Cost]

    @property
    def runs(self) -> list[Run]:
        """All runs, each once."""
        return list({run.name: run for point in self.points for run in point}.values())

    def left(self, folder: Path, cores: int) -> StudyCost:
        """Return what the runs are expected to take that are not done."""
        open_ = [r for r in self.runs if status(r.name, folder, r.integrator).state != "done"]
        return together((self.costs[run.name] for run in open_), cores)


def ensemble(
    scene: Scene, ranges: Sequence[Range], shares: FloatArray, seeds: Sequence[int],
    folder: Path | None = None,
) -> Ensemble:  # fmt: skip
    """Return the runs at points of the unit cube, (n, parameters).

    What runs are expected to take is not worked out for points that are done in a ``folder``.

    Raises
    ------
    SceneError
        If the scene refuses the values of a point, which are then part of the text.
    """
    known: dict[tuple[float, ...], list[Run]] = {}
    costs: dict[str, Cost] = {}
    points = []
    step, cost = forecast_step(len(shares)), None
    for number, row in enumerate(shares):
        values = tuple(free.value(float(share)) for free, share in zip(ranges, row, strict=True))
        if values not in known:
            own = _at(scene, ranges, values)
            scenes = {digest(one): one for one in (replace(own, seed=seed) for seed in seeds)}
            there = folder is not None and all(_has_ended(folder, name) for name in scenes)
            if not there and (cost is None or number % step == 0):
                cost = cost_of(own)
            expected = Cost(0.0, 0.0, 0.0) if there or cost is None else cost
            place = {free.name: value for free, value in zip(ranges, values, strict=True)}
            known[values] = [
                Run(name, one, {**place, "seed": one.seed}, expected.seconds)
                for name, one in scenes.items()
            ]
            costs |= dict.fromkeys(scenes, expected)
        points.append(known[values])
    return Ensemble(points, costs)


def _has_ended(folder: Path, name: str) -> bool:
    """Return whether a run has left a summary; the engine looks whether it is whole."""
    return (run_folder(folder, name) / "summary.json").is_file()


def _at(scene: Scene, ranges: Sequence[Range], values: Sequence[float]) -> Scene:
    """Return the scene at a point."""
    pairs = list(zip(ranges, values, strict=True))
    try:
        return scene.with_changes({free.key: free.setting(value) for free, value in pairs})
    except SceneError as error:
        where = ", ".join(f"{free.key} = {value:.4g} {free.unit}".strip() for free, value in pairs)
        hint = error.hint or "Narrow the ranges."
        raise SceneError(error.path, f"{error.problem}, at {where}", hint) from None


def observe(
    asked: Ensemble,
    outcomes: Sequence[Outcome],
    folder: Path,
    observables: Sequence[str],
) -> Observed:
    """Return what finished runs come to, read from their folders.

    The viable rim of a population without a necrotic core is its radius, which is what it tends to
    as a core vanishes.

    Parameters
    ----------
    asked
        The runs.
    outcomes
        Of all runs.
    folder
        Of the study.
    observables
        Columns of histories, or dotted names of entries of summaries.
    """
    states = {outcome.name: outcome for outcome in outcomes}
    failures = {o.name: o.reason for o in outcomes if o.state == "failed"}
    read: dict[str, _Read] = {}
    runs = asked.points
    for run in asked.runs:
        if states[run.name].state != "done":
            continue
        try:
            read[run.name] = _read(run_folder(folder, run.name), observables)
        except MulticellError as error:
            failures[run.name] = str(error)
    times = _moments(read)
    shape = (len(runs), len(runs[0]))
    final = {name: np.full(shape, np.nan) for name in observables}
    with_course = [n for n in observables if any(n in one.history for one in read.values())]
    courses = {name: np.full((*shape, len(times)), np.nan) for name in with_course}
    for place, point in enumerate(runs):
        for seed, run in enumerate(point):
            if run.name in read:
                one = read[run.name]
                for name in observables:
                    final[name][place, seed] = one.last[name]
                for name in with_course:
                    courses[name][place, seed] = one.course(name, times)
    return Observed(final, times, courses, failures)


@final
@dataclass(frozen=True)
class _Read:
    """History and final values of one run."""

    time: FloatArray
    history: Mapping[str, FloatArray]
    last: Mapping[str, float]

    def course(self, name: str, times: FloatArray) -> FloatArray:
        """Return an observable at some times, linear between rows, NaN after the end."""
        # the last step may miss the end by rounding
        beyond = times > self.time[-1] * (1.0 + 1e-9)
        values = np.interp(times, self.time, self.history[name])
        return np.where(beyond, np.nan, values)


def _read(place: Path, observables: Sequence[str]) -> _Read:
    from multicell.results.reader import Contents

    columns = Contents(place).history()
    summary = read_table(place / "summary.json") or {}
    history = {name: continued(columns, name) for name in observables if name in columns}
    last = {
        name: float(history[name][-1]) if name in history else entry_of(summary, name)
        for name in observables
    }
    return _Read(columns["time"], history, last)


def _moments(read: Mapping[str, _Read]) -> FloatArray:
    """Return evenly spaced times up to the end of the longest run, without the start."""
    last = max((float(one.time[-1]) for one in read.values()), default=0.0)
    if last <= 0.0:
        return np.zeros(0)
    return np.asarray(np.linspace(0.0, last, MOMENTS + 1)[1:], dtype=np.float64)
