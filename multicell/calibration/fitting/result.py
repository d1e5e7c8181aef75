"""The result of a fit: its numbers, with profiles, checks, pictures and the page."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import numpy as np

from multicell.calibration.fitting.numbers import FitNumbers
from multicell.calibration.shared.confidence import LEVEL
from multicell.errors import FitFailed
from multicell.host.extras import needs

if TYPE_CHECKING:
    from multicell.calibration.fitting.plots import FitPlots
    from multicell.calibration.fitting.predictive import PredictiveCheck
    from multicell.calibration.fitting.profile import LikelihoodProfile
    from multicell.calibration.fitting.profile_check import ProfileEnd


@final
class Fit(FitNumbers):
    """Parameters of a scene, fitted to data; :func:`multicell.fit` makes it.

    - ``problem``: data, ranges and what simulates
    - ``scene``: what was fitted
    - ``evaluations``: all parameters that the search tried
    - ``folder``: of the results, or None
    - ``facts``: how the fit was made: numbers of runs, seconds
    - ``fresh``: what runs with fresh seeds have shown at the best point and at draws from the
      intervals
    - ``readings``: what each run of the search and each fresh one has in place of its data, by
      place in the ranges, condition and seed; :attr:`runs` is a table of them
    - ``stated``: the problem with the errors that the data state, where ``problem`` has fitted ones
    """

    def profile(self, name: str, points: int = 41) -> LikelihoodProfile:
        """Return the profile likelihood of a parameter, by its name or key.

        Raises
        ------
        SceneError
            For a parameter that the fit does not have.
        FitFailed
            If there is no likelihood.
        """
        from multicell.calibration.fitting.profile import profile_of

        return profile_of(self, name, points)

    def check_profile(
        self,
        name: str,
        *,
        level: float = LEVEL,
        repeats: int = 6,
        cores: int | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> list[ProfileEnd]:
        """Run both ends of the interval of a profile with fresh seeds, to check the emulator.

        Ends that the data do not bound are left out. A fit with a folder keeps the runs.

        Parameters
        ----------
        name
            Of the parameter, or its key.
        level
            Confidence of the interval.
        repeats
            Runs at each end.
        cores
            Processes on this machine, by default one for each core.
        progress
            Called with the numbers of runs done and wanted.

        Raises
        ------
        SceneError
            For a parameter that the fit does not have.
        FitFailed
            If there is no likelihood, or runs show nothing.
        """
        from multicell.calibration.fitting.profile_check import checked_profile

        return checked_profile(
            self, name, level=level, repeats=repeats, cores=cores, progress=progress
        )

    def to_arviz(self) -> Any:
        """Return the posterior, its log-likelihood and the data as ArviZ takes them.

        An ``InferenceData`` of ArviZ below 1, a ``DataTree`` of xarray from 1 on. Groups are
        ``posterior``, ``log_likelihood`` (of all data together), ``posterior_predictive`` and
        ``observed_data`` (base units).

        Raises
        ------
        MissingPackage
            Without ArviZ.
        FitFailed
            If there is no posterior.
        """
        needs("arviz")
        import arviz

        shares, known = self.some_sample(), self.fresh.likelihood
        if known is None:
            raise FitFailed("there is no likelihood")
        problem = self.problem
        columns = problem.columns(shares)
        means = (
            problem.observed + np.maximum(known.predict(shares)[0], problem.lowest) * problem.sigma
        )
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

    def predictive_check(self) -> PredictiveCheck:
        """Return posterior predictive checks: whether data like these come from the posterior.

        Raises
        ------
        FitFailed
            If there is no posterior.
        """
        from multicell.calibration.fitting.predictive import predictive_check

        needs("pandas")
        return predictive_check(self)

    @property
    def plot(self) -> FitPlots:
        """Pictures: ``plot()`` shows data and runs, ``plot.parameters()`` the posterior."""
        from multicell.calibration.fitting.plots import FitPlots

        return FitPlots(self)

    def report(self, folder: str | Path | None = None) -> Path:
        """Write ``report.html`` with its pictures, and return the path of the page.

        Raises
        ------
        OutputError
            If there is no folder, or it cannot be written to.
        """
        from multicell.calibration.fitting.page import write_fit_report

        return write_fit_report(self, folder)

    def summary(self) -> dict[str, Any]:
        """Return the result as plain values."""
        best = self.best
        known, checked = {}, None
        if self.sample is not None:
            known, check = self.intervals(), self.predictive_check()
            checked = {x: getattr(check, x) for x in ("chi_squared", "largest", "outside")}
        parameters = {}
        for free in self.problem.ranges:
            found = known.get(free.name)
            parameters[free.key] = {
                "name": free.name,
                "unit": free.unit,
                "best": best.values[free.key],
                "median": found and found.median,
                "interval": found and [found.low, found.high],
                "part_of_range": found and found.part,
                "range": [free.low, free.high],
                "log": free.log,
            }
        return {
            "parameters": parameters,
            "chi_squared": best.chi_squared,
            "chi_squared_per_datum": best.per_datum,
            "chi_squared_chance": self.chance,
            "fits": not self.misfit,
            "contradictions": self.contradictions,
            "data": len(best.residuals),
            "undetermined": [
                {"names": list(u.names), "kind": u.kind, "words": u.words}
                for u in self.undetermined
            ],
            "predictive_check": checked,
            **({"scatter": {k: asdict(x) for k, x in self.scatter.items()}} if self.stated else {}),
            "residuals": self.rows(),
            "notes": self.notes,
            **self.facts,
        }
