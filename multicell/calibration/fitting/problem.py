"""The problem of a fit: data, free parameters, a simulator, and the comparison of runs with data.

A datum y with standard deviation σ (both on the scale of its comparison, see
:class:`multicell.measured.data.Datum`) is taken to be what one tissue shows, measured with a
normal error. So if runs that differ in nothing but their random numbers have mean m and variance
s², y - m has the variance σ² + s² over tissues and measurements. With m and s² from K runs,

    z = (y - m) / √v,    v = σ² + s² (1 + 1/K),    -2 ln L = Σ (z² + ln(v/σ²)) + constant,

the synthetic likelihood of Wood (2010, Nature 466, 1102), with K so small that the error of m
counts. The logarithm keeps parameters from being preferred because they make runs scatter. With one
run, s² is unknown and taken as none. Of a datum that is the mean of n tissues (σ is then the error
of that mean), the tissues' share is s²/n in place of s²; of one with a standard error of the mean,
which holds the scatter of tissues already, it is none (:mod:`multicell.measured.noise`).

Of a few runs s² itself is uncertain: two that happen to agree would make a datum seem sure. So each
one is moderated by what the data of the same observable and condition have on average, as if that
were known from PRIOR more runs (Smyth 2004, Stat. Appl. Genet. Mol. Biol. 3, 3). The average is
over variances relative to the squares of the values, since what grows scatters in proportion.
Where one of the values is below its own σ, such as the zeros of a core that has not begun, a
proportion says nothing: there the average is over variances in the observable's own unit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from multicell.calibration.fitting.constraints import Constraints
from multicell.calibration.fitting.priors import Prior, prior_of, split_free
from multicell.calibration.fitting.simulator import Reading, Simulator
from multicell.errors import SceneError
from multicell.measured.data import Datum, Measured
from multicell.measured.noise import Array as Array
from multicell.measured.noise import Noise
from multicell.measured.observables import may_be_negative
from multicell.studies.axes import Range, check_ranges, parse_ranges

SCATTERS: Final = ("stated", "unknown")
"""How large errors of data are: as stated, or times a factor for each observable that is fitted."""


@final
@dataclass(frozen=True)
class FitProblem:
    """Data and how runs are compared with them.

    - ``ranges``: the free parameters
    - ``simulator``: gives the readings of one run
    - ``seeds``: random numbers of the runs that are averaged, the same ones for all parameters
    - ``known``: their prior; None: all places in the ranges are equally likely
    - ``scatter``: one of :data:`SCATTERS`
    - ``freedom``: degrees of freedom of errors that residuals have shown; infinite for others
    """

    measured: Measured
    ranges: tuple[Range, ...]
    simulator: Simulator
    seeds: tuple[int, ...]
    known: Prior | None = None
    scatter: str = "stated"
    freedom: float = math.inf

    @cached_property
    def noise(self) -> Noise:
        """Errors and scatter of the data."""
        noise = Noise.of(self.measured.data)
        if self.scatter == "unknown":
            return replace(noise, unknown=tuple(self.observables.values()))
        if math.isfinite(self.freedom):
            return replace(noise, freedom=self.freedom, residual=True)
        return noise

    @cached_property
    def observables(self) -> Mapping[str, NDArray[np.int64]]:
        """Numbers of the data of each observable."""
        names = np.array([datum.observable for datum in self.measured.data])
        return {name: np.flatnonzero(names == name) for name in dict.fromkeys(names.tolist())}

    @cached_property
    def observed(self) -> Array:
        """The data on the scales of their comparison, (n,)."""
        return np.array([datum.scaled(datum.value) for datum in self.measured.data])

    @cached_property
    def sigma(self) -> Array:
        """Their standard deviations, (n,)."""
        return np.array([datum.sigma for datum in self.measured.data])

    @cached_property
    def tissues(self) -> Array:
        """How many tissues each datum is the mean of, (n,); see :class:`Datum`."""
        return np.array([datum.tissues for datum in self.measured.data])

    @cached_property
    def lowest(self) -> Array:
        """(0 - datum) / σ where an observable cannot be negative, else -inf: (n,)."""
        data = self.measured.data
        free = np.array([datum.log or may_be_negative(datum.observable) for datum in data])
        return np.where(free, -np.inf, -self.observed / self.sigma)

    @cached_property
    def prior(self) -> Prior:
        """Prior of the parameters."""
        return Prior(len(self.ranges)) if self.known is None else self.known

    @property
    def names(self) -> list[str]:
        """Names of the free parameters."""
        return [free.name for free in self.ranges]

    def tasks(self) -> list[tuple[int, int]]:
        """Return condition and seed of each run that one set of parameters takes."""
        return [(k, seed) for k in range(len(self.measured.conditions)) for seed in self.seeds]

    def values(self, shares: Sequence[float]) -> dict[str, float]:
        """Return the values of the parameters at shares of their ranges, base units, by key."""
        return {f.key: f.value(s) for f, s in zip(self.ranges, shares, strict=True)}

    def columns(self, shares: Array) -> dict[str, list[float]]:
        """Return the values of the parameters at places in the ranges (k, d), by name."""
        columns = zip(self.ranges, shares.T, strict=True)
        return {free.name: [free.value(float(x)) for x in column] for free, column in columns}

    def on_scales(self, condition: int, reading: Reading) -> Array:
        """Return the readings of a run on the scales of its data; NaN where there is nothing."""
        data = self.measured.of(condition)
        return np.array([d.scaled(v) for d, v in zip(data, reading.values, strict=True)])

    def unscale(self, values: Array) -> Array:
        """Return values on the scales of the data, (n,), in base units."""
        log = np.array([datum.log for datum in self.measured.data])
        return np.where(log, np.exp(np.where(log, values, 0.0)), values)

    def runs(self, readings: Mapping[tuple[int, int], Array], seeds: Sequence[int]) -> Array:
        """Return the readings of all conditions by seed, (K, n)."""
        found = np.full((len(seeds), len(self.measured.data)), np.nan)
        for condition, places in self.measured.numbers.items():
            for row, seed in enumerate(seeds):
                found[row, places] = readings[condition, seed]
        return found

    def misfit(self, readings: Mapping[tuple[int, int], Array]) -> Misfit:
        """Return how the runs of one set of parameters differ from the data."""
        runs = self.runs(readings, self.seeds)
        return misfit(self.observed, self.sigma, runs, self._groups, self.noise)

    @cached_property
    def _groups(self) -> tuple[NDArray[np.int64], Array]:
        return groups_of(self.measured.data)


def free_of(
    free: Mapping[str, Any], measured: Measured, constraints: str | Sequence[str] = ()
) -> tuple[tuple[Range, ...], Prior]:
    """Return the ranges and the prior of free parameters, some of which have distributions."""
    plain, densities = split_free(free, measured.conditions[0].scene)
    for condition in measured.conditions:
        for key in plain:
            if key in condition.changes:
                problem = "is a condition of the data, so that no fit can choose it"
                raise SceneError(key, problem)
    ranges = parse_ranges(plain, measured.conditions[0].scene)
    orders = Constraints.of(constraints or (), ranges)
    for condition in measured.conditions:
        try:
            check_ranges(condition.scene, orders.apart())
        except SceneError as error:
            if not condition.changes:
                raise
            problem = f"{error.problem} (under the condition '{condition.label}')"
            raise SceneError(error.path, problem, error.hint) from None
    return ranges, prior_of(ranges, list(densities.values()), orders)


ABSENT_DEVIATIONS: Final = 100.0
"""Standard deviations that a datum counts for of which a run has nothing.

