"""The best parameters in few runs: proposed by an emulator and by Optuna.

Points are tried in batches. The first ones are a Sobol' sequence; of each later batch most come
from an emulator (:mod:`multicell.calibration.emulator`): its minimum, and draws from its posterior,
which are where another run tells most. The rest are Optuna's (TPE), which needs no smooth
dependence and looks elsewhere too. All points have the same random numbers, so that differences
between them are differences of parameters.

Whatever is known is Optuna's storage: each run is an attribute of its trial as soon as it has
ended, so that a search that is stopped continues without a second run of anything.
"""

from __future__ import annotations

import math
import time as clock
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from multicell.calibration.distance import Array, Misfit
from multicell.calibration.emulator import FEW, Emulator, best_of, draws, emulator
from multicell.calibration.pool import Call, Pool
from multicell.calibration.problem import Problem
from multicell.calibration.simulator import Reading
from multicell.errors import FitFailed, OutputError
from multicell.extras import needs
from multicell.results.documents import Lines

BATCH: Final = 5
"""Points that are tried together, at least."""


@final
@dataclass(frozen=True, eq=False)
class Evaluation:
    """What was found for one set of parameters.

    Attributes
    ----------
    number
        In the order in which they were asked for.
    shares : (d,)
        Places in the ranges.
    misfit
        Of its runs.
    reasons
        Why runs failed; empty if none did.
    """

    number: int
    shares: Array
    misfit: Misfit
    reasons: tuple[str, ...]


