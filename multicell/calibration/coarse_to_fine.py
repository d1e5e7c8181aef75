"""Fits whose search runs coarse scenes, corrected by a few fine runs.

1. A fit with coarse runs alone (:func:`multicell.coarsen`) finds where the parameters are.
2. Fine runs at draws from its intervals, and coarse ones beside them, give for each datum the ratio
   of fine to coarse.
3. The search continues with coarse readings times that ratio, those that are there and some more.
   Its runs with fresh seeds, at the best point and at draws from the intervals, are fine ones:
   scatter and likelihood are those of the fine scene, and where ratios do not hold the intervals
   are widened, as where an emulator is wrong.

A ratio leaves zero at zero: a core that has not begun stays so.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from multicell.calibration.fit_plan import BESIDE, FURTHER, PAIRS, write_result
from multicell.calibration.likelihood import MAX_REPEATS, MIN_REPEATS
from multicell.calibration.pool import open_pool
from multicell.calibration.search import Run, Search, entry_of
from multicell.calibration.simulator import Reading, Simulator
from multicell.errors import FitFailed, SceneError

if TYPE_CHECKING:
    from multicell.calibration.fit_plan import FitPlan, Progress
    from multicell.calibration.fitted import Fit

MIN_POINTS: Final = 10


@final
@dataclass(frozen=True)
class Corrected:
    """Coarse readings times ratios for the seeds of a search, fine ones for all others.

    - ``coarse``, ``fine``: the simulators
    - ``seeds``: of the search
    - ``ratios``: for each datum of each condition
    """

    coarse: Simulator
    fine: Simulator
    seeds: tuple[int, ...]
    ratios: tuple[tuple[float, ...], ...]

    @property
    def stated(self) -> dict[str, Any]:
        """What decides its readings besides the scene."""
        of_coarse = getattr(self.coarse, "stated", {})
        return {**of_coarse, "ratios": [list(row) for row in self.ratios]}

    def __call__(self, shares: Sequence[float], condition: int, seed: int) -> Reading:
        """Return what a run gives; see :class:`multicell.calibration.simulator.Simulator`."""
        if seed not in self.seeds:
            return self.fine(shares, condition, seed)
        return self.corrected(self.coarse(shares, condition, seed), condition)

    def corrected(self, found: Reading, condition: int) -> Reading:
        """Return a coarse reading times the ratios."""
        values = np.multiply(found.values, self.ratios[condition])
        return replace(found, values=tuple(values.tolist()))


def coarse_simulator(simulator: Simulator, factor: float) -> Simulator:
    """Return the simulator of coarse runs."""
    made_coarse = getattr(simulator, "made_coarse", None)
    if made_coarse is None:
        raise SceneError("coarse", "needs the runs of a scene, not a simulator of one's own")
    found: Simulator = made_coarse(factor)
    return found


def fit_coarse_first(
    plan: FitPlan,
    carry_out: Callable[..., Fit],
    output: str | Path | None,
    *,
    cores: int | None,
    scheduler: str | None,
    overwrite: bool,
    progress: Progress | None,
) -> Fit:
    """Carry out a fit with a ``coarse`` factor by two without; parameters as of `carry_out`.

    The folder holds the first fit as ``coarse`` and the result as ``fine``.
    """
    note = progress or (lambda what, done, wanted: None)
    fine = plan.problem.simulator
    coarse = coarse_simulator(fine, plan.coarse)
    options: dict[str, Any] = {"cores": cores, "scheduler": scheduler, "overwrite": overwrite}

    def fitted(name: str, simulator: Simulator, **changes: Any) -> Fit:
        problem = replace(plan.problem, simulator=simulator)
        part = replace(plan, coarse=1.0, problem=problem, **changes)

        def told(what: str, done: int, wanted: int) -> None:
            note(f"{name}: {what}", done, wanted)

        return carry_out(part, output=folder / name, progress=told, **options)

    with ExitStack() as stack:
        if output is None:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="multicell-")))
        else:
            folder = Path(output)
        first = fitted("coarse", coarse, repeats=MIN_REPEATS)
        simulators = {"fine": fine, "coarse": coarse}
        runs = _pairs(first, simulators, folder / "coarse", note, cores, scheduler)
        seeds, ratios = plan.problem.seeds, _ratios(runs)
        corrected = Corrected(coarse, fine, seeds, ratios)
        found = fitted(
            "fine", corrected, points=max(MIN_POINTS, plan.points // FURTHER),
            adopted=_entries(first, corrected),
        )  # fmt: skip
        made = [key for key in found.readings if key not in first.readings]
        counts = {name: sum(map(len, beside)) for name, beside in runs.items()}
        counts["coarse"] += len(first.readings) + sum(key[2] in seeds for key in made)
        counts["fine"] += sum(key[2] not in seeds for key in made)
        facts = {**found.facts, "coarse": _account(plan, counts, ratios)}
        found = replace(found, facts=facts, folder=None if output is None else found.folder)
        if output is not None:
            write_result(found, folder / "fine")
            found.report()
        return found


def _account(
    plan: FitPlan, counts: Mapping[str, int], ratios: Sequence[Sequence[float]]
) -> dict[str, Any]:
    """Return what the fit is expected to have cost, and what fine runs alone would have."""
    seconds = {"fine": plan.seconds_a_run(1.0), "coarse": plan.seconds_a_run(plan.coarse)}
    spent = sum(counts[name] * seconds[name] for name in counts)
    alone = plan.runs * seconds["fine"]
    words = (
        f"The search made {counts['coarse']} coarse runs (factor {plan.coarse:g}), corrected by "
        f"{counts['fine']} fine ones: by forecast {spent:,.0f} s of CPU, where the {plan.runs} "
        f"runs of the same fit would take {alone:,.0f} s."
    )
    return {
        "factor": plan.coarse, "runs": dict(counts), "seconds_a_run": seconds,
        "seconds": spent, "fine_runs_alone": plan.runs, "fine_seconds_alone": alone,
        "saved": 1.0 - spent / alone if alone > 0.0 else float("nan"),
        "ratios": [list(row) for row in ratios], "words": words,
    }  # fmt: skip


def _entries(first: Fit, corrected: Corrected) -> list[dict[str, Any]]:
    """Return the search of a fit as entries of a log, with corrected readings."""
    points = [e.shares.tolist() for e in first.evaluations]
    runs = [(tuple(shares), k, seed) for shares in points for k, seed in first.problem.tasks()]
    readings = (corrected.corrected(first.readings[run], run[1]) for run in runs)
    entries = [entry_of(*pair, reused=True) for pair in zip(runs, readings, strict=True)]
    return [{"points": points, "reused": True}, *entries]


def _pairs(
    first: Fit, simulators: Mapping[str, Simulator], folder: Path, note: Progress,
    cores: int | None, scheduler: str | None,
) -> dict[str, list[dict[Run, Reading]]]:  # fmt: skip
    """Return the readings of fine and coarse runs at draws from a fit, by condition."""
    if first.sample is None:
        raise FitFailed("too few points were tried with coarse runs", "Take a larger budget.")
    shares, weights = first.sample
    likely = np.interp((np.arange(PAIRS) + 0.5) / PAIRS, np.cumsum(weights), np.arange(len(shares)))
    draws = shares[np.round(likely).astype(int)].tolist()
    begin = max(first.problem.seeds) + 1 + 10 * MAX_REPEATS
    found = {}
    with open_pool(cores, scheduler) as pool:
        for name, count in (("fine", 1), ("coarse", BESIDE)):
            points = [(draw, begin + row * BESIDE + k)
                      for row, draw in enumerate(draws) for k in range(count)]  # fmt: skip
            problem = replace(first.problem, simulator=simulators[name])
            search = Search(problem, folder / f"{name}.log")
            search.extra(pool, points, partial(note, f"{name} runs beside each other"))
            found[name] = [
                {
                    run: search.readings[run]
                    for draw, seed in points
                    for run in [(tuple(draw), k, seed)]
                }
                for k in range(len(problem.measured.conditions))
            ]
    return found


def _ratios(runs: Mapping[str, Sequence[Mapping[Run, Reading]]]) -> tuple[tuple[float, ...], ...]:
    """Return mean fine over mean coarse readings of each datum, by condition."""
    found = []
    for fine, coarse in zip(runs["fine"], runs["coarse"], strict=True):
        means = []
        for name, readings in (("fine", fine), ("coarse", coarse)):
            rows = np.array([reading.values for reading in readings.values()])
            count = np.isfinite(rows).sum(axis=0)
            if not count.any():
                words = f"no {name} run at draws from the first fit has any of the data"
                raise FitFailed(words, "See whether the ranges make sense.")
            means.append(np.nansum(rows, axis=0) / np.maximum(count, 1))
        ratio = np.ones_like(means[0])
        np.divide(means[0], means[1], out=ratio, where=means[0] * means[1] > 0.0)
        found.append(tuple(ratio.tolist()))
    return tuple(found)