Such are the rim at a size that the tissue never reaches, and all data of a run that fails.
"""

SCATTER_PRIOR: Final = 4.0
"""Degrees of freedom that the mean scatter of an observable counts for beside that of one datum."""


@final
@dataclass(frozen=True, eq=False)
class Misfit:
    """How runs with the same parameters differ from the data.

    - ``means``, (n,): of the runs, on the scales of the data; NaN where a run has nothing
    - ``scatter``, (n,): variance s² over the runs; 0 for one run
    - ``residuals``, (n,): (m - y) / √v, positive where the runs have more; ABSENT where they have
      nothing
    - ``loss``: -2 ln L up to a constant: 0 for a perfect fit without scatter
    """

    means: Array
    scatter: Array
    residuals: Array
    loss: float

    @property
    def chi_squared(self) -> float:
        """The sum of the squares of all residuals."""
        return float((self.residuals**2).sum())

    @property
    def per_datum(self) -> float:
        """χ² over the number of data: about 1 where model and deviations are right."""
        return self.chi_squared / len(self.residuals)


def groups_of(data: Sequence[Datum]) -> tuple[NDArray[np.int64], Array]:
    """Return which data share their scatter, (n,), and the sizes that it is relative to, (n,).

    The sizes of a group are the values of its data, or all of them 1 on the scale of comparison:
    for logarithms, and for a group that has a value below its own σ.
    """
    numbers: dict[tuple[str, int, bool], int] = {}
    groups = [numbers.setdefault((d.observable, d.condition, d.log), len(numbers)) for d in data]
    absolute = {k for k, d in zip(groups, data, strict=True) if d.log or abs(d.value) < d.sigma}
    sizes = [1.0 if k in absolute else abs(d.value) for k, d in zip(groups, data, strict=True)]
    return np.array(groups, dtype=np.int64), np.array(sizes)


def misfit(
    observed: Array,
    sigma: Array,
    runs: Array,
    groups: tuple[NDArray[np.int64], Array] | None = None,
    noise: Noise | None = None,
) -> Misfit:
    """Compare runs that differ in their random numbers with data.

    - ``observed``, ``sigma``, (n,): data and their standard deviations
    - ``runs``, (K, n): readings on the same scales, NaN where a run has nothing
    - ``groups``: which data share their scatter (:func:`groups_of`); None: none do
    - ``noise``: of the data; None: each is measured on a tissue, with independent errors
    """
    count = len(runs)
    means = runs.mean(axis=0)
    known = np.isfinite(means)
    scatter = np.zeros(len(observed))
    if count > 1:
        scatter = np.where(known, runs.var(axis=0, ddof=1), 0.0)
        if groups is not None:
            scatter = _moderate(scatter, known, count - 1.0, *groups)
    noise = noise or Noise.of_means(np.ones(len(observed)))
    away = np.where(known, (means - observed) / sigma, ABSENT_DEVIATIONS)
    more = scatter / sigma**2 * (np.diag(noise.shared) + 1.0 / count)
    total = np.diag(noise.errors) + more
    residuals = np.where(known, away / np.sqrt(total), ABSENT_DEVIATIONS)
    # what is absent counts as it is, however runs scatter elsewhere
    away = np.where(known, away, ABSENT_DEVIATIONS * np.sqrt(total))
    return Misfit(means, scatter, residuals, float(noise.loss(away[None], more)[0]))


def _moderate(
    scatter: Array,
    known: NDArray[np.bool_],
    freedom: float,
    groups: NDArray[np.int64],
    sizes: Array,
) -> Array:
    """Return variances drawn towards the mean of their groups."""
    relative = np.where(known, scatter / sizes**2, 0.0)
    members = np.bincount(groups, weights=known)
    mean = np.bincount(groups, weights=relative) / np.maximum(members, 1.0)
    drawn = (freedom * scatter + SCATTER_PRIOR * mean[groups] * sizes**2) / (
        freedom + SCATTER_PRIOR
    )
    return np.where(known, drawn, 0.0)
