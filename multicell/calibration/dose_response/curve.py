"""Hill's curve of a response over doses: its fit, its half-maximal doses, their 95 % intervals.

The response is taken relative to that without a dose (viability), and

    E(d) = bottom + (1 - bottom) / (1 + (d / EC50)^h)

(Hill 1910) is fitted to the means at the doses by least squares, each weighted by its number of
runs, which gives the same curve as a fit to the single runs. ``bottom`` is not negative, and h lies
between 0.1 and 20.

Intervals are percentiles over fits to other means: the deviation of each seed from the mean is
multiplied by a normal number of its own, the same one at all doses (multiplier bootstrap over the
seeds, after Wu 1986), and all of them by the root of f / chi²(f). So means have Student's
t-distribution with f = seeds - 1 degrees of freedom, which few seeds need, and what the runs of one
seed share at all doses is not taken for noise. Replicates that are not shared by the doses have a
number each, and f is their count less that of the doses. Without any replicates the scatter is that
of the means about the curve.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, final

import numpy as np

from multicell.calibration.shared.confidence import TAILS
from multicell.errors import FitFailed

if TYPE_CHECKING:
    from multicell.cells import FloatArray

LEAST: Final = 4
"""Doses above zero that a curve needs."""
DOSES: Final[Mapping[int, tuple[str, ...]]] = {1: ("dose",), 2: ("dose A", "dose B")}
"""Titles of the columns of doses, by the number of drugs."""

TOTALS: Final = {"bliss_excess": "mean Bliss excess", "loewe_index": "mean Loewe index"}
# steepness of Hill curves that is fitted: data say nothing of a flatter or steeper one
_SLOPES: Final = (0.1, 20.0)


@final
@dataclass(frozen=True)
class Estimate:
    """A number with its 95 % interval.

    - ``value``: NaN where it lies outside the doses tested
    - ``low``, ``high``: ends of the interval; of doses 0 below the lowest dose tested and infinite
      above the largest; NaN where nothing is known of the scatter
    - ``words``: value and interval
    """

    value: float
    low: float
    high: float
    words: str


@final
@dataclass(frozen=True, eq=False)
class DoseCurve:
    """The curve of one drug.

    - ``name``, ``unit``: of its doses
    - ``doses``, (m,): the control, 0, and rising doses
    - ``viability``, (m,): mean response at each over that of the control
    - ``ic50``: dose at which the viability is one half
    - ``ec50``: dose half-way between 1 and ``bottom``: the inflection over the logarithm
    - ``slope``: Hill's h
    - ``bottom``: viability at the largest dose
    - ``error``: root mean square deviation of the means from the curve
    - ``parameters``, (3,): bottom, log EC50, h
    - ``draws``, (k, 3): the same of the fits that make the intervals; none where nothing is known
      of the scatter
    """

    name: str
    unit: str
    doses: FloatArray
    viability: FloatArray
    ic50: Estimate
    ec50: Estimate
    slope: Estimate
    bottom: Estimate
    error: float
    parameters: FloatArray
    draws: FloatArray

    def __call__(self, doses: FloatArray) -> FloatArray:
        """Return the viability at doses."""
        return hill(doses, self.parameters)

    def band(self, doses: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the ends of the 95 % interval of the curve at doses above zero."""
        low, high = np.nanquantile(hill(doses, self.draws), TAILS, axis=0)
        return low, high

    def dose_at(self, level: float) -> float:
        """Return the dose of a viability: 0 or infinite where the curve does not come to it."""
        return float(dose_at(level, self.parameters))

    @property
    def estimates(self) -> dict[str, Estimate]:
        """The estimates by what they are called."""
        return {"IC50": self.ic50, "EC50": self.ec50, "slope": self.slope, "bottom": self.bottom}


def hill(doses: FloatArray, parameters: FloatArray) -> FloatArray:
    """Return Hill's curve at doses (m,) for parameters (..., 3): (..., m)."""
    from scipy.special import expit

    bottom, place, slope = np.moveaxis(parameters[..., None, :], -1, 0)
    return np.asarray(bottom + (1.0 - bottom) * expit(slope * (place - _logs(doses))))