@final
class Search:
    """All that has been tried for a problem.

    Parameters
    ----------
    problem
        What to fit.
    path
        File that keeps what was tried; None keeps it in memory.
    seed
        Of the choice of points.
    """

    def __init__(self, problem: Problem, path: Path | None, seed: int = 0) -> None:
        needs("optuna")
        self._problem = problem
        self._seed = seed
        with _quiet():
            import optuna

            self._study: Any = _study(path)
            distribution = optuna.distributions.FloatDistribution(0.0, 1.0)
        self._space = dict.fromkeys(problem.names, distribution)
        self._known: dict[int, Evaluation] = {}

    def evaluations(self) -> list[Evaluation]:
        """Return all that is known, in order."""
        from optuna.trial import TrialState

        for trial in self._study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,)):
            if trial.number not in self._known:
                self._known[trial.number] = self._evaluation(trial)
        return [self._known[number] for number in sorted(self._known)]

    def run(
        self,
        pool: Pool,
        points: int,
        *,
        deadline: float = math.inf,
        progress: Callable[[int, int], None] | None = None,
    ) -> list[Evaluation]:
        """Go on until there are so many points; return all of them.

        Parameters
        ----------
        pool
            Where runs are made.
        points
            Number of points that are wanted in all.
        deadline
            Time (as of ``time.monotonic``) after which no batch is begun.
        progress
            Called with the numbers of runs done and wanted after each run.

        Raises
        ------
        FitFailed
            If all runs of the first points fail.
        """
        with _quiet():
            self._finish(pool, self._open(), progress, points)
            while (known := len(self.evaluations())) < points and clock.monotonic() < deadline:
                self._refuse_failures()
                width = max(BATCH, math.ceil(pool.count / len(self._problem.tasks())))
                batch = self._ask(min(width, points - known))
                self._finish(pool, batch, progress, points)
            self._refuse_failures()
            return self.evaluations()

    def extra(
        self,
        pool: Pool,
        points: Sequence[tuple[Sequence[float], int]],
        progress: Callable[[int, int], None] | None = None,
    ) -> tuple[Array, list[str]]:
        """Run all conditions once at each of some points, with a seed each.

        Parameters
        ----------
        pool
            Where runs are made.
        points
            Places in the ranges, and the seed there.
        progress
            Called with the numbers of runs done and wanted after each run.

        Returns
        -------
        readings : (points, n)
            On the scales of the data; NaN where a run has nothing.
        reasons
            Why runs failed.
        """
        conditions = range(len(self._problem.measured.conditions))
        known: dict[tuple[int, int], Reading] = {}
        calls: list[Call] = []
        for row, (shares, seed) in enumerate(points):
            for condition in conditions:
                entry = self._study.user_attrs.get(f"extra {seed}:{condition}")
                if entry is not None and entry["shares"] == list(shares):
                    known[row, condition] = _reading(entry)
                else:
                    arguments = list(shares), condition, seed
                    calls.append(((row, condition), self._problem.simulator, arguments))
        for (row, condition), reading in pool.results(calls):
            shares, seed = points[row]
            entry = {"shares": list(shares), **_entry(reading)}
            self._study.set_user_attr(f"extra {seed}:{condition}", entry)
            known[row, condition] = reading
            if progress is not None:
                progress(len(known), len(points) * len(conditions))
        on_scales = {
            (condition, row): self._problem.on_scales(condition, reading)
            for (row, condition), reading in known.items()
        }
        reasons = [reading.reason for reading in known.values() if reading.reason]
        return self._problem.runs(on_scales, range(len(points))), reasons

    def emulator(self) -> Emulator | None:
        """Return an emulator through the best points, None while there are too few."""
        return emulator_of(self._problem, self.evaluations())

    def _ask(self, count: int) -> list[Any]:
        """Return the next trials."""
        import optuna

        known = len(self._planned())
        self._study.sampler = optuna.samplers.TPESampler(
            seed=self._seed + known, multivariate=True, n_startup_trials=self._first_points
        )
        trials = []
        for shares in self._proposed(known, count):
            self._study.enqueue_trial(dict(zip(self._problem.names, shares, strict=True)))
            trials.append(self._study.ask(self._space))
        trials += [self._study.ask(self._space) for _ in range(count - len(trials))]
        # a batch is begun once this is written: half of one is forgotten
        self._study.set_user_attr(f"batch {known}", [trial.number for trial in trials])
        return trials

    def _planned(self) -> set[int]:
        """Return the numbers of the trials of all batches that were begun."""
        known = self._study.user_attrs.items()
        batches = [numbers for name, numbers in known if name.startswith("batch ")]
        return {number for numbers in batches for number in numbers}

    @property
    def _first_points(self) -> int:
        """How many points are spread evenly before anything is concluded."""
        return max(2 * BATCH, 4 * len(self._problem.ranges))

    def _proposed(self, known: int, count: int) -> list[list[float]]:
        """Return the points of a batch that are not Optuna's."""
        if known < self._first_points:
            return self._sobol()[known : known + count].tolist()  # type: ignore[no-any-return]
        found = self.emulator()
        if found is None:
            return []
        wanted = max(1, count - max(1, count // 4))
        likely = draws(found.loss, found.dimensions, self._seed + known, FEW)
        best = best_of(found.loss, likely)
        return [best.tolist(), *likely[: wanted - 1].tolist()]

    def _sobol(self) -> Array:
        from scipy.stats import qmc

        sequence = qmc.Sobol(len(self._problem.ranges), rng=self._seed)
        power = math.ceil(math.log2(self._first_points + BATCH))
        return np.asarray(sequence.random_base2(max(power, 6)))

    def _open(self) -> list[Any]:
        """Return the trials that were begun and not ended, by a search that was stopped."""
        from optuna.trial import Trial, TrialState

        waiting = self._study.get_trials(deepcopy=False, states=(TrialState.WAITING,))
        for _ in waiting:  # each is handed out once, and not again
            self._study.ask()
        planned, begun = self._planned(), []
        for trial in self._study.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):
            if trial.number in planned:
                begun.append(Trial(self._study, trial._trial_id))
            else:
                self._study.tell(trial.number, state=TrialState.FAIL)
        return begun

    def _finish(
        self,
        pool: Pool,
        trials: Sequence[Any],
        progress: Callable[[int, int], None] | None,
        points: int,
    ) -> None:
        """Make the runs of some trials that are not known yet, and tell what they came to."""
        tasks = self._problem.tasks()
        missing = {trial.number: set(tasks) - set(_readings(trial)) for trial in trials}
        by_number = {trial.number: trial for trial in trials}
        for trial in trials:
            if not missing[trial.number]:
                self._tell(trial)
        calls: list[Call] = []
        for condition, seed in tasks:
            for trial in trials:
                if (condition, seed) in missing[trial.number]:
                    shares = [trial.params[name] for name in self._problem.names]
                    key = trial.number, condition, seed
                    calls.append((key, self._problem.simulator, (shares, condition, seed)))
        done = len(self.evaluations()) * len(tasks)
        done += sum(len(tasks) - len(m) for m in missing.values() if m)
        for (number, condition, seed), reading in pool.results(calls):
            _note(by_number[number], condition, seed, reading)
            missing[number].discard((condition, seed))
            if not missing[number]:
                self._tell(by_number[number])
            done += 1
            if progress is not None:
                progress(done, max(points * len(tasks), done))

    def _tell(self, trial: Any) -> None:
        found = self._evaluation(trial)
        self._study.tell(trial.number, found.misfit.loss)

    def _evaluation(self, trial: Any) -> Evaluation:
        """Return what a trial has come to."""
        readings, reasons = _readings(trial), []
        for reading in readings.values():
            if reading.reason:
                reasons.append(reading.reason)
        known = {
            (condition, seed): self._problem.on_scales(condition, reading)
            for (condition, seed), reading in readings.items()
        }
        shares = np.array([trial.params[name] for name in self._problem.names])
        return Evaluation(trial.number, shares, self._problem.misfit(known), tuple(reasons))

    def _refuse_failures(self) -> None:
        """Refuse to continue where no run succeeds."""
        known = self.evaluations()
        if len(known) < BATCH or any(np.isfinite(e.misfit.means).any() for e in known):
            return
        reasons = [reason for e in known for reason in e.reasons]
        said = max(set(reasons), key=reasons.count) if reasons else "they have none of the data"
        raise FitFailed(
            f"no run of the first {len(known)} sets of parameters gives any of the data: {said}",
            "See whether the scene runs as it is, and whether the ranges make sense.",
        )


def emulator_of(problem: Problem, evaluations: Sequence[Evaluation]) -> Emulator | None:
    """Return an emulator through the best of some evaluations, None if there are too few."""
    if not evaluations:
        return None
    misfits = [e.misfit for e in evaluations]
    sigma = problem.sigma
    more = 1.0 / problem.tissues + 1.0 / len(problem.seeds)
    return emulator(
        np.array([e.shares for e in evaluations]),
        np.array([(m.means - problem.observed) / sigma for m in misfits]),
        np.array([m.scatter for m in misfits]) * more / sigma**2,
        np.array([m.loss for m in misfits]),
        observables=[datum.observable for datum in problem.measured.data],
        lowest=problem.lowest,
    )


def _study(path: Path | None) -> Any:
    """Return Optuna's study, from a file if there is one; that is locked by the caller."""
    import optuna
    from optuna.storages import JournalStorage
    from optuna.storages.journal import BaseJournalBackend

    class Checked(BaseJournalBackend):
        """Optuna's log in lines with checksums; one process at a time has it."""

        def __init__(self, lines: Lines) -> None:
            self._lines = lines

        def read_logs(self, log_number_from: int) -> list[Any]:
            return deepcopy(self._lines.entries[log_number_from:])

        def append_logs(self, logs: list[dict[str, Any]]) -> None:
            self._lines.append(logs)

    if path is None:
        return optuna.create_study(study_name="fit")
    lines = Lines(path)
    try:
        storage = JournalStorage(Checked(lines))
        return optuna.create_study(storage=storage, study_name="fit", load_if_exists=True)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise OutputError(f"'{path}' is damaged: {error}") from error


def _note(trial: Any, condition: int, seed: int, reading: Reading) -> None:
    """Keep the reading of a run with its trial."""
    trial.set_user_attr(f"{condition}:{seed}", _entry(reading))


def _entry(reading: Reading) -> dict[str, Any]:
    """Return a reading as JSON has it."""
    values = [None if math.isnan(v) else v for v in reading.values]
    return {"values": values, "reason": reading.reason}


def _reading(entry: Mapping[str, Any]) -> Reading:
    """Return the reading that an entry holds."""
    values = tuple(math.nan if v is None else float(v) for v in entry["values"])
    return Reading(values, entry["reason"])


def _readings(trial: Any) -> dict[tuple[int, int], Reading]:
    """Return the readings that a trial has."""
    attributes: Mapping[str, Any] = trial.user_attrs
    found = {}
    for name, entry in attributes.items():
        condition, _, seed = name.partition(":")
        found[int(condition), int(seed)] = _reading(entry)
    return found


@contextmanager
def _quiet() -> Iterator[None]:
    """Let Optuna say nothing: what matters is said in words of our own."""
    import optuna

    level = optuna.logging.get_verbosity()
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            yield
    finally:
        optuna.logging.set_verbosity(level)
