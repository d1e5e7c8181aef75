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
import time as clock
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from multicell.calibration.fit_plan import BESIDE, FURTHER, PAIRS, write_result
from multicell.calibration.likelihood import MAX_REPEATS, MIN_REPEATS
from multicell.calibration.pool import open_pool
from multicell.calibration.simulator import Reading, Simulator
from multicell.errors import FitFailed, SceneError
from multicell.results.documents import Lines

if TYPE_CHECKING:
    from multicell.calibration.fit_plan import FitPlan, Progress
    from multicell.calibration.fitted import Fit
    from multicell.cells import FloatArray

MIN_POINTS: Final = 10
_LOG: Final = "pairs.log"

Key = tuple[tuple[float, ...], int, int]


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
        first = fitted("coarse", coarse, repeats=MIN_REPEATS, profile_runs=0)
        path = folder / "coarse" / _LOG
        runs, seconds = _pairs(first, coarse, fine, path, note, cores, scheduler)
        seeds, ratios = plan.problem.seeds, _ratios(plan, runs)
        corrected = Corrected(coarse, fine, seeds, ratios)
        found = fitted(
            "fine", corrected, points=max(MIN_POINTS, plan.points // FURTHER),
            adopted=_entries(first, corrected),
        )  # fmt: skip
        known = first.readings
        made = [key for key in found.readings if key not in known]
        counts = {
            "coarse": len(known) + len(runs["coarse"]) + sum(key[2] in seeds for key in made),
            "fine": len(runs["fine"]) + sum(key[2] not in seeds for key in made),
        }
        facts = {**found.facts, "coarse": _account(plan, counts, seconds, ratios)}
        found = replace(found, facts=facts, folder=None if output is None else found.folder)
        if output is not None:
            write_result(found, folder / "fine")
            found.report()
        return found


def _account(
    plan: FitPlan,
    counts: Mapping[str, int],
    seconds: Mapping[str, float],
    ratios: Sequence[Sequence[float]],
) -> dict[str, Any]:
    """Return what the fit has cost, and what fine runs alone would have."""
    spent = sum(counts[name] * seconds[name] for name in counts)
    alone = plan.runs * seconds["fine"]
    words = (
        f"The search made {counts['coarse']} coarse runs (factor {plan.coarse:g}), corrected by "
        f"{counts['fine']} fine ones: about {spent:,.0f} s of CPU, where the {plan.runs} runs of "
        f"the same fit would take {alone:,.0f} s."
    )
    return {
        "factor": plan.coarse, "runs": dict(counts), "seconds_a_run": dict(seconds),
        "seconds": spent, "fine_runs_alone": plan.runs, "fine_seconds_alone": alone,
        "saved": 1.0 - spent / alone if alone > 0.0 else float("nan"),
        "ratios": [list(row) for row in ratios], "words": words,
    }  # fmt: skip


def _entries(first: Fit, corrected: Corrected) -> list[dict[str, Any]]:
    """Return the search of a fit as entries of a log, with corrected readings."""
    points = [e.shares.tolist() for e in first.evaluations]
    entries: list[dict[str, Any]] = [{"points": points, "reused": True}]
    for shares in points:
        for condition, seed in first.problem.tasks():
            run = tuple(shares), condition, seed
            reading = corrected.corrected(first.readings[run], condition)
            entries.append({
                "shares": shares, "condition": condition, "seed": seed, "reason": reading.reason,
                "values": [None if v != v else v for v in reading.values], "reused": True,
            })  # fmt: skip
    return entries


def timed(
    simulator: Simulator, shares: Sequence[float], condition: int, seed: int
) -> tuple[Reading, float]:
    """Return what a run gives, and the CPU time that it took, s."""
    begin = clock.process_time()
    reading = simulator(shares, condition, seed)
    return reading, clock.process_time() - begin


def _pairs(
    first: Fit, coarse: Simulator, fine: Simulator, path: Path, note: Progress,
    cores: int | None, scheduler: str | None,
) -> tuple[dict[str, dict[Key, FloatArray]], dict[str, float]]:  # fmt: skip
    """Return readings of fine and coarse runs at draws from a fit, and mean CPU times, s."""
    if first.sample is None:
        raise FitFailed("too few points were tried with coarse runs", "Take a larger budget.")
    shares, weights = first.sample
    likely = np.interp((np.arange(PAIRS) + 0.5) / PAIRS, np.cumsum(weights), np.arange(len(shares)))
    draws = [tuple(shares[round(float(k))].tolist()) for k in likely]
    begin = max(first.problem.seeds) + 1 + 10 * MAX_REPEATS
    conditions = range(len(first.problem.measured.conditions))
    wanted = {
        (name, (draw, condition, begin + row * BESIDE + k))
        for row, draw in enumerate(draws)
        for condition in conditions
        for name, count in (("fine", 1), ("coarse", BESIDE))
        for k in range(count)
    }
    runs: dict[str, dict[Key, FloatArray]] = {"fine": {}, "coarse": {}}
    spent: dict[str, list[float]] = {"fine": [], "coarse": []}
    lines = Lines(path)

    def take(entry: Mapping[str, Any]) -> None:
        key = (tuple(entry["shares"]), entry["condition"], entry["seed"])
        if (entry["which"], key) not in wanted:  # of a fit that was overwritten
            return
        values = np.array([np.nan if v is None else v for v in entry["values"]])
        runs[entry["which"]][key] = values
        spent[entry["which"]].append(entry["seconds"])

    for entry in lines.entries:
        take(entry)
    missing = sorted((name, key) for name, key in wanted if key not in runs[name])
    with open_pool(cores, scheduler) as pool:
        simulators = {"fine": fine, "coarse": coarse}
        calls = [((n, key), timed, (simulators[n], list(key[0]), *key[1:])) for n, key in missing]
        for done, ((which, key), (reading, seconds)) in enumerate(pool.results(calls), start=1):
            values = [None if np.isnan(v) else v for v in reading.values]
            entry = {
                "which": which, "shares": list(key[0]), "condition": key[1], "seed": key[2],
                "values": values, "seconds": seconds,
            }  # fmt: skip
            lines.append([entry])
            take(entry)
            note("fine runs beside coarse ones", done, len(missing))
    return runs, {name: float(np.mean(times)) for name, times in spent.items()}


def _ratios(
    plan: FitPlan, runs: Mapping[str, Mapping[Key, FloatArray]]
) -> tuple[tuple[float, ...], ...]:
    """Return mean fine over mean coarse readings of each datum, by condition."""
    found = []
    for condition in range(len(plan.problem.measured.conditions)):
        means = []
        for name in ("fine", "coarse"):
            rows = np.array([v for key, v in runs[name].items() if key[1] == condition])
            count = np.isfinite(rows).sum(axis=0)
            if not count.any():
                words = f"no {name} run at draws from the first fit has any of the data"
                raise FitFailed(words, "See whether the ranges make sense.")
            means.append(np.nansum(rows, axis=0) / np.maximum(count, 1))
        fine, coarse = means
        ratio = np.ones_like(fine)
        np.divide(fine, coarse, out=ratio, where=fine * coarse > 0.0)
        found.append(tuple(ratio.tolist()))
    return tuple(found)
