"""The result of a dose response: its numbers, with picture and page."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, final

from multicell.calibration.dose_response.numbers import DoseNumbers

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@final
class DoseResponse(DoseNumbers):
    """Responses to doses, with curves, combinations, picture and page.

    - ``title``: of the scene, or name of the table
    - ``curves``: of one drug, or of each of two alone, with ``ic50``, ``ec50``, ``slope``
      and ``bottom`` (each with ``value``, ``low``, ``high`` and ``words``); a curve can be
      called
    - ``response``: what is measured, in words
    - ``replicates``: seeds, or replicates of data, at most
    - ``table``: a row for each run or datum: ``dose`` (or ``dose A``, ``dose B``) in the unit of
      the curve, ``replicate`` (the seed), ``response``, ``viability``, ``run`` and ``reason`` of a
      failure
    - ``combination``: a row for each pair of doses: ``viability``, ``bliss_excess`` and
      ``loewe_index``, each with ``..._low`` and ``..._high``, and ``extrapolated``; see
      :func:`multicell.calibration.dose_response.curve.combine_drugs`
    - ``totals``: mean ``bliss_excess`` and geometric mean ``loewe_index``
    - ``notes``: what the reader must know
    """

    def plot(self) -> Figure:
        """Draw responses, curves with bands and IC50; of combinations also both references."""
        from multicell.calibration.dose_response.page import draw

        return draw(self)

    def report(self, folder: str | Path | None = None) -> Path:
        """Write tables, pictures and the page ``report.html``; return the page.

        Raises ``OutputError`` if there is no folder, or it cannot be written to.
        """
        from multicell.calibration.dose_response.page import write_dose_report

        return write_dose_report(self, self.write_tables(folder))
