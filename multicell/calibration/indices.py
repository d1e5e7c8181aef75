"""Indices of sensitivity from samples of the unit cube, by SALib, set against the noise of seeds.

Morris: elementary effects, the change of an observable as one parameter goes through its whole
range, at random places of a grid: mean ``mu``, mean size ``mu_star`` and standard deviation
``sigma`` (Morris 1991, doi:10.1080/00401706.1991.10484804; Campolongo, Cariboni & Saltelli 2007,
doi:10.1016/j.envsoft.2006.10.004). Sobol': the part of the variance that a parameter makes alone,
``S1``, and with all its interactions, ``ST`` (Saltelli et al. 2010,
doi:10.1016/j.cpc.2009.09.018). Half widths of 95 % intervals of Sobol' are by bootstrap over the
sample. Those of Morris are Student's for the mean of as many sizes of effects as there are
trajectories: of few of them a bootstrap is too narrow (it covers 77 to 90 % of four, 85 to 90 % of
ten; Student's 87 to 96 % of four and 93 to 97 % from six on).

Runs are random themselves. Both methods take differences of two runs that differ in one parameter,
with the same seeds; over k seeds such a difference d has the variance var(d)/k in its mean. Noise
alone adds mean(var(d)/k)/2 over the variance to ``ST``, and to ``mu_star`` of a parameter without
effect it gives sqrt(2/pi) of the noise's standard deviation, as the mean size of a normal number.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from multicell.errors import SceneError
from multicell.studies.limits import MAX_POINTS, whole

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from multicell.cells import FloatArray

    Mask = NDArray[np.bool_]

METHODS: Final = ("morris", "sobol")
MIN_SIZE: Final = {"morris": 4, "sobol": 8}
"""Fewest trajectories, or base points, of which intervals mean anything."""
RELIABLE: Final = 6  # trajectories from which 95 % intervals of Morris cover as much
DEFAULT_SIZE: Final = {"morris": 10, "sobol": 64}
_LEVELS: Final = 4  # of the grid of Morris
_STEP: Final = _LEVELS / (2.0 * (_LEVELS - 1.0))  # of a parameter, in parts of its range
_SAMPLE: Final = 20261  # seed of the sample: the same one for any size, so that one can be widened
RESAMPLES: Final = 1000
_CONFIDENCE: Final = 0.95
_ROUNDING: Final = 1e-9  # of the size of an observable: smaller variation is rounding

CLEAR, NOISE, ZERO, CLEAR_SINGLE, UNKNOWN = (
    "clear",
    "not distinguishable from noise",
    "not distinguishable from zero",
    "clear of zero, noise unknown",
    "unknown",
)
"""What can be said of an index."""


COLUMNS: Final = {
    "morris": ("mu", "mu_star", "mu_star_conf", "sigma"),
    "sobol": ("s1", "s1_conf", "st", "st_conf"),
}
"""The indices of a method, the half widths of their 95 % intervals included."""
MAIN: Final = {"morris": "mu_star", "sobol": "st"}
"""The index of a method that decides what a parameter does."""


@final
@dataclass(frozen=True)
class Analysis:
    """The sensitivity of one observable to each parameter.

    - ``columns``, name -> (parameters,): of Morris ``mu``, ``mu_star``, ``mu_star_conf``, ``sigma``
      in the unit of the observable, for the whole range of the parameter; of Sobol' ``s1``,
      ``s1_conf``, ``st``, ``st_conf``, parts of the variance; ``noise``: what noise over the seeds
      alone gives to ``mu_star``, or adds to ``ST``. NaN where nothing is known.
    - ``verdicts``: :data:`CLEAR` if the index less its half width is above the noise;
      :data:`NOISE` if not, :data:`ZERO` where there is no noise; :data:`CLEAR_SINGLE` if it is
      above zero and the noise is unknown; :data:`UNKNOWN` without an index
    - ``used``: trajectories, or base points, of which all runs have a value
    - ``constant``: whether the observable is the same in all of them: then every index is zero
    """

    columns: Mapping[str, FloatArray]
    verdicts: Sequence[str]
    used: int
    constant: bool = False


def check_size(method: str, size: int) -> None:
    """Refuse an unknown method and a size with which it tells nothing."""
    if method not in METHODS:
        raise SceneError("method", f"is {method!r}, must be one of {', '.join(METHODS)}")
    what = "trajectories" if method == "morris" else "base points"
    if size < MIN_SIZE[method]:
        problem = f"is {size}: too few {what} for an interval, must be at least {MIN_SIZE[method]}"
        raise SceneError("size", problem, f"{DEFAULT_SIZE[method]} are usual.")
    whole("size", size, 1, MAX_POINTS, f"It is the number of {what}.")
    if method == "sobol" and size & (size - 1):
        lower = 1 << (size.bit_length() - 1)
        hint = f"Take {lower} or {2 * lower}."
        raise SceneError("size", f"is {size}, must be a power of two for a Sobol' sequence", hint)


def block(method: str, parameters: int) -> int:
    """Return how many points belong to one trajectory, or to one base point."""
    return parameters + (1 if method == "morris" else 2)


def sample(method: str, names: Sequence[str], size: int) -> FloatArray:
    """Return points of the unit cube, (size * block, parameters).

    A larger sample begins with the smaller one, so that it can be widened. ``check_size`` goes
    before.
    """
    problem = _problem(names)
    if method == "morris":
        from SALib.sample import morris

        return np.asarray(morris.sample(problem, size, num_levels=_LEVELS, seed=_SAMPLE))
    from SALib.sample import sobol

    return np.asarray(sobol.sample(problem, size, calc_second_order=False, seed=_SAMPLE))


def analyse(
    method: str, names: Sequence[str], shares: FloatArray, values: FloatArray,
) -> Analysis:  # fmt: skip
    """Return the indices of one observable.

    - ``method``: ``"morris"`` or ``"sobol"``
    - ``names``: of the parameters
    - ``shares``, (n, parameters): as :func:`sample` gives them
    - ``values``, (n, seeds): the observable; NaN where a run has none. A trajectory or base point
      is left out with the seeds that lack a value at one of its points.
    """
    wide = block(method, len(names))
    blocks = values.reshape(-1, wide, values.shape[1])
    whole: Mask = np.asarray(np.isfinite(blocks).all(axis=1))  # (blocks, seeds)
    kept: Mask = np.asarray(whole.any(axis=1))
    used = int(kept.sum())
    if used < 2:
        return _alike(method, len(names), math.nan, UNKNOWN, used)
    place = np.repeat(kept, wide)
    mean = np.stack([b[:, w].mean(axis=1) for b, w in zip(blocks[kept], whole[kept], strict=True)])
    if np.ptp(mean) <= _ROUNDING * np.abs(mean).max():
        return _alike(method, len(names), 0.0, ZERO, used)
    noise = _noise(method, shares[place], blocks[kept], whole[kept])
    find, main = _morris if method == "morris" else _sobol, MAIN[method]
    columns = {n: np.asarray(x, dtype=float) for n, x in find(names, shares[place], mean).items()}
    floor = columns["noise"] = _floor(method, noise, mean)
    lower = columns[main] - columns[f"{main}_conf"]
    return Analysis(columns, list(map(_verdict, lower.tolist(), floor.tolist())), used)


def _problem(names: Sequence[str]) -> dict[str, Any]:
    return {"num_vars": len(names), "names": list(names), "bounds": [[0.0, 1.0]] * len(names)}


def _alike(method: str, count: int, value: float, verdict: str, used: int) -> Analysis:
    """Return an analysis whose indices are all one number: 0 of what is the same everywhere."""
    columns = {name: np.full(count, value) for name in (*COLUMNS[method], "noise")}
    return Analysis(columns, [verdict] * count, used, constant=value == 0.0)


def _morris(names: Sequence[str], shares: FloatArray, mean: FloatArray) -> dict[str, FloatArray]:
    """Return SALib's indices of means, (trajectories, parameters + 1)."""
    from SALib.analyze import morris
    from scipy import stats

    # of its bootstrap nothing is used
    found = morris.analyze(
        _problem(names), shares, mean.ravel(), num_resamples=2, num_levels=_LEVELS, seed=_SAMPLE
    )
    count = len(mean)
    student = float(stats.t.isf(0.5 - 0.5 * _CONFIDENCE, count - 1) / math.sqrt(count))
    squares = found["sigma"] ** 2 + (found["mu"] ** 2 - found["mu_star"] ** 2) * count / (count - 1)
    spread = np.sqrt(np.maximum(squares, 0.0))  # of the sizes of effects
    return {
        "mu": found["mu"], "mu_star": found["mu_star"], "mu_star_conf": student * spread,
        "sigma": found["sigma"],
    }  # fmt: skip


