"""The page of a dose response."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from multicell.calibration.dose_curve import TOTALS
from multicell.report.html import write_page
from multicell.report.plots.style import save

if TYPE_CHECKING:
    from multicell.calibration.dose_response_result import DoseResponse


def write_report(result: DoseResponse, folder: Path) -> Path:
    """Write ``report.html`` and the picture as PNG and SVG, and return the page."""
    drugs = " and ".join(curve.name for curve in result.curves)
    caption = (
        f"Viability: {result.response} relative to the control; points: means, dots: single runs "
        "or data, band: 95 % interval of the curve."
    )
    if result.combination:
        caption += (
            " Right: Bliss excess, above zero where fewer survive than if the drugs acted "
            "independently, and Loewe index, below one where doses do more together than added up; "
            "grey: beyond the doses tested of a drug alone; –: one drug alone never leaves so few "
            "alive; bold: the 95 % interval excludes 0 (or 1)."
        )
    tiles = {
        f"IC50, {curve.name}": curve.ic50.words.partition(" (95 %")[0] for curve in result.curves
    }
    if len(result.curves) == 1:
        tiles["slope h"] = f"{result.curve.slope.value:.3g}"
    tiles |= {TOTALS[name]: f"{entry.value:.3g}" for name, entry in result.totals.items()}
    tiles["replicates" if result.scene is None else "seeds"] = f"{result.replicates}"
    save(result.plot(), folder / "dose_response.svg")
    return write_page(
        folder / "report.html",
        "dose_response.html",
        scene=result.scene,
        title=f"{result.title}: dose response",
        subtitle=f"{result.response} over {drugs}",
        tiles=tiles,
        pictures={"dose_response.png": (result.plot, caption)},
        result=result,
    )
