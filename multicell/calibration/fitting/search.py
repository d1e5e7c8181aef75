"""The best parameters in few runs: proposed by an emulator and by Optuna.

Points are tried in batches. The first ones are a Sobol' sequence; of each later batch most come
from an emulator (:mod:`~multicell.calibration.fitting.emulator`): its minimum, and draws from its
posterior, where another run is most informative. The rest are Optuna's (TPE), which needs no smooth
dependence and looks elsewhere too. All points have the same random numbers, so that differences
between them are differences of parameters.

Batches and readings are lines of one file, each written as soon as it is known, so that a search
that is stopped continues without a second run of anything. Optuna gets all that is known with each
batch.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from multicell.calibration.fitting.emulator import ENOUGH_DRAWS, Emulator, best_of, draws, emulator
from multicell.calibration.fitting.pool import Call, Pool
from multicell.calibration.fitting.problem import FitProblem, Misfit
from multicell.calibration.fitting.simulator import Reading
from multicell.errors import FitFailed, OutputError
from multicell.host.extras import needs, quiet
from multicell.measured.noise import Array
from multicell.results.documents import Lines

Point = tuple[float, ...]  # places in the ranges
Run = tuple[Point, int, int]
"""A point, the number of a condition, and a seed: what decides a reading."""

SEARCH: Final = "search.log"  # of a fit's folder: points and readings, also of fresh runs
BATCH: Final = 5  # points that are tried together, at least


@final
@dataclass(frozen=True, eq=False)
class Evaluation:
    """Evaluation of one set of parameters.

    - ``shares``, (d,): places in the ranges
    - ``misfit``: of its runs
    - ``loss``: -2 ln of likelihood and prior density
    - ``reasons``: why runs failed; empty if none did
    """

    shares: Array
    misfit: Misfit
    loss: float
    reasons: tuple[str, ...]


@final
class Search:
    """All that has been tried for a problem.

    - ``path``: file that keeps what was tried; None keeps it in memory
    - ``seed``: of the choice of points
    """

    def __init__(self, problem: FitProblem, path: Path | None, seed: int = 0) -> None:
        needs("optuna")
        self._problem = problem
        self._seed = seed
        self._points: list[Point] = []
        self._readings: dict[Run, Reading] = {}
        self._known: dict[int, Evaluation] = {}
        self._lines = None if path is None else Lines(path)
        for entry in () if self._lines is None else self._lines.entries:
            try:
                self._take(entry)
            except (KeyError, TypeError, ValueError) as error:
                raise OutputError(f"'{path}' is damaged: {error!r}") from error

    @property
    def readings(self) -> Mapping[Run, Reading]:
        """All runs that are known."""
        return self._readings

    def on(self, problem: FitProblem) -> Search:
        """Return the same points and runs, compared with the same data under other errors."""
        other = Search(problem, None, self._seed)
        other._points, other._readings = self._points, self._readings
        other._lines = self._lines
        return other

    def evaluations(self) -> list[Evaluation]:
        """Return all that is known, in order."""
        for number, shares in enumerate(self._points):
            if number not in self._known and not self._missing(self._runs([shares])):
                self._known[number] = self._evaluation(shares)
        return [self._known[number] for number in sorted(self._known)]

    def run(
        self,
        pool: Pool,
        points: int,
        progress: Callable[[int, int], None] | None = None,
    ) -> list[Evaluation]:
        """Go on until there are so many points; return all of them.

        - ``pool``: where runs are made
        - ``points``: number of points that are wanted in all
        - ``progress``: called with the numbers of runs done and wanted after each run
        """
        import optuna

        with quiet("optuna"), warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            self._finish(pool, progress, points)
            while (known := len(self.evaluations())) < points:
                self._refuse_failures()
                width = max(BATCH, math.ceil(pool.count / len(self._problem.tasks())))
                # one entry: a search that is stopped here has none of the batch, or all of it
                self._note({"points": self._next(min(width, points - known))})
                self._finish(pool, progress, points)
            self._refuse_failures()
            return self.evaluations()

    def extra(
        self,
        pool: Pool,
        points: Sequence[tuple[Sequence[float], int]],
        progress: Callable[[int, int], None] | None = None,
    ) -> tuple[Array, list[str]]:
        """Run all conditions once at each of some points, with a seed each.

        - ``pool``: where runs are made
        - ``points``: places in the ranges, and the seed there
        - ``progress``: called with the numbers of runs done and wanted after each run

        Returns readings, (points, n): on the scales of the data; NaN where a run has nothing;
        reasons: why runs failed.
        """
        conditions = range(len(self._problem.measured.conditions))
        runs = [(_point(shares), k, seed) for shares, seed in points for k in conditions]
        self._make(pool, runs, progress, len(runs))
        readings = {
            (k, row): self._readings[_point(shares), k, seed]
            for row, (shares, seed) in enumerate(points)
            for k in conditions
        }
        on_scales = {(k, row): self._problem.on_scales(k, r) for (k, row), r in readings.items()}
        reasons = [reading.reason for reading in readings.values() if reading.reason]
        return self._problem.runs(on_scales, range(len(points))), reasons

    def emulator(self) -> Emulator | None:
        """Return an emulator through the best points, None while there are too few."""
        known, problem = self.evaluations(), self._problem
        if not known:
            return None
        misfits, sigma = [e.misfit for e in known], problem.sigma
        more = 1.0 / problem.tissues + 1.0 / len(problem.seeds)
        return emulator(
            np.array([e.shares for e in known]),
            np.array([(m.means - problem.observed) / sigma for m in misfits]),
            np.array([m.scatter for m in misfits]) * more / sigma**2,
            np.array([m.loss for m in misfits]),
            observables=[datum.observable for datum in problem.measured.data],
            lowest=problem.lowest,
            noise=problem.noise,
            prior=problem.prior,
        )

    def _next(self, count: int) -> list[list[float]]:
        """Return the points of the next batch."""
        import optuna

        known, names = len(self._points), self._problem.names
        proposed = self._proposed(known, count)
        if len(proposed) == count:
            return proposed
        anywhere = optuna.distributions.FloatDistribution(0.0, 1.0)
        space: dict[str, Any] = dict.fromkeys(names, anywhere)
        sampler = optuna.samplers.TPESampler(
            seed=self._seed + known, multivariate=True, n_startup_trials=self._first_points
        )
        study = optuna.create_study(sampler=sampler)
        for found in self.evaluations():
            params = dict(zip(names, found.shares.tolist(), strict=True))
            study.add_trial(
                optuna.trial.create_trial(params=params, distributions=space, value=found.loss)
            )
        for shares in proposed:
            study.enqueue_trial(dict(zip(names, shares, strict=True)))
        trials = [study.ask(space) for _ in range(count)]
        points = np.array([[trial.params[name] for name in names] for trial in trials])
        kept = self._problem.prior.constraints.hold(points)
        if not kept.all():  # Optuna knows no constraints between parameters
            random = np.random.default_rng((self._seed, known))
            points[~kept] = self._problem.prior.draw(random, int((~kept).sum()))
        return points.tolist()  # type: ignore[no-any-return]

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
        likely = draws(found.loss, found.prior, self._seed + known, ENOUGH_DRAWS)
        best = best_of(found.loss, found.prior, likely)
        return [best.tolist(), *likely[: wanted - 1].tolist()]

    def _sobol(self) -> Array:
        from scipy.stats import qmc

        power, prior = max(math.ceil(math.log2(self._first_points + BATCH)), 6), self._problem.prior
        while True:
            sequence = qmc.Sobol(len(self._problem.ranges), rng=self._seed)
            found = prior.places(np.asarray(sequence.random_base2(power)))
            found = found[prior.constraints.hold(found)]
            if len(found) >= self._first_points + BATCH:
                return found
            power += 1  # constraints leave at least LEAST_SHARE_LEFT of the ranges

    def _runs(self, points: Sequence[Point]) -> list[Run]:
        """Return the runs that some points of the search take."""
        return [(shares, k, seed) for k, seed in self._problem.tasks() for shares in points]

    def _missing(self, runs: Sequence[Run]) -> list[Run]:
        return [run for run in dict.fromkeys(runs) if run not in self._readings]

    def _finish(self, pool: Pool, progress: Callable[[int, int], None] | None, points: int) -> None:
        """Make the runs of all points that are not known yet."""
        runs = self._runs(self._points)
        self._make(pool, runs, progress, max(points * len(self._problem.tasks()), len(runs)))

    def _make(
        self,
        pool: Pool,
        runs: Sequence[Run],
        progress: Callable[[int, int], None] | None,
        wanted: int,
    ) -> None:
        """Make those of some runs that are not known, and keep what they come to."""
        missing = self._missing(runs)
        done = len(runs) - len(missing)
        calls: list[Call] = [
            (run, self._problem.simulator, (list(run[0]), run[1], run[2])) for run in missing
        ]
        for run, reading in pool.results(calls):
            shares, condition, seed = run
            self._note(
                {
                    "shares": list(shares),
                    "condition": condition,
                    "seed": seed,
                    "values": [None if v != v else v for v in reading.values],
                    "reason": reading.reason,
                }
            )
            done += 1
            if progress is not None:
                progress(done, wanted)

    def _note(self, entry: Mapping[str, Any]) -> None:
        """Keep a batch of points or a reading."""
        if self._lines is not None:
            self._lines.append([entry])
        self._take(entry)

    def _take(self, entry: Mapping[str, Any]) -> None:
        if "points" in entry:
            self._points += map(_point, entry["points"])
            return
        values = tuple(math.nan if v is None else float(v) for v in entry["values"])
        run = _point(entry["shares"]), int(entry["condition"]), int(entry["seed"])
        self._readings[run] = Reading(values, str(entry["reason"]))

    def _evaluation(self, shares: Point) -> Evaluation:
        """Return the evaluation of a point."""
        tasks = self._problem.tasks()
        readings = {(k, seed): self._readings[shares, k, seed] for k, seed in tasks}
        known = {(k, seed): self._problem.on_scales(k, r) for (k, seed), r in readings.items()}
        reasons = tuple(reading.reason for reading in readings.values() if reading.reason)
        misfit, place = self._problem.misfit(known), np.array(shares)
        loss = misfit.loss + float(self._problem.prior.loss(place[None])[0])
        return Evaluation(place, misfit, loss, reasons)

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


def _point(shares: Sequence[float]) -> Point:
    return tuple(map(float, shares))
