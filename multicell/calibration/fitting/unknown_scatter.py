"""Errors of data whose size nobody knows: a factor on those of each observable, from residuals.

For n data of an observable with residuals r to the parameters θ, each in the stated standard
deviation, the factor φ has the likelihood of normal numbers of variance φ² + s², s² the scatter of
runs that v holds besides (:mod:`multicell.calibration.fitting.problem`). A search takes for each θ
the likeliest φ, which for s = 0 is n ln Σ r² in place of Σ r². The fit itself takes φ from the
residuals of its best point less the degrees of freedom that its p parameters have used, p n/N for
n of N data, and gives parameters Student tails with what is left, as in linear regression.
Beforehand a logarithm of φ is as likely as the root of its information, Σ (φ²/(φ² + s²))², after
Jeffreys (1946): for s = 0 all are, and draws of φ² are those of a scaled inverse χ². Equal chances
for s > 0 would favour factors far below s, of which data say nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, final

import numpy as np

from multicell.calibration.fitting.verdict import quantiles
from multicell.calibration.shared.wording import value_in_words
from multicell.errors import DataError
from multicell.measured.noise import LEAST_FACTOR, Array, likeliest

if TYPE_CHECKING:
    from multicell.calibration.fitting.problem import FitProblem

LEAST_FREE: Final = 2
"""Data of an observable that must be left beyond its share of the parameters."""
_FACTORS: Final = 241  # logarithms of factors that a draw chooses from
_REACH: Final = 3.0  # of a factor around the likeliest one, at least: e^3 of it


@final
@dataclass(frozen=True)
class FittedScatter:
    """Size of the errors of an observable, as a fit has found it.

    - ``low``, ``median``, ``high``: 95 % interval of the factor on the stated errors
    - ``best``: factor that the fit takes
    - ``words``: the standard deviation in words: of the value in %, or in a unit
    """

    low: float
    median: float
    high: float
    best: float
    words: str


def check_scatter(problem: FitProblem) -> None:
    """Refuse data that cannot show how large their errors are."""
    data, count = problem.measured.data, len(problem.measured.data)
    if any(datum.specimens for datum in data):
        hint = "Leave scatter out: the spread of the rows is their scatter already."
        raise DataError("scatter", "is unknown, and the data are single specimens", hint)
    for name, numbers in problem.observables.items():
        left = len(numbers) * (1.0 - len(problem.ranges) / count)
        if left < LEAST_FREE:
            problem_words = (
                f"is unknown, and the {len(numbers)} data of '{name}' leave {max(left, 0.0):.3g} "
                "degrees of freedom beside the parameters"
            )
            raise DataError("scatter", problem_words, f"At least {LEAST_FREE} are needed.")


def with_scatter(problem: FitProblem, residuals: Array, others: Array) -> FitProblem:
    """Return a problem whose errors have the size that residuals show.

    - ``residuals``, (n,): (mean - datum) / σ; NaN where runs have nothing
    - ``others``, (n,): variances of runs and of their mean, in σ²
    """
    data, known = list(problem.measured.data), np.isfinite(residuals)
    part = len(problem.ranges) / max(1, int(known.sum()))
    freedom = np.inf
    for numbers in problem.observables.values():
        seen = numbers[known[numbers]]
        lost = min(part, 0.5) * len(seen)
        if not len(seen):
            continue
        squares = residuals[None, seen] ** 2
        factor = float(np.sqrt(likeliest(squares, np.ones(len(seen)), others[None, seen], lost)[0]))
        freedom = min(freedom, len(seen) - lost)
        for k in numbers:
            data[k] = replace(data[k], sigma=data[k].sigma * factor, assumed=False)
    measured = replace(problem.measured, data=tuple(data))
    return replace(problem, measured=measured, scatter="stated", freedom=float(freedom))


def drawn_factors(problem: FitProblem, residuals: Array, others: Array) -> dict[str, Array]:
    """Return a draw of the factor on the stated errors for each draw of parameters, by observable.

    - ``residuals``, (k, n): (mean - datum) / σ at draws of parameters, σ as stated
    - ``others``, (k, n): variances of runs, of their mean and of emulators, in σ²
    """
    random, found = np.random.default_rng(0), {}
    for name, numbers in problem.observables.items():
        own, more = residuals[:, numbers] ** 2, others[:, numbers]
        middle = np.log(likeliest(own, np.ones(len(numbers)), more))
        reach = max(_REACH, 6.0 / np.sqrt(len(numbers)))
        logs = np.clip(
            middle[:, None] + np.linspace(-2.0 * reach, 2.0 * reach, _FACTORS),
            *(2.0 * np.log(LEAST_FACTOR) * np.array([1.0, -1.0])),
        )
        chance, information = np.zeros_like(logs), np.zeros_like(logs)
        for squares, other in zip(own.T, more.T, strict=True):  # a datum at a time: memory
            total = np.exp(logs) + other[:, None]
            chance -= 0.5 * (squares[:, None] / total + np.log(total))
            information += (np.exp(logs) / total) ** 2
        chance += 0.5 * np.log(information)
        weights = np.exp(chance - chance.max(axis=1, keepdims=True))
        weights[:, 1:][np.diff(logs, axis=1) == 0.0] = 0.0  # beyond the ends there is nothing
        sums = np.cumsum(weights, axis=1)
        places = (sums < (random.random(len(sums)) * sums[:, -1])[:, None]).sum(axis=1)
        spread = (logs[:, 1] - logs[:, 0]).max() * (random.random(len(sums)) - 0.5)
        found[name] = np.exp(0.5 * (np.take_along_axis(logs, places[:, None], 1)[:, 0] + spread))
    return found


def fitted_scatter(
    problem: FitProblem, stated: FitProblem, draws: Mapping[str, Array]
) -> dict[str, FittedScatter]:
    """Return the size of the errors of each observable by name.

    - ``problem``, ``stated``: with fitted errors, and with those that the data state
    - ``draws``: of the factor, by observable
    """
    found = {}
    for name, factors in draws.items():
        numbers = problem.observables[name]
        data = [problem.measured.data[k] for k in numbers]
        best = float((problem.sigma / stated.sigma)[numbers[0]])
        sizes = np.array([datum.deviation for datum in data])
        parts = np.array([datum.deviation / abs(datum.value or np.nan) for datum in data])
        if np.ptp(sizes) <= 1e-9 * sizes.max():
            words = value_in_words(float(sizes[0]), problem.measured.units[name])
        elif np.nanmax(parts) - np.nanmin(parts) <= 1e-9:
            words = f"{100.0 * np.nanmin(parts):.3g} %"
        else:
            words = f"{best:.3g} times the stated ones"
        low, median, high = quantiles(factors, (0.025, 0.5, 0.975))
        found[name] = FittedScatter(float(low), float(median), float(high), best, words)
    return found
