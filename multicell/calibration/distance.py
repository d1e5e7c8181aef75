"""Runs against data, in standard deviations.

A datum y with standard deviation σ (both on the scale of its comparison, see
:class:`multicell.calibration.data.Datum`) is taken to be what one tissue shows, measured with a
normal error. So if runs that differ in nothing but their random numbers have mean m and variance
s², y - m has the variance σ² + s² over tissues and measurements. With m and s² from K runs,

    z = (y - m) / √v,    v = σ² + s² (1 + 1/K),    -2 ln L = Σ (z² + ln(v/σ²)) + constant,

the synthetic likelihood of Wood (2010, Nature 466, 1102), with K so small that the error of m
counts. The logarithm keeps parameters from being preferred because they make runs scatter. With one
run, s² is unknown and taken as none. Of a datum that is the mean of n tissues (σ is then the error
of that mean), the tissues' share is s²/n in place of s²; of one with a standard error of the mean,
which holds the scatter of tissues already, it is none. Unknown scatter of the data adds to v
(:mod:`multicell.calibration.noise`).

Of a few runs s² itself is uncertain: two that happen to agree would make a datum seem sure. So each
one is moderated by what the data of the same observable and condition have on average, as if that
were known from PRIOR more runs (Smyth 2004, Stat. Appl. Genet. Mol. Biol. 3, 3). The average is
over variances relative to the squares of the values, since what grows scatters in proportion.
Where one of the values is below its own σ, such as the zeros of a core that has not begun, a
proportion says nothing: there the average is over variances in the observable's own unit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, final

import numpy as np
from numpy.typing import NDArray

from multicell.calibration.noise import Array as Array
from multicell.calibration.noise import Noise

if TYPE_CHECKING:
    from multicell.calibration.data import Datum

ABSENT: Final = 100.0
"""Standard deviations that a datum counts for of which a run has nothing.

Such are the rim at a size that the tissue never reaches, and all data of a run that fails.
"""

PRIOR: Final = 4.0
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


def scales(data: Sequence[Datum]) -> tuple[Array, Array]:
    """Return the values of data on the scales of comparison and their deviations, (n,) each."""
    return np.array([d.scaled(d.value) for d in data]), np.array([d.sigma for d in data])


def scale_readings(data: Sequence[Datum], values: Sequence[float]) -> Array:
    """Return readings of a run on the scales of the data, (n,); NaN where there is nothing."""
    return np.array([d.scaled(v) for d, v in zip(data, values, strict=True)], dtype=float)


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
    away = np.where(known, (means - observed) / sigma, ABSENT)
    more = scatter / sigma**2 * (np.diag(noise.shared) + 1.0 / count)
    total = np.diag(noise.errors) + more + noise.unknown(np.where(known, away, 0.0), more)
    residuals = np.where(known, away / np.sqrt(total), ABSENT)
    # what is absent counts as it is, however runs scatter elsewhere
    away = np.where(known, away, ABSENT * np.sqrt(total))
    return Misfit(means, scatter, residuals, float(noise.loss(away[None], more)[0]))


def _moderate(
    scatter: Array, known: NDArray[np.bool_], freedom: float, groups: NDArray[np.int64],
    sizes: Array,
) -> Array:  # fmt: skip
    """Return variances drawn towards the mean of their groups."""
    relative = np.where(known, scatter / sizes**2, 0.0)
    members = np.bincount(groups, weights=known)
    mean = np.bincount(groups, weights=relative) / np.maximum(members, 1.0)
    drawn = (freedom * scatter + PRIOR * mean[groups] * sizes**2) / (freedom + PRIOR)
    return np.where(known, drawn, 0.0)
