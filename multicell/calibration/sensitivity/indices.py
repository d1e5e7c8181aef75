"""Indices of sensitivity by Morris from samples of the unit cube, set against the noise of seeds.

Elementary effects are the changes of an observable as one parameter goes through its whole range,
at random places of a grid: mean ``mu``, mean size ``mu_star`` and standard deviation ``sigma``
(Morris 1991, doi:10.1080/00401706.1991.10484804; Campolongo, Cariboni & Saltelli 2007,
doi:10.1016/j.envsoft.2006.10.004), by SALib. Half widths of 95 % intervals are Student's for the
mean of as many sizes of effects as there are trajectories: of few of them a bootstrap is too narrow
(it covers 77 to 90 % of four, 85 to 90 % of ten; Student's 87 to 96 % of four and 93 to 97 % from
six on).

Runs are random themselves. An effect is the difference of two runs that differ in one parameter,
with the same seeds; over k seeds such a difference d has the variance var(d)/k in its mean. Noise
alone gives to ``mu_star`` of a parameter without effect sqrt(2/pi) of the noise's standard
deviation, as the mean size of a normal number.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from multicell.calibration.shared.confidence import LEVEL

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from multicell.cells import FloatArray

    Mask = NDArray[np.bool_]

MIN_SIZE: Final = 4
"""Fewest trajectories of which intervals mean anything."""
RELIABLE: Final = 6  # trajectories from which 95 % intervals cover as much
_LEVELS: Final = 4  # of the grid
_STEP: Final = _LEVELS / (2.0 * (_LEVELS - 1.0))  # of a parameter, in parts of its range
_SAMPLE: Final = 20261  # seed of the sample: the same one for any size, so that one can be widened
_ROUNDING: Final = 1e-9  # of the size of an observable: smaller variation is rounding

CLEAR, NOISE, ZERO, CLEAR_SINGLE, UNKNOWN = (
    "clear",
    "not distinguishable from noise",
    "not distinguishable from zero",
    "clear of zero, noise unknown",
    "unknown",
)
"""What can be said of an index."""
INDEX_COLUMNS: Final = ("mu", "mu_star", "mu_star_conf", "sigma", "noise")
"""The columns of an analysis."""


@final
@dataclass(frozen=True)
class Analysis:
    """The sensitivity of one observable to each parameter.

    - ``columns``, name -> (parameters,): ``mu``, ``mu_star``, the half width ``mu_star_conf`` of
      its 95 % interval and ``sigma`` in the unit of the observable, for the whole range of the
      parameter; ``noise``: what noise over the seeds alone gives to ``mu_star``. NaN where nothing
      is known.
    - ``verdicts``: :data:`CLEAR` if the index less its half width is above the noise;
      :data:`NOISE` if not, :data:`ZERO` where there is no noise; :data:`CLEAR_SINGLE` if it is
      above zero and the noise is unknown; :data:`UNKNOWN` without an index
    - ``used``: trajectories of which all runs have a value
    - ``constant``: whether the observable is the same in all of them: then every index is zero
    """

    columns: Mapping[str, FloatArray]
    verdicts: Sequence[str]
    used: int
    constant: bool = False


def sample(names: Sequence[str], size: int) -> FloatArray:
    """Return points of the unit cube, trajectories in turn: (size * (parameters + 1), parameters).

    A larger sample begins with the smaller one, so that it can be widened.
    """
    from SALib.sample import morris

    return np.asarray(morris.sample(unit_cube(names), size, num_levels=_LEVELS, seed=_SAMPLE))


def sensitivity_indices(names: Sequence[str], shares: FloatArray, values: FloatArray) -> Analysis:
    """Return the indices of one observable.

    - ``names``: of the parameters
    - ``shares``, (n, parameters): as :func:`sample` gives them
    - ``values``, (n, seeds): the observable; NaN where a run has none. A trajectory is left out
      with the seeds that lack a value at one of its points.
    """
    wide = len(names) + 1
    blocks = values.reshape(-1, wide, values.shape[1])
    whole: Mask = np.asarray(np.isfinite(blocks).all(axis=1))  # (blocks, seeds)
    kept: Mask = np.asarray(whole.any(axis=1))
    used = int(kept.sum())
    if used < 2:
        return _alike(len(names), math.nan, UNKNOWN, used)
    mean = np.stack([b[:, w].mean(axis=1) for b, w in zip(blocks[kept], whole[kept], strict=True)])
    if np.ptp(mean) <= _ROUNDING * np.abs(mean).max():
        return _alike(len(names), 0.0, ZERO, used)
    shares = shares[np.repeat(kept, wide)]
    floor = np.sqrt(2.0 / math.pi * _noise(shares, blocks[kept], whole[kept])) / _STEP
    columns = _effects(names, shares, mean) | {"noise": floor}
    lower = columns["mu_star"] - columns["mu_star_conf"]
    return Analysis(columns, list(map(_verdict, lower.tolist(), floor.tolist())), used)


def unit_cube(names: Sequence[str]) -> dict[str, Any]:
    """Return parameters between 0 and 1 as SALib takes them."""
    return {"num_vars": len(names), "names": list(names), "bounds": [[0.0, 1.0]] * len(names)}


def _alike(count: int, value: float, verdict: str, used: int) -> Analysis:
    """Return an analysis whose indices are all one number: 0 of what is the same everywhere."""
    columns = {name: np.full(count, value) for name in INDEX_COLUMNS}
    return Analysis(columns, [verdict] * count, used, constant=value == 0.0)


def _effects(names: Sequence[str], shares: FloatArray, mean: FloatArray) -> dict[str, FloatArray]:
    """Return SALib's indices of means, (trajectories, parameters + 1)."""
    from SALib.analyze import morris
    from scipy import stats

    # of its bootstrap nothing is used
    found = morris.analyze(
        unit_cube(names), shares, mean.ravel(), num_resamples=2, num_levels=_LEVELS, seed=_SAMPLE
    )
    count = len(mean)
    student = float(stats.t.isf(0.5 - 0.5 * LEVEL, count - 1) / math.sqrt(count))
    squares = found["sigma"] ** 2 + (found["mu"] ** 2 - found["mu_star"] ** 2) * count / (count - 1)
    spread = np.sqrt(np.maximum(squares, 0.0))  # of the sizes of effects
    columns = {name: found[name] for name in ("mu", "mu_star", "sigma")}
    columns["mu_star_conf"] = student * spread
    return {name: np.asarray(column, dtype=float) for name, column in columns.items()}


