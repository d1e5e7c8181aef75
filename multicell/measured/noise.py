"""Errors and scatter of data, own and shared.

Data less the mean of runs have, in units of their σ, the covariance

    C = errors + S shared + S/K + E

- errors: of the data; correlated where they are means over the same named specimens
- S: of runs with different seeds, as tissues scatter. Two means over n_i and n_j tissues of which
  m are the same ones share m / (n_i n_j) of it. Means without names are of the same tissues at all
  times (1/√(n_i n_j)), and share none of it where σ holds the scatter of tissues.
- S/K and E: errors of the mean over K runs and of an emulator

Rows that measure the same are one datum, their mean (:func:`group`). Rows without specimens' names
are replicates: as many tissues as there are rows, whose scatter is that of runs. Of named specimens
the scatter is what the rows show. It holds the errors of measuring them, so that the mean of n
specimens with the variance s² has the variance s²/n, and nothing is added for tissues. Of a few
specimens s² itself is uncertain: each is moderated by the median of the same observable and
condition, as if that were known from one more specimen; a time with a single specimen has the
median. It is over variances relative to the squares of the values, or in the observable's own unit
where one of the values is not above its s. A mean would be that of the few times at which specimens
differ much, such as when their cores begin.

Where all specimens have a value of 0, they do not scatter, and yet the mean is not known to any
precision: its deviation is no less than the error of one zero (:mod:`multicell.measured.data`).
That does not fall with n, as no number of specimens shows a core that is smaller than a cell. A
stated standard deviation of measuring is a lower bound as well, over √n.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final, Self, final

import numpy as np
from numpy.typing import NDArray

from multicell.errors import DataError

if TYPE_CHECKING:
    from multicell.measured.data import Datum

Array = NDArray[np.float64]
SPECIMEN_PRIOR: Final = 1.0
"""Degrees of freedom that the usual scatter of specimens counts for beside that of one datum."""
_SHRINKAGE: Final = 0.1
"""Least share by which estimated correlations are drawn towards none; a choice.

