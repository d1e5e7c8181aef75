"""Errors and scatter of data: what is known, what data have in common, and what is estimated.

Data less the mean of runs have, in units of their σ, the covariance

    C = errors + S shared + S/K + E + ω² h²

- errors: of the data; correlated where they are means over the same named specimens
- S: of runs with different seeds, as tissues scatter. Two means over n_i and n_j tissues of which
  m are the same ones share m / (n_i n_j) of it. Means without names are of the same tissues at all
  times (1/√(n_i n_j)), and share none of it where σ holds the scatter of tissues.
- S/K and E: errors of the mean over K runs and of an emulator
- ω: unknown scatter of an observable, relative to its values h (to the largest one if any is
  below its σ), which are those of the data in a search and those of the best runs for intervals;
  over √n for a mean of n tissues, independent from datum to datum. Data without a stated deviation
  have no other error then. It lies between 0.3 and 300 %, and ln ω is uniform a priori.

:meth:`Noise.loss` integrates over ω, with all else in C diagonal; the likelihood of the intervals
estimates ω with the whole of C (:mod:`multicell.calibration.likelihood`).

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
precision: its deviation is no less than the error of one zero (:mod:`multicell.calibration.data`).
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
from scipy.special import logsumexp

from multicell.errors import DataError

if TYPE_CHECKING:
    from multicell.calibration.data import Datum

Array = NDArray[np.float64]
SCATTERS: Final = ("stated", "unknown")
"""What data scatter beyond runs: what the table states, or parameters of their own."""

OMEGA: Final = (0.003, 3.0)  # range of unknown scatter
PRIOR: Final = 1.0
"""Degrees of freedom that the usual scatter of specimens counts for beside that of one datum."""
_LEAST: Final = 0.1
"""Part of a datum that unknown scatter is relative to at least, where a model has less."""
_NODES: Final = 61
_SHRINKAGE: Final = 0.1


@final
@dataclass(frozen=True, eq=False)
class Noise:
    """Errors and scatter of n data, in σ.

    - ``errors``, (n, n): covariance of their errors; 0 where none is known
    - ``shared``, (n, n): part of the covariance of runs that the tissues of two data share
    - ``names``: observables with unknown scatter, G of them
    - ``group``, (n,): which of these a datum is of; G for none
    - ``sizes``, (n,): h/√n in σ; 0 for none
    - ``slopes``, (n,): ±1/√n where h is the size of the datum's value; else 0
    - ``freedom``: degrees of freedom of errors that are known from specimens; infinite for others
    """

    errors: Array
    shared: Array
    names: tuple[str, ...]
    group: NDArray[np.int64]
    sizes: Array
    slopes: Array
    freedom: float = math.inf

    @classmethod
    def of_means(cls, tissues: Array) -> Self:
        """Return the noise of independently measured means over the same tissues."""
        n = len(tissues)
        shared = np.sqrt(1.0 / np.outer(tissues, tissues))
        return cls(np.eye(n), shared, (), np.zeros(n, dtype=np.int64), np.zeros(n), np.zeros(n))

    @classmethod
    def of(cls, data: Sequence[Datum], scatter: str = "stated") -> Self:
        """Return the noise of data.

        - ``scatter``: ``"unknown"`` where it is to be estimated
        """
        noise = cls.of_means(np.array([d.tissues for d in data]))
        errors, shared, freedom = noise.errors, noise.shared, math.inf
        if any(d.specimens for d in data):
            errors, shared = _of_specimens(data)
        counts = [len(d.specimens) for d in data if d.specimens and math.isinf(d.tissues)]
        if counts:
            freedom = float(np.median(counts)) - 1.0 + PRIOR
        names = tuple(dict.fromkeys(d.observable for d in data)) if scatter == "unknown" else ()
        if not names:
            return replace(noise, errors=errors, shared=shared, freedom=freedom)
        group = np.array([names.index(d.observable) for d in data])
        known = np.array([not d.assumed for d in data])
        errors = errors * np.outer(known, known)
        return cls(errors, shared, names, group, *_sizes(data), freedom)

    def around(self, residuals: Array) -> Self:
        """Return the noise with values of h that are those of a model, not of the data.

        Measured values would give weight to those that are too small by chance.

        - ``residuals``, (n,): of the model
        """
        model = np.abs(self.sizes + self.slopes * residuals)
        return replace(self, sizes=np.maximum(model, _LEAST * self.sizes))

    @property
    def omegas(self) -> Array:
        """Values of ω whose mean is the integral over a uniform logarithm."""
        places = (np.arange(_NODES) + 0.5) / _NODES
        return np.asarray(OMEGA[0] * (OMEGA[1] / OMEGA[0]) ** places)

    def loss(self, residuals: Array, more: Array | float) -> Array:
        """Return -2 ln L of residuals (k, n) with further variances, as if C were diagonal: (k,).

        - ``more``, (k, n) or (n,): scatter of runs and errors of means and emulators
        """
        total = np.diag(self.errors) + more
        if not self.names:
            return np.asarray((residuals**2 / total + np.log(total)).sum(axis=-1))
        logs = self._by_omega(residuals, total)
        return np.asarray(-2.0 * (logsumexp(logs, axis=0) - np.log(_NODES)).sum(axis=-1))

    def unknown(self, residuals: Array, more: Array) -> Array:
        """Return the mean variance of unknown scatter given residuals (n,), (n,)."""
        if not self.names:
            return np.zeros(len(residuals))
        logs = self._by_omega(residuals[None], np.diag(self.errors) + more[None])[:, 0]
        weights = np.exp(logs - logsumexp(logs, axis=0))
        return np.asarray((weights.T @ self.omegas**2)[self.group] * self.sizes**2)

    def _by_omega(self, residuals: Array, total: Array) -> Array:
        """Return ln L of each observable's residuals by ω, (nodes, k, G)."""
        members = np.eye(len(self.names))[self.group]
        found = np.empty((_NODES, len(residuals), len(self.names)))
        for node, omega in zip(found, self.omegas, strict=True):
            each = total + (omega * self.sizes) ** 2
            node[:] = -0.5 * (residuals**2 / each + np.log(each)) @ members
        return found


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


