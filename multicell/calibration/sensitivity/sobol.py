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
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from multicell.errors import OutputError, SceneError
from multicell.results.folder import file_errors, package_version, to_json, versions, write_text
from multicell.tables.text import table_text
from multicell.units import shown

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from multicell.calibration.sensitivity.analysis import SensitivityPlan
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
    problem_of = _cube(names)
    found = sobol.sample(problem_of, size, calc_second_order=False, scramble=True, seed=_SAMPLE)
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
        _cube(names), mean, calc_second_order=False, conf_level=0.95, seed=_SAMPLE
    )
    seeds = values.shape[1]
    noise = kept.var(axis=2, ddof=1).mean() / seeds / mean.var() if seeds > 1 else math.nan
    columns = {name: np.asarray(found[name], dtype=float) for name in COLUMNS_SOBOL[:-1]}
    return columns | {"noise": np.full(len(names), noise)}, used


def _cube(names: Sequence[str]) -> dict[str, Any]:
    return {"num_vars": len(names), "names": list(names), "bounds": [[0.0, 1.0]] * len(names)}


@final
@dataclass(frozen=True, eq=False)
class SobolIndices:
    """The parts of the variance of observables that parameters make.

    - ``ranges``: the free parameters
    - ``size``: points of the sequence; runs are ``size * (parameters + 2)`` for each seed
    - ``seeds``: runs at each point, whose observables are averaged
    - ``table``: a row for each observable and parameter: ``observable``, ``unit``, ``parameter``,
      ``key``, ``low``, ``high``, ``parameter_unit`` and :data:`COLUMNS_SOBOL`
    - ``notes``: what the reader must know
    - ``failures``: name of a run that failed -> reason
    """

    scene: Scene
    ranges: tuple[Range, ...]
    size: int
    seeds: tuple[int, ...]
    table: list[dict[str, Any]]
    notes: list[str]
    failures: Mapping[str, str]
    folder: Path | None = None

    @property
    def observables(self) -> list[str]:
        """Names of the observables."""
        return list(dict.fromkeys(row["observable"] for row in self.table))

    def ordered(self, observable: str) -> list[dict[str, Any]]:
        """Return the rows of an observable, the largest total index first."""
        rows = [row for row in self.table if row["observable"] == observable]
        return sorted(rows, key=lambda row: -np.nan_to_num(row["ST"]))

    def plot(self, observable: str | None = None) -> Figure:
        """Draw first and total indices of an observable with their intervals."""
        from multicell.calibration.sensitivity.sobol_page import sobol_bars

        return sobol_bars(self, observable or self.observables[0])

    def text(self) -> str:
        """Return the table in words."""
        lines = []
        for name in self.observables:
            lines.append(name.replace("_", " "))
            for row in self.ordered(name):
                first, total = (f"{row[x]:.3g} ± {row[f'{x}_conf']:.2g}" for x in ("S1", "ST"))
                lines.append(f"  {row['parameter']:24s} S1 {first:18s} ST {total}")
        return "\n".join([*lines, *(f"Note: {note}" for note in self.notes)])

    def to_csv(self) -> str:
        """Return the table as CSV."""
        return table_text(self.table)

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain values."""
        return {
            "method": "sobol",
            "size": self.size,
            "seeds": self.seeds,
            "table": self.table,
            "notes": self.notes,
            "versions": {**versions(), "SALib": package_version("SALib")},
            "scene": self.scene.to_dict(),
        }

    def to_json(self) -> str:
        """Return everything as strict JSON; NaN is null."""
        return to_json(self.to_dict()) + "\n"

    def report(self, folder: str | Path | None = None) -> Path:
        """Write tables, pictures and the page ``report.html``; return the page."""
        from multicell.calibration.sensitivity.sobol_page import write_sobol_report

        return write_sobol_report(self, self.write_tables(folder))

    def write_tables(self, folder: str | Path | None = None) -> Path:
        """Write ``sensitivity.csv`` and ``sensitivity.json``; return the folder."""
        place = self.folder if folder is None else Path(folder)
        if place is None:
            raise OutputError("the analysis has no output folder: say where the report shall go")
        with file_errors("use the output folder", place):
            place.mkdir(parents=True, exist_ok=True)
        write_text(place / "sensitivity.csv", self.to_csv())
        write_text(place / "sensitivity.json", self.to_json())
        return place


def sobol_result(
    plan: SensitivityPlan,
    values: Mapping[str, FloatArray],
    failures: Mapping[str, str] = MappingProxyType({}),
) -> SobolIndices:
    """Return the indices of whatever has values at the points of a plan's sample."""
    from multicell.results.quantities import known_unit

    names = [free.name for free in plan.ranges]
    table: list[dict[str, Any]] = []
    notes = []
    if failures:
        reason = next(iter(failures.values()))
        notes.append(f"{len(failures)} runs failed, the first one: {reason}")
    for name, column in values.items():
        found, used = sobol_indices(names, column)
        if used < plan.size:
            notes.append(f"{name}: {plan.size - used} of {plan.size} points lack a run")
        if np.isnan(found["ST"]).all():
            notes.append(f"{name} does not vary, or has too few points: no index is known")
        table += [
            {
                "observable": name,
                "unit": known_unit(name),
                "parameter": free.name,
                "key": free.key,
                "low": free.low,
                "high": free.high,
                "parameter_unit": free.unit,
                **{column: float(found[column][k]) for column in COLUMNS_SOBOL},
            }
            for k, free in enumerate(plan.ranges)
        ]
    if len(plan.seeds) == 1:
        notes.append("one seed: the part of the noise is unknown; take at least two")
    return SobolIndices(plan.scene, plan.ranges, plan.size, plan.seeds, table, notes, failures)


def with_folder(found: SobolIndices, folder: Path) -> SobolIndices:
    """Return indices that know the folder of their runs, with their tables in it."""
    found = replace(found, folder=folder)
    found.write_tables()  # numbers do not wait for a page
    return found
