"""Read the observables at the ends of the runs of an analysis."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, final

import numpy as np

from multicell.errors import MulticellError
from multicell.results.documents import read_table
from multicell.studies.observed import continued, entry_of
from multicell.studies.status import run_folder

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.studies.task import Outcome


@final
@dataclass(frozen=True)
class Responses:
    """Observables at the ends of runs at n points with k seeds each.

    Attributes
    ----------
    final : name -> (n, k)
        Observables at the end of each run; NaN where a run failed or lacks one.
    failures : name of a run -> reason
    """

    final: Mapping[str, FloatArray]
    failures: Mapping[str, str] = field(default_factory=dict)

    def at(self, rows: Sequence[int]) -> Responses:
        """Return the responses of some points, which may be named more than once."""
        places = list(rows)
        final = {name: values[places] for name, values in self.final.items()}
        return Responses(final, self.failures)


Evaluate = Callable[["FloatArray"], Responses]
"""From points of the unit cube, (n, parameters), to the observables there."""


def responses_of(
    outcomes: Sequence[Outcome], seeds: int, folder: Path, observables: Sequence[str]
) -> Responses:
    """Return the observables of finished runs, read from their folders one at a time.

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
    final = {name: np.full(len(outcomes), np.nan) for name in observables}
    for number, outcome in enumerate(outcomes):
        if outcome.state != "done":
            continue
        try:
            last = _read(run_folder(folder, outcome.name), observables)
        except MulticellError as error:
            failures[outcome.name] = str(error)
            continue
        for name in observables:
            final[name][number] = last[name]
    shape = len(outcomes) // seeds, seeds
    return Responses({name: values.reshape(shape) for name, values in final.items()}, failures)


def _read(place: Path, observables: Sequence[str]) -> dict[str, float]:
    """Return the final values of a run."""
    from multicell.results.reader import Contents

    history = Contents(place).history()
    summary = read_table(place / "summary.json") or {}
    return {
        name: float(continued(history, name)[-1]) if name in history else entry_of(summary, name)
        for name in observables
    }
