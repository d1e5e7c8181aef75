"""Comparison of fits to the same data: predictive score and information criteria.

Fits of several models to one table are compared by this score, and by AIC = -2 ln L + 2 k, AICc,
which adds 2 k (k + 1) / (n - k - 1), and BIC, which has k ln n in place of 2 k (Burnham & Anderson
2002, Model Selection and Multimodel Inference). L is the likelihood at its largest value, for n
data and k parameters. The scatter of tissues is estimated from some dozen runs of each model; one
covariance for all of them, the mean, keeps the error of its determinant from deciding between
models.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from multicell.calibration.fitting.predictive import least_residuals, predictive_of
from multicell.errors import SceneError
from multicell.host.extras import needs

if TYPE_CHECKING:
    import pandas as pd

    from multicell.calibration.fitting.result import Fit


def compare_fits(fits: Mapping[str, Fit]) -> pd.DataFrame:
    """Compare fits to the same data.

    Parameters
    ----------
    fits
        Name -> fit.

    Returns
    -------
    pandas.DataFrame
        A row for each, the best predictive score first: ``parameters`` and ``data`` (numbers),
        ``log_likelihood`` at best, ``aic``, ``aicc``, ``bic``, ``score`` (Σ ``ln p(y_i | y_-i)``,
        the larger the better) with its standard error ``score_error``, ``behind`` (what is missing
        to the best score) with its standard error ``behind_error``, which is that of the
        differences datum by datum.

    Raises
    ------
    SceneError
        If there are fewer than two, or data differ.
    FitFailed
        If one of them has no posterior.
    """
    needs("pandas")
    import pandas

    if not isinstance(fits, Mapping) or len(fits) < 2:
        raise SceneError("fits", "must have at least two fits", "Give {'name': fit, ...}.")
    (first, one), *others = fits.items()
    for name, other in others:
        if _key(one) != _key(other):
            problem = f"has '{first}' and '{name}', which are to different data"
            hint = "Scores and likelihoods compare only where all data and their errors are equal."
            raise SceneError("fits", problem, hint)
    found = {name: predictive_of(fit) for name, fit in fits.items()}
    common = np.mean([each.covariance for each in found.values()], axis=0)
    rows = {}
    for name, fit in fits.items():
        found[name] = replace(found[name], covariance=common)
        count, free = len(fit.problem.sigma), len(fit.problem.ranges)
        largest = found[name].log_likelihood(least_residuals(fit, found[name]))
        left = count - free - 1
        aic = 2.0 * (free - largest)
        rows[name] = {
            "parameters": free,
            "data": count,
            "log_likelihood": largest,
            "aic": aic,
            "aicc": aic + 2.0 * free * (free + 1) / left if left > 0 else math.nan,
            "bic": free * math.log(count) - 2.0 * largest,
            **dict(zip(("score", "score_error"), _sum(found[name].scores), strict=True)),
        }
    best = max(rows, key=lambda name: rows[name]["score"])
    for name, row in rows.items():
        missing = _sum(found[best].scores - found[name].scores)
        row.update(zip(("behind", "behind_error"), missing, strict=True))
    table = pandas.DataFrame.from_dict(rows, orient="index")
    table.index.name = "model"
    return table.sort_values("score", ascending=False)


def _sum(values: np.ndarray) -> tuple[float, float]:
    """Return the sum of some values, and its standard error."""
    spread = values.std(ddof=1) if len(values) > 1 else math.nan
    return float(values.sum()), float(math.sqrt(len(values)) * spread)


def _key(fit: Fit) -> list[tuple[object, ...]]:
    """Return all that the likelihood takes from data."""
    measured = fit.problem.measured
    return [
        (
            d.observable,
            d.value,
            d.sigma,
            d.log,
            d.time,
            d.depth,
            d.tissues,
            d.specimens,
            sorted(measured.conditions[d.condition].changes.items(), key=str),
        )
        for d in measured.data
    ]
