"""Tables of what a few runs were compared for, such as a coarse scene with the fine one."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import numpy as np

from multicell.errors import SceneError
from multicell.host.extras import needs
from multicell.results.quantities import known_unit
from multicell.scene.bare import note_bare
from multicell.scene.coarsening import coarsen
from multicell.scene.scene import Scene, load_scene
from multicell.studies.limits import MAX_SEEDS, whole_between
from multicell.studies.readings import chosen_observables, read_final
from multicell.studies.study import study
from multicell.units import shown, to_base

if TYPE_CHECKING:
    import pandas

    from multicell.cells import FloatArray
    from multicell.studies.engine import RunOutcome
    from multicell.studies.study import Study

Row = dict[str, Any]


@final
@dataclass(frozen=True, eq=False)
class RunTable:
    """Numbers that follow from comparing runs, with their errors.

    Attributes
    ----------
    rows : list of dict
        All with the same columns.
    notes : list of str
        What the reader must know, such as runs that failed.
    facts : mapping
        Of the whole table, by name.
    """

    rows: list[Row]
    notes: list[str]
    facts: Mapping[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        return self.text()

    def to_pandas(self) -> pandas.DataFrame:
        """Return the rows as a ``DataFrame``; its ``attrs`` are the facts."""
        needs("pandas")
        import pandas

        frame = pandas.DataFrame(self.rows)
        frame.attrs = dict(self.facts)
        return frame

    def text(self) -> str:
        """Return the table with four digits, and its notes."""
        lines = [list(self.rows[0]), *([_word(x) for x in row.values()] for row in self.rows)]
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        table = ["  ".join(map(str.ljust, line, widths)).rstrip() for line in lines]
        return "\n".join([*table, *(f"Note: {note}" for note in self.notes)])


def _word(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def checked_times(scene: Scene, times: Sequence[Any] | None) -> FloatArray | None:
    """Return times in s; without any the ends of runs are meant."""
    if times is None:
        if scene.stop_cells is not None:
            problem = f"is {scene.stop_cells:,}: runs end at different times"
            raise SceneError("stop_cells", problem, "Give times, or remove it.")
        return None
    for time in times:
        note_bare("times", time, "s")
    found = np.array([to_base(time, "s", "times") for time in times])
    if not len(found) or found.min() < 0.0 or found.max() > scene.duration:
        problem = f"are {shown(times)}, must lie between 0 and {scene.duration:g} s"
        raise SceneError("times", problem, "Leave them out for the end of the run.")
    return found


@contextmanager
def folder_for(output: str | Path | None) -> Iterator[Path]:
    """Yield a folder for runs: the one that is given, or one that is removed afterwards."""
    if output is not None:
        yield Path(output)
        return
    with tempfile.TemporaryDirectory(prefix="multicell-") as place:
        yield Path(place)


def values_of(
    study: Study,
    observables: Sequence[str],
    times: FloatArray | None,
    cores: int | None,
    scheduler: str | None,
    progress: Callable[..., None] | None,
) -> tuple[dict[str, FloatArray], list[str]]:
    """Do the runs of a study; return observables as (points, seeds, times), and notes."""
    outcomes = study.run(cores, scheduler, progress)
    found, failures = read_final(outcomes, study.folder, observables, times)
    shape = (len(study.plan.points), study.plan.seeds, -1)
    first = next(iter(failures.values()), "")
    notes = [f"{len(failures)} runs failed, the first one: {first}"] if failures else []
    return {name: values.reshape(shape) for name, values in found.items()}, notes


def mean_and_error(values: FloatArray) -> tuple[float, float]:
    """Return the mean of what is known of (n,) values and its standard error; NaN without."""
    known = values[np.isfinite(values)]
    if len(known) < 2:
        return (float(known[0]) if len(known) else float("nan")), float("nan")
    return float(known.mean()), float(known.std(ddof=1) / np.sqrt(len(known)))


def compare_coarse(
    scene: Scene | str | Path,
    factor: float,
    observables: Sequence[str] | None = None,
    *,
    seeds: int = 8,
    times: Sequence[float | str] | None = None,
    output: str | Path | None = None,
    cores: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[RunOutcome], None] | None = None,
) -> RunTable:
    """Run a scene and its coarse one with several seeds, and compare their observables.

    Parameters
    ----------
    scene, factor
        As in :func:`multicell.coarsen`.
    observables
        Columns of the history, or at the end also dotted entries of the summary; by default the
        usual ones of the scene.
    seeds
        Runs of each, at least 2.
    times
        When; by default at the end.
    output
        Folder; runs in its ``fine`` and ``coarse`` are studies, and are not run again. By default
        the runs are not kept.
    cores, scheduler, progress
        As in :meth:`multicell.studies.study.Study.run`.

    Returns
    -------
    RunTable
        A row for each observable and time: mean of both with standard errors (``..._se``),
        ``difference`` (coarse - fine) and its part of the fine value. The facts hold the time that
        the runs took, ``fine_seconds`` and ``coarse_seconds``.

    Raises
    ------
    SceneError
        As :func:`multicell.coarsen`, and for observables and times that runs do not have.
    OutputError, MissingPackage, ClusterError
        As :func:`multicell.study` and :meth:`multicell.studies.study.Study.run`.
    """
    fine = scene if isinstance(scene, Scene) else load_scene(scene)
    scenes = {"fine": fine, "coarse": coarsen(fine, factor)}
    whole_between("seeds", seeds, 2, MAX_SEEDS, "It is the number of runs of each.")
    named, at = chosen_observables(fine, observables), checked_times(fine, times)
    found, notes, seconds = {}, [], {}
    with folder_for(output) as folder:
        for name, one in scenes.items():
            runs = study(one, output=folder / name, seeds=seeds)
            found[name], own = values_of(runs, named, at, cores, scheduler, progress)
            notes += [f"{name}: {note}" for note in own]
            seconds[f"{name}_seconds"] = float(np.nansum([s.wall for s in runs.status()]))
    rows = []
    for name in named:
        for t, time in enumerate([fine.duration] if at is None else at):
            mean, its = mean_and_error(found["fine"][name][0, :, t])
            other, error = mean_and_error(found["coarse"][name][0, :, t])
            apart = other - mean
            rows.append(
                {
                    "observable": name,
                    "unit": known_unit(name),
                    "time": float(time),
                    "fine": mean,
                    "fine_se": its,
                    "coarse": other,
                    "coarse_se": error,
                    "difference": apart,
                    "difference_se": float(np.hypot(its, error)),
                    "relative": apart / mean if mean else float("nan"),
                }
            )
    return RunTable(rows, notes, {"factor": float(factor), "seeds": seeds, **seconds})