Estimates from few runs or specimens are singular, and Ledoit and Wolf's share of them may be zero
by chance. With a tenth no combination of data has less than a tenth of the variance that it would
have without correlations, so that none decides a fit alone."""


@final
@dataclass(frozen=True, eq=False)
class Noise:
    """Errors and scatter of n data, in σ.

    - ``errors``, (n, n): covariance of their errors
    - ``shared``, (n, n): part of the covariance of runs that the tissues of two data share
    - ``freedom``: degrees of freedom of errors that are known from specimens, or from the residuals
      of a fit; infinite for others
    - ``unknown``: numbers of the data that share a factor on their errors that nobody knows
    - ``residual``: whether ``freedom`` is that of the residuals of a fit
    """

    errors: Array
    shared: Array
    freedom: float = math.inf
    unknown: tuple[NDArray[np.int64], ...] = ()
    residual: bool = False

    @classmethod
    def of_means(cls, tissues: Array) -> Self:
        """Return the noise of independently measured means over the same tissues."""
        return cls(np.eye(len(tissues)), np.sqrt(1.0 / np.outer(tissues, tissues)))

    @classmethod
    def of(cls, data: Sequence[Datum]) -> Self:
        """Return the noise of data."""
        noise = cls.of_means(np.array([d.tissues for d in data]))
        errors, shared, freedom = noise.errors, noise.shared, math.inf
        if any(d.specimens for d in data):
            errors, shared = _of_specimens(data)
        counts = [len(d.specimens) for d in data if d.specimens and math.isinf(d.tissues)]
        if counts:
            freedom = float(np.median(counts)) - 1.0 + SPECIMEN_PRIOR
        return cls(errors, shared, freedom)

    def loss(self, residuals: Array, more: Array | float) -> Array:
        """Return -2 ln L of residuals (k, n) with further variances, as if C were diagonal: (k,).

        - ``more``, (k, n) or (n,): scatter of runs and errors of means and emulators
        """
        total = np.diag(self.errors) + more
        for numbers in self.unknown:
            squares, own = residuals[:, numbers] ** 2, np.diag(self.errors)[numbers]
            other = np.broadcast_to(more, residuals.shape)[:, numbers]
            total = np.broadcast_to(total, residuals.shape).copy()
            total[:, numbers] = likeliest(squares, own, other)[:, None] * own + other
        return np.asarray((residuals**2 / total + np.log(total)).sum(axis=-1))


LEAST_FACTOR: Final = 0.01
"""Least factor on stated errors that a fit finds: where parameters go through all data, none is."""


def likeliest(squares: Array, errors: Array, others: Array, lost: float = 0.0) -> Array:
    """Return the square of the factor on errors that makes residuals likeliest, (k,).

    - ``squares``, (k, n): of residuals
    - ``errors``, (n,): variances on which the square of the factor acts
    - ``others``, (k, n): variances on which it does not
    - ``lost``: degrees of freedom that parameters of a fit have taken from the residuals

    It is between the squares of :data:`LEAST_FACTOR` and its inverse.
    """
    low = np.full(len(squares), 2.0 * math.log(LEAST_FACTOR))
    high = -low
    share = 1.0 - lost / squares.shape[1]
    for _ in range(50):
        middle = 0.5 * (low + high)
        factor = np.exp(middle)[:, None]
        total = factor * errors + others
        part = factor * errors / total
        above = (part * (squares / total - share)).sum(axis=1) > 0.0
        low, high = np.where(above, middle, low), np.where(above, high, middle)
    return np.asarray(np.exp(0.5 * (low + high)))


def _of_specimens(data: Sequence[Datum]) -> tuple[Array, Array]:
    """Return the covariance of the errors of means over named specimens, and what tissues share.

    Correlations are those over the specimens that two data have in common, m of n_i and n_j. They
    are drawn towards none by the part of their squares that chance explains (Schäfer & Strimmer
    2005, Stat. Appl. Genet. Mol. Biol. 4, 32), at least by a tenth.
    """
    rows = {name: k for k, name in enumerate({x: 0 for d in data for x, _ in d.specimens})}
    away, there = np.zeros((len(rows), len(data))), np.zeros((len(rows), len(data)))
    for column, datum in enumerate(data):
        for name, deviation in datum.specimens:
            away[rows[name], column], there[rows[name], column] = deviation, 1.0
    counts = there.sum(axis=0)
    overlap = there.T @ there / np.outer(counts, counts)
    single = np.array([np.isfinite(d.tissues) for d in data])
    size = np.sqrt((away**2).sum(axis=0))
    found = away.T @ away / np.outer(*2 * [np.where(size > 0.0, size, 1.0)])
    np.fill_diagonal(found, 0.0)  # without rounding; a lone specimen has no deviation
    chance = (overlap * (1.0 - found**2) ** 2)[found != 0.0].sum()
    part = min(1.0, max(_SHRINKAGE, chance / max((found**2).sum(), chance, 1e-300)))
    return np.eye(len(data)) + (1.0 - part) * found, overlap * np.outer(single, single)


def shrink(away: Array) -> Array:
    """Return the covariance of runs (R, n), its correlations drawn towards none: (n, n).

    Ledoit & Wolf (2004, J. Multivariate Anal. 88, 365) of the correlations; at least by a tenth.
    """
    from sklearn.covariance import ledoit_wolf_shrinkage

    away = away - away.mean(axis=0)
    covariance = away.T @ away / (len(away) - 1.0)
    deviation = np.sqrt(np.diag(covariance))
    moving = deviation > 0.0
    shrinkage = _SHRINKAGE
    if moving.sum() > 1:
        wolf = ledoit_wolf_shrinkage(away[:, moving] / deviation[moving], assume_centered=True)
        shrinkage = max(_SHRINKAGE, float(wolf))
    return np.asarray((1.0 - shrinkage) * covariance + shrinkage * np.diag(deviation**2))


def group(data: Sequence[Datum], table: str) -> list[Datum]:
    """Return data in which replicates and specimens are one: the mean, with its error."""
    groups: dict[tuple[Any, ...], list[Datum]] = {}
    for datum in data:
        when = datum.condition, datum.time, datum.depth
        key = datum.observable, *when, datum.log, math.isinf(datum.tissues)
        groups.setdefault(key, []).append(datum)
    found = [_merge(rows, table) if len(rows) > 1 else rows[0] for rows in groups.values()]
    families: dict[tuple[Any, ...], list[int]] = {}
    for number, datum in enumerate(found):
        if datum.specimens:
            families.setdefault((datum.observable, datum.condition, datum.log), []).append(number)
    for numbers in families.values():
        for number, datum in zip(numbers, _scattered([found[k] for k in numbers]), strict=True):
            if datum.sigma == 0.0:
                problem = f"has specimens that agree exactly in '{datum.observable}'"
                hint = f"Add a column '{datum.observable} sd': the error of measuring one."
                raise DataError(f"{table}, {datum.place}", problem, hint)
            found[number] = datum
    return found


def _merge(rows: Sequence[Datum], table: str) -> Datum:
    """Return the mean of replicates, weighted by tissues, or by 1/σ² of means."""
    first = rows[0]
    weights = [d.sigma**-2 if math.isinf(d.tissues) else d.tissues for d in rows]
    pairs = list(zip(weights, rows, strict=True))
    mean = sum(w * d.scaled(d.value) for w, d in pairs) / sum(weights)
    error = math.sqrt(sum((w * d.sigma) ** 2 for w, d in pairs)) / sum(weights)
    named = [(name, d.scaled(d.value) - mean) for d in rows for name, _ in d.specimens]
    for k, (name, _) in enumerate(named):
        if name in dict(named[:k]):
            problem = f"measures '{first.observable}' of a specimen for the second time"
            raise DataError(f"{table}, {rows[k].place}", problem)
    return replace(
        first,
        value=math.exp(mean) if first.log else mean,
        sigma=error,
        assumed=any(d.assumed for d in rows),
        place=f"{first.place} and {len(rows) - 1} more",
        tissues=sum(d.tissues for d in rows),
        specimens=tuple(named),
    )


def _scattered(data: Sequence[Datum]) -> list[Datum]:
    """Return data of one observable and condition with the scatter of their specimens."""
    counts = np.array([len(d.specimens) for d in data])
    if (counts == 1).all():
        return list(data)
    squares = np.array([sum(away**2 for _, away in d.specimens) for d in data])
    variance = squares / np.maximum(counts - 1, 1)
    sizes = np.array([d.value**2 for d in data])
    if data[0].log or (sizes <= variance).any():
        sizes[:] = 1.0
    usual = float(np.median((variance / sizes)[variance > 0.0])) if variance.any() else 0.0
    variance = ((counts - 1) * variance + SPECIMEN_PRIOR * usual * sizes) / (
        counts - 1 + SPECIMEN_PRIOR
    )
    found = []
    for datum, deviation, count in zip(data, np.sqrt(variance / counts), counts, strict=True):
        zero = datum.assumed and datum.value == 0.0
        floor = datum.sigma * math.sqrt(count) if zero else 0.0 if datum.assumed else datum.sigma
        sigma = max(float(deviation), floor)
        found.append(replace(datum, sigma=sigma, assumed=False, tissues=math.inf))
    return found