def _sizes(data: Sequence[Datum]) -> tuple[Array, Array]:
    """Return what unknown scatter is relative to, in σ and over √n, and ±1/√n where it is a value.

    Elsewhere it is the largest value of the observable, or 1 of logarithms.
    """
    counts = np.array([d.tissues if np.isfinite(d.tissues) else 1.0 for d in data])
    sizes, slopes = np.ones(len(data)), np.zeros(len(data))
    for name in {d.observable for d in data}:
        own = [k for k, d in enumerate(data) if d.observable == name and not d.log]
        values = np.array([abs(data[k].value) for k in own])
        if any(abs(data[k].value) < data[k].sigma for k in own):
            values[:] = values.max()
        else:
            slopes[own] = np.sign([data[k].value for k in own])
        sizes[own] = values
    return sizes / np.array([d.sigma for d in data]) / np.sqrt(counts), slopes / np.sqrt(counts)


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
        when = datum.condition, datum.time, datum.at, datum.depth
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
        first, value=math.exp(mean) if first.log else mean, sigma=error,
        assumed=any(d.assumed for d in rows), place=f"{first.place} and {len(rows) - 1} more",
        tissues=sum(d.tissues for d in rows), specimens=tuple(named),
    )  # fmt: skip


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
    variance = ((counts - 1) * variance + PRIOR * usual * sizes) / (counts - 1 + PRIOR)
    found = []
    for datum, deviation, count in zip(data, np.sqrt(variance / counts), counts, strict=True):
        zero = datum.assumed and datum.value == 0.0
        floor = datum.sigma * math.sqrt(count) if zero else 0.0 if datum.assumed else datum.sigma
        sigma = max(float(deviation), floor)
        found.append(replace(datum, sigma=sigma, assumed=False, tissues=math.inf))
    return found
