"""What the runs of an analysis come to: observables at their ends, and over time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Final, final

import numpy as np

from multicell.errors import MulticellError
from multicell.results.documents import read_table
from multicell.studies.observed import continued, entry_of
from multicell.studies.status import run_folder
from multicell.studies.table import at_times

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.studies.task import Outcome

TIMES: Final = 24
"""How many times an observable is asked for in the course of the runs."""


@final
@dataclass(frozen=True)
class Responses:
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

    def at(self, rows: Sequence[int]) -> Responses:
        """Return the responses of some points, which may be named more than once."""
        places = list(rows)
        return Responses(
            {name: values[places] for name, values in self.final.items()},
            self.times,
            {name: values[places] for name, values in self.courses.items()},
            self.failures,
        )


Evaluate = Callable[["FloatArray"], Responses]
"""From points of the unit cube, (n, parameters), to what runs there come to."""


def responses_of(
    outcomes: Sequence[Outcome], seeds: int, folder: Path, observables: Sequence[str]
) -> Responses:
    """Return what finished runs come to, read from their folders one at a time.

    The viable rim of a population without a necrotic core is its radius, which is what it tends to
    as a core vanishes.

    Parameters
    ----------
    outcomes
        Of all runs of a study: those of one point after the other, each with all its seeds.
    seeds
        Runs of each point.
    folder
        Of the study.
    observables
        Columns of histories, or dotted names of entries of summaries.
    """
    failures = {o.name: o.reason for o in outcomes if o.state == "failed"}
    histories: list[Mapping[str, FloatArray]] = []
    final = {name: np.full(len(outcomes), np.nan) for name in observables}
    for number, outcome in enumerate(outcomes):
        history: Mapping[str, FloatArray] = {}
        if outcome.state == "done":
            try:
                history, last = _read(run_folder(folder, outcome.name), observables)
                for name in observables:
                    final[name][number] = last[name]
            except MulticellError as error:
                failures[outcome.name] = str(error)
        histories.append(history)
    end = max((float(history["time"][-1]) for history in histories if history), default=0.0)
    times = np.linspace(0.0, end, TIMES + 1)[1:] if end > 0.0 else np.zeros(0)
    shape = len(outcomes) // seeds, seeds
    courses = {}
    for name in (n for n in observables if any(n in history for history in histories)):
        rows = [_course(history, name, times) for history in histories]
        courses[name] = np.array(rows).reshape(*shape, len(times))
    ends = {name: values.reshape(shape) for name, values in final.items()}
    return Responses(ends, times, courses, failures)


def _course(history: Mapping[str, FloatArray], name: str, times: FloatArray) -> FloatArray:
    """Return an observable at some times, NaN after the end of a run and without one."""
    if not history:
        return np.full(len(times), np.nan)
    last = history["time"][-1]
    # the last step may miss the end by rounding
    at = np.where(np.isclose(times, last, rtol=1e-9, atol=0.0), last, times)
    return at_times(at, history["time"], history[name])


def _read(
    place: Path, observables: Sequence[str]
) -> tuple[dict[str, FloatArray], dict[str, float]]:
    """Return the history of a run as far as it is asked for, and its final values."""
    from multicell.results.reader import Contents

    columns = Contents(place).history()
    summary = read_table(place / "summary.json") or {}
    history = {name: continued(columns, name) for name in observables if name in columns}
    last = {
        name: float(history[name][-1]) if name in history else entry_of(summary, name)
        for name in observables
    }
    return {"time": columns["time"], **history}, last
