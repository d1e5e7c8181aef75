"""What a fit has to solve: data, free parameters with their ranges, and what simulates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from multicell.calibration.data import Measured
from multicell.calibration.distance import (
    Array,
    Misfit,
    groups_of,
    misfit,
    scale_readings,
    scales,
)
from multicell.calibration.noise import Noise
from multicell.calibration.priors import Prior, prior_of, split_free
from multicell.calibration.simulator import Reading, SceneSimulator, Simulator
from multicell.errors import SceneError
from multicell.studies.axes import Range, check_ranges, parse_ranges
from multicell.studies.observed import may_be_negative


@final
@dataclass(frozen=True)
class Problem:
    """Data and how runs are compared with them.

    - ``ranges``: the free parameters
    - ``simulator``: gives the readings of one run
    - ``seeds``: random numbers of the runs that are averaged, the same ones for all parameters
    - ``scatter``: ``"unknown"`` where what data scatter beyond runs is estimated
    - ``known``: their prior; None: all places in the ranges are equally likely
    """

    measured: Measured
    ranges: tuple[Range, ...]
    simulator: Simulator
    seeds: tuple[int, ...]
    scatter: str = "stated"
    known: Prior | None = None

    @cached_property
    def noise(self) -> Noise:
        """Errors and scatter of the data."""
        return Noise.of(self.measured.data, self.scatter)

    @cached_property
    def _scales(self) -> tuple[Array, Array]:
        return scales(self.measured.data)

    @property
    def observed(self) -> Array:
        """The data on the scales of their comparison, (n,)."""
        return self._scales[0]

    @property
    def sigma(self) -> Array:
        """Their standard deviations, (n,)."""
        return self._scales[1]

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
        """What is known of the parameters beforehand."""
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

    def on_scales(self, condition: int, reading: Reading) -> Array:
        """Return the readings of a run on the scales of its data."""
        return scale_readings(self.measured.of(condition), reading.values)

    def unscale(self, values: Array) -> Array:
        """Return values on the scales of the data, (n,), in base units."""
        log = np.array([datum.log for datum in self.measured.data])
        return np.where(log, np.exp(np.where(log, values, 0.0)), values)

    def runs(self, readings: Mapping[tuple[int, int], Array], seeds: Sequence[int]) -> Array:
        """Return the readings of all conditions by seed, (K, n)."""
        found = np.full((len(seeds), len(self.measured.data)), np.nan)
        for condition, places in self.measured.numbers.items():
            for row, seed in enumerate(seeds):
                found[row, list(places)] = readings[condition, seed]
        return found

    def misfit(self, readings: Mapping[tuple[int, int], Array]) -> Misfit:
        """Return how the runs of one set of parameters differ from the data."""
        runs = self.runs(readings, self.seeds)
        return misfit(self.observed, self.sigma, runs, self._groups, self.noise)

    @cached_property
    def _groups(self) -> tuple[NDArray[np.int64], Array]:
        return groups_of(self.measured.data)


def ranges_of(free: Mapping[str, str | Sequence[object]], measured: Measured) -> tuple[Range, ...]:
    """Return the ranges of free parameters."""
    for condition in measured.conditions:
        for key in free:
            if key in condition.changes:
                problem = "is a condition of the data, so that no fit can choose it"
                raise SceneError(key, problem)
    ranges = parse_ranges(free, measured.conditions[0].scene)
    for condition in measured.conditions:
        try:
            check_ranges(condition.scene, ranges)
        except SceneError as error:
            if not condition.changes:
                raise
            problem = f"{error.problem} (under the condition '{condition.label}')"
            raise SceneError(error.path, problem, error.hint) from None
    return ranges


def free_of(
    free: Mapping[str, Any], measured: Measured, constraints: Sequence[str] = ()
) -> tuple[tuple[Range, ...], Prior]:
    """Return the ranges and the prior of free parameters, some of which have distributions."""
    plain, densities = split_free(free, measured.conditions[0].scene)
    ranges = ranges_of(plain, measured)
    return ranges, prior_of(ranges, list(densities.values()), constraints)


def problem_of(
    measured: Measured,
    ranges: Sequence[Range],
    seeds: int,
    first_seed: int,
    simulator: Simulator | None = None,
    scatter: str = "stated",
    prior: Prior | None = None,
) -> Problem:
    """Return the problem of fitting a scene to data.

    - ``measured``, ``ranges``: data and free parameters
    - ``seeds``: number of runs with different random numbers for each set of parameters
    - ``first_seed``: of these runs
    - ``simulator``: what stands for the scene's runs; by default they themselves
    - ``scatter``: see :class:`Problem`
    - ``prior``: of the parameters; by default uniform
    """
    chosen = SceneSimulator.of(measured, ranges) if simulator is None else simulator
    numbers = tuple(range(first_seed, first_seed + seeds))
    return Problem(measured, tuple(ranges), chosen, numbers, scatter, prior)
