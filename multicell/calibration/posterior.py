"""The posterior of the free parameters, sampled with runs: pyABC's sequential Monte Carlo.

The noise of the data is part of the acceptance: a draw with residuals z (one run for each
condition, with random numbers of its own) is accepted with a probability that is proportional to
exp(-Σz²/2T), or to that of a normal law with the correlations that errors have. The temperature T
falls from generation to generation, and at T = 1 the accepted draws are from the exact posterior of
a tissue that was measured with the stated deviations (Wilkinson 2013, Stat. Appl. Genet. Mol. Biol.
12, 129; Schälte & Hasenauer 2020, Bioinformatics 36, i551). Runs that scatter need no extra term:
the draws go over their scatter. A sample at T > 1 is too wide and says so.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import numpy as np

from multicell.calibration.distance import Array
from multicell.calibration.pool import Pool
from multicell.calibration.problem import Problem
from multicell.errors import FitFailed, OutputError
from multicell.host.extras import needs, quiet


@final
@dataclass(frozen=True, eq=False)
class Draws:
    """Weighted draws from a posterior.

    - ``shares``, (k, d): places in the ranges
    - ``weights``, (k,): their sum is 1
    - ``residuals``, (k, n): (reading - datum) / σ of the run of each draw
    - ``temperature``: of the sample; 1 for the posterior itself
    - ``generations``: how many were sampled
    - ``drawn``: how many draws all of them took; each is one run of every condition
    """

    shares: Array
    weights: Array
    residuals: Array
    temperature: float
    generations: int
    drawn: int


def posterior(
    problem: Problem,
    pool: Pool,
    *,
    folder: Path | None = None,
    seed: int = 0,
    population: int = 200,
    most: float = math.inf,
    deadline: float = math.inf,
    progress: Callable[[int, int, int, int], None] | None = None,
) -> Draws:
    """Sample the posterior of a problem, or continue with it.

    - ``pool``: where runs are made
    - ``folder``: where pyABC's database and the journal of the generation under way are kept
    - ``seed``: of all random numbers. The sample does not depend on the number of workers.
    - ``population``: number of draws in a generation
    - ``most``: number of draws after which no generation is begun or finished
    - ``deadline``: the same by time (as of ``time.monotonic``)
    - ``progress``: called with generation, accepted, wanted and drawn

    Raises FitFailed if a limit came before the first generation was complete; OutputError if the
    database cannot be read.
    """
    needs("pyabc", "sqlalchemy")  # they set the levels of their loggers as they are loaded
    with quiet("ABC", "pyabc"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from multicell.calibration.reproducible_sampler import Model, ReproducibleSampler

        sampler = ReproducibleSampler(
            pool, seed, most=most, deadline=deadline, progress=progress,
            journal=None if folder is None else folder / "posterior.journal",
        )  # fmt: skip
        history = _sample(problem, Model(problem), sampler, population, folder)
        if history.max_t < 0:
            raise FitFailed(
                f"the first generation of {population} draws was not complete after "
                f"{sampler.drawn} draws",
                "A larger budget continues it; a smaller population takes fewer draws.",
            )
        return _draws(problem, history)


def _sample(
    problem: Problem, model: Any, sampler: Any, population: int, folder: Path | None
) -> Any:
    """Return pyABC's history after all generations."""
    import pyabc

    from multicell.calibration.reproducible_sampler import Box, OneModel

    if (problem.noise.errors == np.eye(len(problem.observed))).all():
        kernel = pyabc.distance.IndependentNormalKernel(var=1.0, keys=["z"])
    else:  # means over the same specimens
        kernel = pyabc.distance.NormalKernel(
            cov=problem.noise.errors, keys=["z"], ret_scale=pyabc.distance.SCALE_LOG
        )
    smc = pyabc.ABCSMC(
        model, Box(problem.names, problem.prior), kernel, population_size=population,
        eps=pyabc.Temperature(), acceptor=pyabc.StochasticAcceptor(), sampler=sampler,
        model_prior=OneModel(),
    )  # fmt: skip
    observed = {"z": np.zeros(len(problem.observed))}
    if folder is None:
        smc.new("sqlite://", observed)
    else:
        path = folder / "posterior.db"
        _open(smc, path, observed)
    history = smc.history
    if history.max_t >= 0:
        sampler.drawn = int(history.total_nr_simulations)
        if _temperature(history) <= 1.0:
            return history
    smc.run()
    return history


def _open(smc: Any, path: Path, observed: dict[str, Array]) -> None:
    """Let pyABC continue what its database holds, or begin one."""
    import sqlalchemy

    place = f"sqlite:///{path.resolve()}"
    try:
        if path.exists():
            smc.load(place, 1, observed)
            if len(smc.history.all_runs()):
                return
        smc.new(place, observed)
    except (sqlalchemy.exc.SQLAlchemyError, AttributeError, ValueError) as error:
        said = str(error).splitlines()[0]
        raise OutputError(f"'{path}' cannot be used as pyABC's database: {said}") from error


def _temperature(history: Any) -> float:
    return float(history.get_all_populations()["epsilon"].iloc[-1])


def _draws(problem: Problem, history: Any) -> Draws:
    """Return the last generation of a history."""
    frame, weights = history.get_distribution(0, history.max_t)
    sums_weights, sums = history.get_weighted_sum_stats(history.max_t)
    shares = frame[problem.names].to_numpy(dtype=float)
    weights = np.asarray(weights, dtype=float)
    residuals = np.array([entry["z"] for entry in sums], dtype=float)
    assert np.allclose(np.asarray(sums_weights), weights)
    return Draws(
        shares, weights / weights.sum(), residuals, _temperature(history),
        int(history.max_t) + 1, int(history.total_nr_simulations),
    )  # fmt: skip