def dose_at(level: FloatArray | float, parameters: FloatArray) -> FloatArray:
    """Return the doses at which curves (..., 3) come to a level: 0 or infinite if they do not."""
    bottom, place, slope = np.moveaxis(parameters, -1, 0)
    with np.errstate(all="ignore"):
        dose = np.exp(place + np.log((1.0 - level) / (level - bottom)) / slope)
    beyond = np.where((1.0 - level) * np.sign(1.0 - bottom) > 0.0, np.inf, 0.0)
    return np.where(np.isnan(dose) & ~np.isnan(place), beyond, dose)


def _logs(doses: FloatArray) -> FloatArray:
    """Return logarithms; that of 0 so low that every curve is at 1 there."""
    return np.log(np.maximum(doses, 1e-300))


def fit_curve(
    doses: FloatArray,
    means: FloatArray,
    counts: FloatArray,
    draws: FloatArray | None,
    *,
    name: str,
    unit: str,
    resamples: int,
    seed: int = 0,
) -> DoseCurve:
    """Fit Hill's curve to mean responses.

    - ``doses``, ``means``, ``counts``, (m,): the control, then rising doses; mean response and
      number of runs at each
    - ``draws``, (k, m): other means, of :func:`draw_means`; None where nothing is known of the
      scatter at a dose
    - ``name``, ``unit``: of the doses
    - ``resamples``, ``seed``: number of fits for intervals and seed of their random numbers, where
      there are no draws
    """
    if len(doses) - 1 < LEAST:
        problem = f"{len(doses) - 1} doses of {name} above zero have a response"
        raise FitFailed(problem, f"A curve needs at least {LEAST}.")
    if np.ptp(means) == 0.0:
        problem = f"the response is {means[0]:g} at all doses of {name}"
        raise FitFailed(problem, "There is no curve to fit: test larger doses, or for longer.")
    weights = np.sqrt(counts)
    places = _logs(doses)
    viability = means / means[0]

    def fit(values: FloatArray, start: FloatArray, tolerance: float) -> tuple[FloatArray, float]:
        return _least_squares(places, values, weights, start, tolerance)

    end = max(float(viability.min()), 0.05)
    starts = [np.array([p, k, end]) for p in places[1:] for k in (-3.0, -1.7)]
    coded, cost = min(
        (fit(viability, start, 1e-10) for start in starts), key=lambda found: found[1]
    )
    parameters = np.array(_decoded(coded))
    start = coded.copy()
    # the bottom is a square: where it is zero, the search could not leave it
    start[2] = max(abs(float(start[2])), 0.05)
    freedom = len(doses) - 4  # the control is no datum
    if draws is None and freedom > 0:
        sigma = math.sqrt(cost / freedom) * means[0] / weights
        draws = _scattered(
            hill(doses, parameters) * means[0], np.diag(sigma), freedom, resamples, seed
        )
    found = np.full((0 if draws is None else len(draws), 3), np.nan)
    for row, drawn in enumerate(() if draws is None else draws):
        if drawn[0] > 0.0:
            found[row] = _decoded(fit(drawn / drawn[0], start, 1e-5)[0])
    low, high = float(doses[1]), float(doses[-1])
    half = dose_at(0.5, parameters), dose_at(0.5, found)
    centre = np.exp(parameters[1]), np.exp(found[:, 1])
    return DoseCurve(
        name,
        unit,
        doses,
        viability,
        _dose(float(half[0]), half[1], low, high, unit),
        _dose(float(centre[0]), centre[1], low, high, unit),
        _estimate(parameters[2], found[:, 2]),
        _estimate(parameters[0], found[:, 0]),
        math.sqrt(np.mean((hill(doses, parameters) - viability) ** 2)),
        parameters,
        found,
    )


def draw_means(
    values: FloatArray, shared: bool, resamples: int, seed: int = 0
) -> FloatArray | None:
    """Return means of responses as they may have come out with other seeds, (k, m).

    None without replicates.

    - ``values``, (m, n): responses at m doses, NaN where there is none
    - ``shared``: whether the replicates in a column belong together, as runs of one seed do
    - ``resamples``, ``seed``: their number k, and the seed of NumPy's default generator
    """
    there = np.isfinite(values)
    counts = there.sum(axis=1)
    means = np.nanmean(values, axis=1)
    apart = np.where(there, values - means[:, None], 0.0)
    columns = values.shape[1]
    if shared and there.all():
        freedom = columns - 1
        factors = apart.T / math.sqrt(columns * max(freedom, 1))
    else:
        freedom = int((counts - 1).sum())
        factors = np.diag(np.sqrt((apart**2).sum() / max(freedom, 1) / counts))
    if freedom < 1:
        return None
    return _scattered(means, factors, freedom, resamples, seed)


