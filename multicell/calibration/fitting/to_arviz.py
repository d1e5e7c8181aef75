"""The posterior of a fit as ArviZ takes it, below version 1 and from it on."""

from __future__ import annotations

import inspect
from typing import TYPE_CHECKING, Any

import numpy as np

from multicell.errors import FitFailed
from multicell.host.extras import needs

if TYPE_CHECKING:
    from multicell.calibration.fitting.fitted import Fit


def to_arviz(fit: Fit) -> Any:
    """Return an ``InferenceData`` or a ``DataTree``; see :meth:`Fit.to_arviz`."""
    needs("arviz")
    import arviz

    shares, known = fit.some_sample(), fit.fresh.likelihood
    if known is None:
        raise FitFailed("there is no likelihood")
    problem = fit.problem
    columns = problem.columns(shares)
    means = problem.observed + np.maximum(known.predict(shares)[0], problem.lowest) * problem.sigma
    predicted = np.array([problem.unscale(row) for row in means])
    values = np.array([datum.value for datum in problem.measured.data])
    groups: dict[str, Any] = {
        "posterior": {name: np.array([column]) for name, column in columns.items()},
        "log_likelihood": {"data": -0.5 * known.loss(shares)[None]},
        "posterior_predictive": {"data": predicted[None]},
        "observed_data": {"data": values},
    }
    # from 1 on the groups are one dictionary, before they were arguments
    if "data" in inspect.signature(arviz.from_dict).parameters:
        return arviz.from_dict(groups)
    return arviz.from_dict(**groups)
