"""Sobol' indices of a scene's parameters by SALib: which part of the variance each one makes.

Points are those of Saltelli (2010, Comput. Phys. Commun. 181, 259) on a scrambled Sobol' sequence:
``size`` times the number of parameters and 2. ``S1`` is the part of an observable's variance that a
parameter makes alone, ``ST`` that with all its interactions; half widths of their 95 % intervals
are SALib's, by resampling. Parameters are spread evenly over their ranges, logarithmic ones over
their logarithms.

Runs are random themselves. Their mean over k seeds has the variance s²/k, which is in the
variance that is parted, so that the indices of all parameters add up to less than 1; ``noise`` is
its part.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from multicell.calibration.sensitivity.indices import unit_cube
from multicell.calibration.sensitivity.numbers import Row, failure_notes, index_rows
from multicell.calibration.sensitivity.result import SobolIndices
from multicell.calibration.shared.confidence import LEVEL
from multicell.errors import SceneError
from multicell.units import shown

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.scene.scene import Scene
    from multicell.studies.axes import Range

LEAST_SIZE: Final = 8  # places: of fewer no interval can be resampled
COLUMNS_SOBOL: Final = ("S1", "S1_conf", "ST", "ST_conf", "noise")
_SAMPLE: Final = 20262  # seed of the sequence
_ROUNDING: Final = 1e-9  # of the size of an observable: smaller variation is rounding


def sobol_sample(names: Sequence[str], size: int) -> FloatArray:
    """Return points of the unit cube, (size * (parameters + 2), parameters).

    Raises SceneError unless the size is a power of two: others are no Sobol' sequence.
    """
    from SALib.sample import sobol

    if size < LEAST_SIZE or size & (size - 1):
        hint = f"Take {1 << max(int(size) - 1, LEAST_SIZE - 1).bit_length()}."
        problem = f"is {shown(size)}, must be a power of two, at least {LEAST_SIZE}"
        raise SceneError("size", problem, hint)
    cube = unit_cube(names)
    found = sobol.sample(cube, size, calc_second_order=False, scramble=True, seed=_SAMPLE)
    return np.asarray(found, dtype=float)


def sobol_indices(names: Sequence[str], values: FloatArray) -> tuple[dict[str, FloatArray], int]:
    """Return the indices of one observable, and the number of points of the sequence in use.

    - ``values``, (n, seeds): at the points of :func:`sobol_sample`; NaN where a run has none.
      All points of a place in the sequence are left out where one lacks its value.

    Returns dict of :data:`COLUMNS_SOBOL` to (parameters,), int: NaN where fewer than
    ``LEAST_SIZE`` places are left or the observable does not vary.
    """
    from SALib.analyze import sobol

    wide = len(names) + 2
    blocks = values.reshape(-1, wide, values.shape[1])
    whole = np.isfinite(blocks).all(axis=(1, 2))
    used = int(whole.sum())
    nothing = {name: np.full(len(names), np.nan) for name in COLUMNS_SOBOL}
    if used < LEAST_SIZE:
        return nothing, used
    kept = blocks[whole]
    mean = kept.mean(axis=2).ravel()
    if np.ptp(mean) <= _ROUNDING * np.abs(mean).max():
        return nothing, used
    found = sobol.analyze(
        unit_cube(names), mean, calc_second_order=False, conf_level=LEVEL, seed=_SAMPLE
    )
    seeds = values.shape[1]
    noise = kept.var(axis=2, ddof=1).mean() / seeds / mean.var() if seeds > 1 else math.nan
    columns = {name: np.asarray(found[name], dtype=float) for name in COLUMNS_SOBOL[:-1]}
    return columns | {"noise": np.full(len(names), noise)}, used


def sobol_result(
    scene: Scene,
    ranges: Sequence[Range],
    seeds: Sequence[int],
    values: Mapping[str, FloatArray],
    failures: Mapping[str, str],
) -> SobolIndices:
    """Return the indices of whatever has values at the points of :func:`sobol_sample`."""
    names = [free.name for free in ranges]
    size = len(next(iter(values.values()))) // (len(names) + 2)
    table: list[Row] = []
    notes = failure_notes(failures)
    for name, known in values.items():
        found, used = sobol_indices(names, known)
        if used < size:
            notes.append(f"{name}: {size - used} of {size} points lack a run")
        if np.isnan(found["ST"]).all():
            notes.append(f"{name} does not vary, or has too few points: no index is known")
        columns = {column: found[column].tolist() for column in COLUMNS_SOBOL}
        table += index_rows(name, ranges, columns)
    if len(seeds) == 1:
        notes.append("one seed: the part of the noise is unknown; take at least two")
    return SobolIndices(scene, tuple(ranges), size, tuple(seeds), table, notes, failures)
