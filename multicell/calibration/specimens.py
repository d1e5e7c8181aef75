"""Rows that measure the same: one datum, their mean, and how sure it is.

Rows without specimens' names are replicates: as many tissues as there are rows, whose scatter is
that of runs. Of named specimens the scatter is what the rows show. It holds the errors of measuring
them, so that the mean of n specimens with the variance s² has the variance s²/n, and nothing is
added for tissues. Of a few specimens s² itself is uncertain: each is moderated by the median of the
same observable and condition, as if that were known from one more specimen; a time with a single
specimen has the median. It is over variances relative to the squares of the values, or in the
observable's own unit where one of the values is not above its s. A mean would be that of the few
times at which specimens differ much, such as when their cores begin.

Where all specimens have a value of 0, they do not scatter, and yet the mean is not known to any
precision: its deviation is no less than the error of one zero (:mod:`multicell.calibration.data`).
That does not fall with n, as no number of specimens shows a core that is smaller than a cell. A
stated standard deviation of measuring is a lower bound as well, over √n.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from multicell.calibration.noise import PRIOR
from multicell.errors import DataError

if TYPE_CHECKING:
    from multicell.calibration.data import Datum


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