def _scattered(
    means: FloatArray, factors: FloatArray, freedom: int, resamples: int, seed: int
) -> FloatArray:
    """Return draws (k, m) from Student's distribution: factors (r, m) of independent numbers."""
    rng = np.random.default_rng(seed)
    normal = rng.standard_normal((resamples, len(factors)))
    scale = np.sqrt(freedom / rng.chisquare(freedom, (resamples, 1)))
    return np.asarray(means + scale * normal @ factors)


def _least_squares(
    places: FloatArray, values: FloatArray, weights: FloatArray, start: FloatArray, tolerance: float
) -> tuple[FloatArray, float]:
    """Return coded parameters (log EC50, slope, bottom) and sum of squares."""
    from scipy.optimize import leastsq  # least_squares takes three times as long for so few data

    def parts(coded: FloatArray) -> tuple[float, float, float, FloatArray]:
        bottom, place, slope = _decoded(coded)
        return bottom, place, slope, 1.0 / (1.0 + np.exp(slope * (places - place)))

    def residuals(coded: FloatArray) -> FloatArray:
        bottom, _, _, share = parts(coded)
        return np.asarray(weights * (bottom + (1.0 - bottom) * share - values))

    def jacobian(coded: FloatArray) -> list[FloatArray]:
        bottom, place, slope, share = parts(coded)
        rise = (weights * (1.0 - bottom) * slope) * share * (1.0 - share)
        part = (slope - _SLOPES[0]) * (_SLOPES[1] - slope) / (_SLOPES[1] - _SLOPES[0]) / slope
        floor = weights * (2.0 * coded[2])
        return [rise, rise * part * (place - places), floor * (1.0 - share)]

    # with full output there are no warnings, as of a slope at its end: the curve is the best one
    with np.errstate(all="ignore"):
        found = leastsq(
            residuals,
            start,
            Dfun=jacobian,
            full_output=True,
            col_deriv=True,
            ftol=tolerance,
            xtol=tolerance,
            maxfev=200,
        )[0]
        return found, float((residuals(found) ** 2).sum())


def _decoded(coded: FloatArray) -> tuple[float, float, float]:
    """Return bottom, log EC50 and slope of unbounded numbers."""
    place, slope, bottom = coded.tolist()
    low, high = _SLOPES
    part = 1.0 / (1.0 + math.exp(-slope)) if slope > -700.0 else 0.0
    return bottom * bottom, place, low + (high - low) * part


def _quantiles(draws: FloatArray, least: float = -math.inf) -> tuple[float, float]:
    """Return the ends of the 95 % interval of draws; one without a value may be any from least."""
    if not len(draws):
        return math.nan, math.nan
    low, high = (np.where(np.isnan(draws), beyond, draws) for beyond in (least, np.inf))
    first = np.quantile(low, TAILS[0], method="inverted_cdf")
    return float(first), float(np.quantile(high, TAILS[1], method="inverted_cdf"))


def _estimate(value: float, draws: FloatArray, least: float = -math.inf) -> Estimate:
    """Return a number with its interval."""
    low, high = _quantiles(draws, least)
    texts = [f"{round(number, 4) + 0.0:.3g}" for number in (value, low, high)]
    interval = "" if math.isnan(low) else f" (95 %: {texts[1]} to {texts[2]})"
    return Estimate(float(value), low, high, f"{texts[0]}{interval}")


