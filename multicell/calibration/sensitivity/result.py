"""Results of sensitivity analyses, Morris and Sobol: their tables, with pictures and pages."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, final

from multicell.calibration.sensitivity.numbers import IndexTable, Row
from multicell.errors import SceneError
from multicell.measured.observables import suggest
from multicell.results.quantities import known_unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class WithPage(IndexTable):
    """Indices with a page; abstract."""

    def report(self, folder: str | Path | None = None) -> Path:
        """Write tables, pictures and the page ``report.html``; return the page.

        Raises
        ------
        OutputError
            If there is no folder, or it cannot be written to.
        """
        from multicell.calibration.sensitivity.page import write_sensitivity_report

        return write_sensitivity_report(self, self.write_tables(folder))


@final
class Sensitivity(WithPage):
    """Influence of each free parameter on each observable.

    - ``ranges``: the free parameters
    - ``size``: trajectories of Morris
    - ``seeds``: runs at each point, whose observables are averaged
    - ``table``: a row for each observable and parameter: ``observable``, ``unit``, ``parameter``,
      ``key``, ``low``, ``high``, ``parameter_unit``, ``mu``, ``mu_star``, ``mu_star_conf`` (the
      half width of its 95 % interval) and ``sigma`` (in ``unit``, for the whole range). ``noise``
      is what scatter over the seeds alone gives (NaN for one seed) and ``verdict`` what can be
      said: see :class:`multicell.calibration.sensitivity.indices.Analysis`.
    - ``notes``: what the reader must know: failed runs, an observable that does not vary
    - ``failures``: name of a run that failed -> reason; the study in the folder has the others
    """

    leading: ClassVar[str] = "mu_star"
    further: ClassVar[int] = 1
    kind: ClassVar[str] = "Screening by Morris"
    caption: ClassVar[str] = (
        "size of effects at the end of the runs, with 95 % intervals; pale is what is not "
        "distinguishable from noise or zero."
    )
    template: ClassVar[str] = "sensitivity.html"

    def index(self, observable: str, parameter: str) -> Row:
        """Return one row of the table.

        Raises
        ------
        SceneError
            If there is none of these names.
        """
        for row in self.table:
            if row["observable"] == observable and parameter in (row["parameter"], row["key"]):
                return dict(row)
        known = [*self.observables, *(free.name for free in self.ranges)]
        missing = observable if observable not in known else parameter
        raise SceneError(
            "", f"the analysis has no {missing!r}", suggest(missing, dict.fromkeys(known))
        )

    def plot(self, observable: str | None = None) -> Figure:
        """Draw the indices of an observable (by default the first) with their intervals."""
        from multicell.calibration.sensitivity.page import indices

        return indices(self, observable or self.observables[0])

    def text(self) -> str:
        """Return the table in words, the largest index of each observable first."""
        lines = []
        for name in self.observables:
            unit = known_unit(name)
            lines.append(f"{name.replace('_', ' ')}{f' ({unit})' if unit else ''}")
            lines += [f"  {line}" for line in _table_lines(self.ordered(name))]
        return "\n".join([*lines, *(f"Note: {note}" for note in self.notes)])


@final
class SobolIndices(WithPage):
    """Contributions of parameters to the variance of observables.

    - ``ranges``: the free parameters
    - ``size``: points of the sequence; runs are ``size * (parameters + 2)`` for each seed
    - ``seeds``: runs at each point, whose observables are averaged
    - ``table``: a row for each observable and parameter: ``observable``, ``unit``, ``parameter``,
      ``key``, ``low``, ``high``, ``parameter_unit`` and :data:`COLUMNS_SOBOL`
    - ``notes``: what the reader must know
    - ``failures``: name of a run that failed -> reason
    """

    leading: ClassVar[str] = "ST"
    further: ClassVar[int] = 2
    kind: ClassVar[str] = "Sobol' indices"
    caption: ClassVar[str] = "parts of its variance, with 95 % intervals."
    template: ClassVar[str] = "sobol.html"

    def plot(self, observable: str | None = None) -> Figure:
        """Draw first and total indices of an observable with their intervals."""
        from multicell.calibration.sensitivity.page import sobol_bars

        return sobol_bars(self, observable or self.observables[0])

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain values."""
        return {"method": "sobol", **super().to_dict()}

    def text(self) -> str:
        """Return the table in words."""
        lines = []
        for name in self.observables:
            lines.append(name.replace("_", " "))
            for row in self.ordered(name):
                first, total = (f"{row[x]:.3g} ± {row[f'{x}_conf']:.2g}" for x in ("S1", "ST"))
                lines.append(f"  {row['parameter']:24s} S1 {first:18s} ST {total}")
        return "\n".join([*lines, *(f"Note: {note}" for note in self.notes)])


def _table_lines(rows: Sequence[Row]) -> list[str]:
    """Return lines of a table of one observable."""
    cells = [["parameter", "mu*", "± 95 %", "mu", "sigma", "noise", ""]]
    for row in rows:
        known = (row[name] for name in ("mu_star", "mu_star_conf", "mu", "sigma", "noise"))
        words = ("unknown" if x != x else f"{x:.3g}" for x in known)
        cells.append([row["parameter"], *words, row["verdict"]])
    wide = [max(map(len, column)) for column in zip(*cells, strict=True)]
    lines = []
    for first, *inner, last in cells:
        aligned = (word.rjust(width) for word, width in zip(inner, wide[1:], strict=False))
        lines.append("  ".join([first.ljust(wide[0]), *aligned, last]).rstrip())
    return lines