def _sobol(names: Sequence[str], _: FloatArray, mean: FloatArray) -> dict[str, FloatArray]:
    """Return SALib's indices of means, (base points, parameters + 2)."""
    from SALib.analyze import sobol

    with warnings.catch_warnings():
        # a resample of few points may be constant; its variance is left out by SALib
        warnings.filterwarnings("ignore", message="Constant values encountered")
        found = sobol.analyze(
            _problem(names), mean.ravel(), calc_second_order=False, num_resamples=RESAMPLES,
            conf_level=_CONFIDENCE, seed=_SAMPLE,
        )  # fmt: skip
    return {name.lower(): found[name] for name in ("S1", "S1_conf", "ST", "ST_conf")}


def _floor(method: str, noise: FloatArray, mean: FloatArray) -> FloatArray:
    """Return what the noise of differences alone gives to the indices, (parameters,)."""
    if method == "morris":
        return np.sqrt(2.0 / math.pi * noise) / _STEP
    variance = float(np.concatenate([mean[:, 0], mean[:, -1]]).var())
    return 0.5 * noise / (variance or math.nan)


def _noise(method: str, shares: FloatArray, blocks: FloatArray, whole: Mask) -> FloatArray:
    """Return the mean variance, by noise over seeds, of the differences made by each parameter.

    - ``shares``, (blocks * points, parameters)
    - ``blocks``, (blocks, points, seeds)
    - ``whole``, (blocks, seeds) bool: which seeds count

    Returns (parameters,): NaN if no block has two seeds.
    """
    count = shares.shape[1]
    places = shares.reshape(len(blocks), -1, count)
    totals, numbers = np.zeros(count), np.zeros(count)
    for points, values, seeds in zip(places, blocks, whole, strict=True):
        own = values[:, seeds]
        if own.shape[1] < 2:
            continue
        for k in range(count):
            first, second = _pair(method, points, k)
            difference = own[second] - own[first]
            totals[k] += difference.var(ddof=1) / len(difference)
            numbers[k] += 1.0
    return np.where(numbers > 0.0, totals / np.maximum(numbers, 1.0), np.nan)


def _pair(method: str, points: FloatArray, parameter: int) -> tuple[int, int]:
    """Return which two points of a block differ in one parameter."""
    if method == "sobol":
        return 0, parameter + 1
    moved = np.abs(np.diff(points, axis=0)).argmax(axis=1)
    place = int(np.flatnonzero(moved == parameter)[0])
    return place, place + 1


def _verdict(lower: float, floor: float) -> str:
    """Return what can be said of an index by its lower end and the noise."""
    if not math.isfinite(lower):
        return UNKNOWN
    if not math.isfinite(floor):
        return CLEAR_SINGLE if lower > 0.0 else ZERO
    if lower > floor:
        return CLEAR
    return NOISE if floor > 0.0 else ZERO
