"""A fit as ArviZ takes it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from multicell.calibration.distance import Array
from multicell.calibration.predictive import predictive_of
from multicell.calibration.run_table import title_of

if TYPE_CHECKING:
    from multicell.calibration.fitted import Fit


def to_arviz(fit: Fit) -> Any:
    """Return draws, replicated data and pointwise likelihoods; see :meth:`Fit.to_arviz`."""
    import arviz

    found, problem = predictive_of(fit), fit.problem
    shares, weights = fit.some_sample()
    random = np.random.default_rng(0)
    count = len(shares)
    # ArviZ has no weights
    rows = np.arange(count) if np.ptp(weights) == 0.0 else random.choice(count, count, p=weights)
    data = problem.measured.data
    scaled = problem.observed + np.maximum(found.replicate(), problem.lowest) * problem.sigma
    again = np.array(list(map(problem.unscale, scaled[rows])))
    labels = [f"{title_of(d)}, {problem.measured.conditions[d.condition].label}" for d in data]

    def parameters(places: Array) -> dict[str, Array]:
        return {
            free.name: np.array([[free.value(float(x)) for x in column]])
            for free, column in zip(problem.ranges, places.T, strict=True)
        }

    made = arviz.from_dict(
        posterior=parameters(shares[rows]),
        prior=parameters(problem.prior.draw(random, count)),
        posterior_predictive={"data": again[None]},
        log_likelihood={"data": found.pointwise[rows][None]},
        observed_data={"data": np.array([d.value for d in data])},
        coords={"datum": labels},
        dims={"data": ["datum"]},
    )
    for group in (made.posterior, made.prior):
        for free in problem.ranges:
            group[free.name].attrs["units"] = free.unit
    return made