def _noise(shares: FloatArray, blocks: FloatArray, whole: Mask) -> FloatArray:
    """Return the mean variance, by noise over seeds, of the differences made by each parameter.

    - ``shares``, (blocks * points, parameters)
    - ``blocks``, (blocks, points, seeds)
    - ``whole``, (blocks, seeds) bool: which seeds count

    Returns (parameters,): NaN if no block has two seeds.
    """
    steps = np.diff(shares.reshape(len(blocks), -1, shares.shape[1]), axis=1)
    moved = np.abs(steps).argmax(axis=2)  # the parameter that each step of a trajectory changes
    known = [
        (np.diff(values[:, seeds], axis=0).var(axis=1, ddof=1) / seeds.sum())[np.argsort(order)]
        for order, values, seeds in zip(moved, blocks, whole, strict=True)
        if seeds.sum() > 1
    ]
    return np.mean(known, axis=0) if known else np.full(shares.shape[1], np.nan)


def _verdict(lower: float, floor: float) -> str:
    """Return the verdict on an index by its lower end and the noise."""
    if not math.isfinite(lower):
        return UNKNOWN
    if not math.isfinite(floor):
        return CLEAR_SINGLE if lower > 0.0 else ZERO
    if lower > floor:
        return CLEAR
    return NOISE if floor > 0.0 else ZERO