def _dose(value: float, draws: FloatArray, lowest: float, largest: float, unit: str) -> Estimate:
    """Return a dose with its interval; values outside the doses tested are not given."""
    low, high = _quantiles(draws)
    unit = f" {unit}" if unit else ""

    def bound(end: float) -> str:
        if end < lowest:
            return f"below {lowest:.3g}"
        return f"above {largest:.3g}" if end > largest else f"{end:.3g}"

    ends = [0.0 if end < lowest else math.inf if end > largest else end for end in (low, high)]
    inside = lowest <= value <= largest
    words = f"{value:.3g}{unit}" if inside else f"not reached: {bound(value)}{unit}"
    if not math.isnan(low):
        words += f" (95 %: {bound(low)} to {bound(high)})"
    return Estimate(value if inside else math.nan, ends[0], ends[1], words)


def combine_drugs(
    points: FloatArray, viability: FloatArray, draws: FloatArray | None, curves: Sequence[DoseCurve]
) -> tuple[list[dict[str, float | bool]], dict[str, Estimate]]:
    """Compare two drugs together with each drug alone.

    ``bliss_excess`` is E_A E_B - E_AB, with the viabilities at each dose alone: above zero fewer
    survive than if the drugs acted independently (Bliss 1939). ``loewe_index`` is
    d_A / D_A + d_B / D_B with the doses D of each drug alone that leave as many alive, by their
    curves: 1 for doses that add up, as those of one drug do, below 1 where they do more (Loewe
    1953; Greco et al. 1995). It is NaN where one drug alone never leaves so few alive, and
    ``extrapolated`` where D lies beyond the doses tested.

    Returned are a row for each point with both drugs (``..._low``, ``..._high`` are ends of 95 %
    intervals), the mean of the excess over all points, and the geometric mean of the index over
    those where it is known within the doses tested.

    - ``points``, (m, 2): doses of both, with the control and each of the doses alone among them
    - ``viability``, (m,); ``draws``, (k, m): of the viability, or None
    - ``curves``: of both drugs alone
    """
    known = np.full((0, len(points)), np.nan) if draws is None else draws
    place = {tuple(point): k for k, point in enumerate(points.tolist())}
    rows: list[dict[str, float | bool]] = []
    found: dict[str, list[tuple[float, FloatArray]]] = {"bliss_excess": [], "loewe_index": []}
    for (a, b), k in place.items():
        if a == 0.0 or b == 0.0:
            continue
        one, other = place[a, 0.0], place[0.0, b]
        alone = np.array([curve.dose_at(viability[k]) for curve in curves])
        drawn = [dose_at(known[:, k], curve.draws[: len(known)]) for curve in curves]
        excess = float(viability[one] * viability[other] - viability[k])
        numbers = {
            "viability": (float(viability[k]), known[:, k]),
            "bliss_excess": (excess, known[:, one] * known[:, other] - known[:, k]),
            "loewe_index": (float(_index(a, b, *alone)), _index(a, b, *drawn)),
        }
        row: dict[str, float | bool] = {"dose A": a, "dose B": b}
        for name, (value, others) in numbers.items():
            least = 0.0 if name == "loewe_index" else -math.inf
            low, high = _quantiles(others, least) if math.isfinite(value) else (math.nan, math.nan)
            row |= {name: value, f"{name}_low": low, f"{name}_high": high}
        index = numbers["loewe_index"][0]
        beyond = any(d > c.doses[-1] for d, c in zip(alone, curves, strict=True))
        rows.append(row | {"extrapolated": math.isfinite(index) and beyond})
        found["bliss_excess"].append(numbers["bliss_excess"])
        if math.isfinite(index) and not beyond:
            found["loewe_index"].append((math.log(index), np.log(numbers["loewe_index"][1])))
    means = {}
    for name, entries in found.items():
        if entries:
            value = float(np.mean([entry[0] for entry in entries]))
            others = np.mean([entry[1] for entry in entries], axis=0)
            means[name] = _estimate(value, others)
            if name == "loewe_index":
                means[name] = _estimate(math.exp(value), np.exp(others), 0.0)
    return rows, means


def _index(a: float, b: float, alone_a: FloatArray, alone_b: FloatArray) -> FloatArray:
    """Return Loewe's index; NaN where one drug alone does not come to the viability."""
    reached = np.isfinite(alone_a) & np.isfinite(alone_b) & (alone_a > 0.0) & (alone_b > 0.0)
    with np.errstate(all="ignore"):
        return np.where(reached, a / alone_a + b / alone_b, np.nan)
